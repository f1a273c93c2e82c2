"""What vehicle a log is of: it decides what a mode number means.

APM_BUILD (libraries/AP_Vehicle/AP_Vehicle_Type.h), firmware names, MAV_TYPE of MAVLink.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

from xitl_cli.logs.log import Log
from xitl_cli.logs.words.heard import autopilot_heartbeats

Kind = Literal["rover", "copter", "plane", "sub", "tracker", "blimp", "unknown"]

_BUILDS: Mapping[int, Kind] = MappingProxyType(
    {1: "rover", 2: "copter", 3: "plane", 4: "tracker", 7: "sub", 12: "blimp", 13: "copter"}
)
_IN_NAMES: tuple[tuple[str, Kind], ...] = (
    ("rover", "rover"),
    ("copter", "copter"),
    ("heli", "copter"),
    ("plane", "plane"),
    ("sub", "sub"),
    ("tracker", "tracker"),
    ("blimp", "blimp"),
)
_MAV_TYPES: tuple[tuple[Kind, tuple[int, ...]], ...] = (
    ("plane", (1, 7, 16, 19, 20, 21, 22, 23, 24, 25, 28)),
    ("copter", (2, 3, 4, 13, 14, 15, 29, 35)),
    ("tracker", (5,)),
    ("rover", (10, 11)),
    ("sub", (12,)),
)
_ARDUPILOT = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA
_FIRMWARE = re.compile(r"^(?:APM:|Ardu)?(?:Rover|Copter|Plane|Sub|Heli)\b|^AntennaTracker|^Blimp|ArduRover V\d", re.I)
_FIRST_TEXTS = 200


def kind_of(log: Log) -> Kind:
    """By VER.BU, by the firmware's name in MSG, or by the type in its heartbeats."""
    version = log.tables.get("VER")
    if version is not None and "BU" in version.columns:
        found = kind_of_build(int(version.values("BU", raw=True)[-1]))
        if found != "unknown":
            return found
    name = firmware_text(log)
    if name is not None and (found := kind_of_name(name)) != "unknown":
        return found
    beats = autopilot_heartbeats(log)
    if beats is None or int(beats.values("autopilot", raw=True)[0]) != _ARDUPILOT:
        return "unknown"
    return kind_of_mav_type(int(beats.values("type", raw=True)[0]))


def firmware_text(log: Log) -> str | None:
    """What the firmware calls itself in its first sentences: "ArduRover V4.7.0-dev (2598e9d4)"."""
    for table, field in (("MSG", "Message"), ("STATUSTEXT", "text"), ("/log", "message")):
        found = log.tables.get(table)
        if found is None or field not in found.columns:
            continue
        for text in found.values(field, slice(0, _FIRST_TEXTS)):
            if _FIRMWARE.search(str(text)):
                return str(text).strip()
    return None


def kind_of_build(number: int) -> Kind:
    """Of VER.BU."""
    return _BUILDS.get(number, "unknown")


def kind_of_name(text: str) -> Kind:
    """Of a firmware's name."""
    lower = text.lower()
    return next((kind for part, kind in _IN_NAMES if part in lower), "unknown")


def kind_of_mav_type(number: int) -> Kind:
    """Of HEARTBEAT.type of an ArduPilot."""
    return next((kind for kind, numbers in _MAV_TYPES if number in numbers), "unknown")
