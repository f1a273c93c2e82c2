"""Names that files and ROS 2 messages may have, from those of messages and fields."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

_LONGEST_FILE_NAME = 120


def file_names(messages: Iterable[str], reserved: Iterable[str] = ()) -> dict[str, str]:
    """Without an ending: "/link/agent/rx:ATTITUDE" → "link_agent_rx_ATTITUDE". Each its own where case makes none."""

    def named(message: str) -> str:
        return re.sub(r"[^A-Za-z0-9_.-]+", "_", message).strip("._")[:_LONGEST_FILE_NAME]

    return _unique(messages, named, reserved=reserved)


def field_names(columns: Iterable[str]) -> dict[str, str]:
    """As ROS 2 wants them, of small letters, digits and single underscores: "GyrX" → "gyrx", "pose.x" → "pose_x"."""

    def named(column: str) -> str:
        name = re.sub(r"[^a-z0-9]+", "_", column.lower()).strip("_")
        return name if name[:1].isalpha() else f"f_{name}".rstrip("_")

    return _unique(columns, named)


def type_names(messages: Iterable[str]) -> dict[str, str]:
    """Of letters and digits, with a capital first: "GPS_RAW_INT" → "GpsRawInt", "ATT" → "ATT"."""

    def named(message: str) -> str:
        parts = re.findall(r"[A-Za-z0-9]+", message)
        name = parts[0] if len(parts) == 1 else "".join(part.capitalize() for part in parts)
        return name[0].upper() + name[1:] if name[:1].isalpha() else f"M{name}"

    return _unique(messages, named, joined="")


def _unique(
    names: Iterable[str], named: Callable[[str], str], joined: str = "_", reserved: Iterable[str] = ()
) -> dict[str, str]:
    taken = set(reserved)
    result: dict[str, str] = {}
    for name in names:
        base = named(name) or "message"
        made, number = base, 2
        while made.casefold() in taken:
            made, number = f"{base}{joined}{number}", number + 1
        taken.add(made.casefold())
        result[name] = made
    return result
