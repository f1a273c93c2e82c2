"""The version an autopilot tells (AUTOPILOT_VERSION), in words."""

from __future__ import annotations

_KINDS = {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc", 255: ""}


def version_words(flight_sw_version: int, custom: bytes) -> str:
    """`4.6.3 (3fc7011a)`: four bytes of numbers and release type, eight characters of the revision."""
    major, minor, patch, kind = flight_sw_version.to_bytes(4, "big")
    release = _KINDS.get(kind, f"-{kind}")
    revision = custom.split(b"\0")[0].decode("ascii", "replace").strip()
    return f"{major}.{minor}.{patch}{release}" + (f" ({revision})" if revision.isprintable() and revision else "")
