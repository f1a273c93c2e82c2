"""Flags and selections of EKF2 and EKF3 (libraries/AP_NavEKF/AP_Nav_Common.h, libraries/AP_NavEKF3)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

SOLUTION: Mapping[int, str] = MappingProxyType(  # XKF4.SS; the lowest ten bits are those of EKF_STATUS_REPORT.flags
    {
        0: "attitude",
        1: "horizontal velocity",
        2: "vertical velocity",
        3: "relative position",
        4: "absolute position",
        5: "height",
        6: "terrain height",
        7: "constant position",
        8: "relative position predicted",
        9: "absolute position predicted",
        10: "take-off detected",
        11: "take-off",
        12: "touch-down",
        13: "using GPS",
        14: "GPS glitching",
        15: "GPS good",
        16: "initialised",
        17: "airspeed refused",
        18: "dead reckoning",
    }
)
ABSOLUTE, CONSTANT_POSITION, GPS_GLITCHING, DEAD_RECKONING = 1 << 4, 1 << 7, 1 << 14, 1 << 18

TIMEOUTS: Mapping[int, str] = MappingProxyType(  # XKF4.TS
    {0: "position", 1: "velocity", 2: "height", 3: "compass", 4: "airspeed", 5: "drag"}
)
TIMEOUTS_THAT_COUNT = 0b1111
"""Airspeed and drag time out wherever there is no such sensor."""

FAULTS: Mapping[int, str] = MappingProxyType(  # XKF4.FS
    {
        0: "quaternion not a number",
        1: "velocity not a number",
        2: "fusion of compass X badly conditioned",
        3: "fusion of compass Y badly conditioned",
        4: "fusion of compass Z badly conditioned",
        5: "fusion of airspeed badly conditioned",
        6: "fusion of sideslip badly conditioned",
        7: "not initialised",
    }
)
NOT_INITIALISED = 1 << 7

GPS_CHECKS: Mapping[int, str] = MappingProxyType(  # XKF4.GPS
    {
        0: "speed accuracy",
        1: "horizontal accuracy",
        2: "yaw error",
        3: "satellites",
        4: "vertical velocity inconsistent",
        5: "drifting",
        6: "HDOP",
        7: "vertical speed",
        8: "no 3D fix",
        9: "horizontal speed",
        10: "vertical accuracy",
    }
)
ACTIVE: Mapping[int, str] = MappingProxyType(  # ATT.AEKF
    {0: "DCM", 2: "EKF2", 3: "EKF3", 10: "simulated truth", 11: "external AHRS"}
)
MAG_FUSION: Mapping[int, str] = MappingProxyType({0: "none", 1: "yaw", 2: "full field"})
SOURCE_SETS: Mapping[int, str] = MappingProxyType({0: "primary", 1: "secondary", 2: "tertiary"})


def bit_names(names: Mapping[int, str], value: int) -> tuple[str, ...]:
    """Of the bits set in `value`; those without a name as "bit 21"."""
    return tuple(names.get(bit, f"bit {bit}") for bit in range(max(value, 0).bit_length()) if value >> bit & 1)
