"""Modes of ArduRover and PX4: numbers, names, and the parameters of MAV_CMD_DO_SET_MODE.

The embedded autopilot has ArduRover's numbers. A mode of PX4 is a main mode, and for automatic modes also a sub mode.
They are bytes 2 and 3 of a heartbeat's custom_mode, and parameters 2 and 3 of MAV_CMD_DO_SET_MODE
(src/modules/commander/px4_custom_mode.h). PX4's counterpart of GUIDED is Hold, with a position from DO_REPOSITION.
"""

from __future__ import annotations

from collections.abc import Mapping

CUSTOM_MODE_ENABLED = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED

MANUAL, ACRO, STEERING, HOLD, LOITER, SIMPLE, CIRCLE, AUTO, RTL, SMART_RTL, GUIDED = 0, 1, 3, 4, 5, 7, 9, 10, 11, 12, 15

ROVER_MODES: Mapping[int, str] = {
    MANUAL: "MANUAL",
    ACRO: "ACRO",
    2: "LEARNING",
    STEERING: "STEERING",
    HOLD: "HOLD",
    LOITER: "LOITER",
    6: "FOLLOW",
    SIMPLE: "SIMPLE",
    8: "DOCK",
    CIRCLE: "CIRCLE",
    AUTO: "AUTO",
    RTL: "RTL",
    SMART_RTL: "SMART_RTL",
    GUIDED: "GUIDED",
    16: "INITIALISING",
}
"""Names by ArduRover's custom_mode (Rover/mode.h)."""
ROVER_MODE_NUMBERS: Mapping[str, int] = {name: number for number, name in ROVER_MODES.items()}
MISSION_MODE = "AUTO"
"""Name of the mode that follows the uploaded mission, for ArduRover and PX4."""

_MANUAL, _ALTITUDE, _POSITION, _AUTO, _ACRO, _OFFBOARD, _STABILIZED = range(1, 8)
_LOITER, _MISSION, _RETURN = 3, 4, 5

PX4_MODES: Mapping[str, tuple[int, int]] = {
    "MANUAL": (_MANUAL, 0),
    "ACRO": (_ACRO, 0),
    "STEERING": (_STABILIZED, 0),  # it holds the heading while the stick is centred
    "HOLD": (_AUTO, _LOITER),
    "LOITER": (_AUTO, _LOITER),
    "AUTO": (_AUTO, _MISSION),
    "RTL": (_AUTO, _RETURN),
    "GUIDED": (_AUTO, _LOITER),
}
"""Main and sub mode by the names in profiles."""
_PX4_NAMES = {
    **{mode: name for name, mode in PX4_MODES.items()},
    PX4_MODES["LOITER"]: "LOITER",
    (_OFFBOARD, 0): "OFFBOARD",
    (_ALTITUDE, 0): "ALTITUDE",
    (_POSITION, 0): "POSITION",
    (_AUTO, 1): "READY",
    (_AUTO, 2): "TAKEOFF",
    (_AUTO, 6): "LAND",
    (_AUTO, 8): "FOLLOW",
}


def mode_name(custom_mode: int, px4: bool = False) -> str:
    """Name of a heartbeat's custom_mode, for example `AUTO`; `mode 21` for an unknown one; LOITER for PX4's Hold."""
    if not px4:
        return ROVER_MODES.get(custom_mode, f"mode {custom_mode}")
    mode = (custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF)
    return _PX4_NAMES.get(mode, f"mode {mode[0]}.{mode[1]}")


def shown_mode(name: str, px4: bool = False) -> str:
    """Name that `mode_name` returns while this mode is active. PX4 has one mode for HOLD, LOITER and GUIDED."""
    return _PX4_NAMES[PX4_MODES[name]] if px4 else name


def set_mode_parameters(name: str, px4: bool = False) -> tuple[float, ...]:
    """First parameters of MAV_CMD_DO_SET_MODE. Raises KeyError for a mode that the autopilot lacks."""
    numbers = PX4_MODES[name] if px4 else (ROVER_MODE_NUMBERS[name],)
    return (float(CUSTOM_MODE_ENABLED), *map(float, numbers))
