"""The MAVLink parameter protocol (mavlink.io/en/services/parameter.html)."""

from __future__ import annotations

import struct
from typing import Any

_WHOLE = {1: "<Bxxx", 2: "<bxxx", 3: "<Hxx", 4: "<hxx", 5: "<I", 6: "<i"}  # by MAV_PARAM_TYPE


def bytewise_value(message: Any) -> float:
    """Value of a PARAM_VALUE of PX4, where a whole number lies in the four bytes of the field as such."""
    layout = _WHOLE.get(message.param_type)
    if layout is None:
        return float(message.param_value)
    return float(struct.unpack(layout, struct.pack("<f", message.param_value))[0])


def bytewise_field(value: float, param_type: int) -> float:
    """Field of a PARAM_SET to PX4 for a value of the type that PARAM_VALUE told.

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
