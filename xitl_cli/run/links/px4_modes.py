"""PX4's modes by the names that profiles use, and its way of writing whole-number parameters.

A mode of PX4 is a main mode and, of the automatic ones, a sub mode: bytes 2 and 3 of a heartbeat's custom_mode,
parameters 2 and 3 of MAV_CMD_DO_SET_MODE (src/modules/commander/px4_custom_mode.h). Its missions have no home as item
0; one that begins where the vessel lies keeps the numbers of the waypoints the same, for it is reached at once. Not yet
run against PX4.
"""

from __future__ import annotations

import struct
from typing import Any

from agent.wire import dialect

AUTOPILOT = dialect.MAV_AUTOPILOT_PX4
_MANUAL, _ALTITUDE, _POSITION, _AUTO, _ACRO, _OFFBOARD, _STABILIZED = range(1, 8)
_LOITER, _MISSION, _RETURN = 3, 4, 5

_ORDERS = {
    "MANUAL": (_MANUAL, 0),
    "ACRO": (_ACRO, 0),
    "STEERING": (_STABILIZED, 0),  # it holds the heading while the stick is centred
    "HOLD": (_AUTO, _LOITER),
    "LOITER": (_AUTO, _LOITER),
    "AUTO": (_AUTO, _MISSION),
    "RTL": (_AUTO, _RETURN),
    "GUIDED": (_OFFBOARD, 0),
}
_NAMES = {
    **{mode: name for name, mode in _ORDERS.items()},
    (_ALTITUDE, 0): "ALTITUDE",
    (_POSITION, 0): "POSITION",
    (_AUTO, 1): "READY",
    (_AUTO, 2): "TAKEOFF",
    (_AUTO, 6): "LAND",
    (_AUTO, 8): "FOLLOW",
}
_WHOLE = {1: "<Bxxx", 2: "<bxxx", 3: "<Hxx", 4: "<hxx", 5: "<I", 6: "<i"}  # by MAV_PARAM_TYPE


def mode_name(custom_mode: int) -> str:
    """The name of a heartbeat's mode; LOITER for PX4's Hold."""
    mode = (custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF)
    return _NAMES.get(mode, f"mode {mode[0]}.{mode[1]}")


def mode_parameters(name: str) -> tuple[float, float, float]:
    """Parameters 1 to 3 of MAV_CMD_DO_SET_MODE. Raises KeyError for a name that no profile can have."""
    main, sub = _ORDERS[name]
    return float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(main), float(sub)


def parameter_value(message: Any) -> float:
    """The value of a PARAM_VALUE: a whole number lies in the four bytes of the field as such."""
    layout = _WHOLE.get(message.param_type)
    if layout is None:
        return float(message.param_value)
    return float(struct.unpack(layout, struct.pack("<f", message.param_value))[0])


def parameter_field(value: float, param_type: int) -> float:
    """What PARAM_SET has to carry for a value of the type that PARAM_VALUE told.

    Raises ValueError for a value that the type does not hold.
    """
    layout = _WHOLE.get(param_type)
    if layout is None:
        return value
    try:
        if value != int(value):
            raise ValueError
        return float(struct.unpack("<f", struct.pack(layout, int(value)))[0])
    except (struct.error, ValueError, OverflowError):
        raise ValueError(f"{value:g} is no value of this whole-number parameter; use a whole number") from None
