"""Units of our own recordings, whose names carry them."""

from __future__ import annotations

from collections.abc import Callable

_OURS = "xitl_msgs/"
_BY_SUFFIX = {
    "m": "m",
    "s": "s",
    "us": "us",
    "ns": "ns",
    "hz": "Hz",
    "mps": "m/s",
    "mps2": "m/s/s",
    "radps": "rad/s",
    "deg": "deg",
    "ppm": "ppm",
    "percent": "%",
    "c": "degC",
    "mib": "MiB",
}


def unit_of(schema: str) -> Callable[[str], str]:
    """The unit of a column of messages of this type, "" when its name has none."""
    if not schema.startswith(_OURS):
        return lambda _: ""
    return lambda column: _BY_SUFFIX.get(column.rpartition("_")[2], "") if "_" in column else ""
