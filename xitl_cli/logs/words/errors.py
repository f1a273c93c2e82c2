"""ERR: which subsystem, and what its code says (LogErrorSubsystem and LogErrorCode of libraries/AP_Logger/AP_Logger.h).

Code 0 clears whatever the subsystem had before; which codes do not stand for trouble that lasts is in `lasts`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from xitl_cli.logs.words.kinds import Kind
from xitl_cli.logs.words.modes import mode_name

MAIN, RADIO, COMPASS, RC_FAILSAFE, BATTERY_FAILSAFE, GCS_FAILSAFE, FENCE = 1, 2, 3, 5, 6, 8, 9
MODE_REFUSED, GPS, CRASH, PARACHUTE, EKF_CHECK, EKF_FAILSAFE, BARO, CPU = 10, 11, 12, 15, 16, 17, 18, 19
NAVIGATION, TERRAIN_FAILSAFE, EKF_PRIMARY, THRUST_LOSS = 22, 23, 24, 25
SENSORS, LEAK, VIBRATION, INTERNAL, DEAD_RECKONING = 26, 27, 29, 30, 31

SUBSYSTEMS: Mapping[int, str] = MappingProxyType(
    {
        MAIN: "main",
        RADIO: "radio",
        COMPASS: "compass",
        4: "optical flow",
        RC_FAILSAFE: "radio failsafe",
        BATTERY_FAILSAFE: "battery failsafe",
        7: "GPS failsafe",
        GCS_FAILSAFE: "ground station failsafe",
        FENCE: "fence",
        MODE_REFUSED: "mode",
        GPS: "GPS",
        CRASH: "crash check",
        13: "flip",
        14: "autotune",
        PARACHUTE: "parachute",
        EKF_CHECK: "EKF check",
        EKF_FAILSAFE: "EKF failsafe",
        BARO: "barometer",
        CPU: "CPU failsafe",
        20: "ADS-B failsafe",
        21: "terrain data",
        NAVIGATION: "navigation",
        TERRAIN_FAILSAFE: "terrain failsafe",
        EKF_PRIMARY: "EKF primary",
        THRUST_LOSS: "thrust loss check",
        SENSORS: "sensor failsafe",
        LEAK: "leak",
        28: "pilot input failsafe",
        VIBRATION: "vibration failsafe",
        INTERNAL: "internal error",
        DEAD_RECKONING: "dead reckoning failsafe",
    }
)
_CODES: Mapping[tuple[int, int], str] = MappingProxyType(
    {
        (MAIN, 1): "INS delay",
        (RADIO, 2): "late frame",
        (CRASH, 1): "crash",
        (CRASH, 2): "loss of control",
        (13, 2): "abandoned",
        (PARACHUTE, 2): "too low",
        (PARACHUTE, 3): "landed",
        (EKF_CHECK, 2): "bad variance",
        (BARO, 2): "glitch",
        (BARO, 3): "bad depth",
        (GPS, 2): "glitch",
        (21, 2): "missing",
        (NAVIGATION, 2): "destination refused",
        (NAVIGATION, 3): "return started again",
        (NAVIGATION, 4): "circle refused",
        (NAVIGATION, 5): "destination outside the fence",
        (NAVIGATION, 6): "return needs a rangefinder",
        (SENSORS, 3): "bad depth",
        (INTERNAL, 1): "detected",
        (THRUST_LOSS, 1): "detected",
        (LEAK, 1): "detected",
    }
)
_FAILSAFES = frozenset({5, 6, 7, 8, 17, 19, 20, 23, 26, 28, 29, 31})
_FENCES = ((1, "upper height"), (2, "circle"), (4, "polygon"), (8, "lower height"))
_AT_ONCE = frozenset({MODE_REFUSED, 13, 14, PARACHUTE, NAVIGATION, EKF_PRIMARY, CRASH, INTERNAL, THRUST_LOSS})


def subsystem_name(subsystem: int) -> str:
    return SUBSYSTEMS.get(subsystem, f"subsystem {subsystem}")


def is_failsafe(subsystem: int) -> bool:
    """Whether its errors are a failsafe that acts."""
    return subsystem in _FAILSAFES or subsystem == FENCE


def lasts(subsystem: int) -> bool:
    """Whether an error of it stays until it is cleared, where others only tell of an instant."""
    return subsystem not in _AT_ONCE


def error_name(subsystem: int, code: int, kind: Kind = "unknown") -> str:
    """ "EKF check: bad variance"; "compass: resolved" for code 0 of what can be cleared."""
    return f"{subsystem_name(subsystem)}: {_code_name(subsystem, code, kind)}"


def _code_name(subsystem: int, code: int, kind: Kind) -> str:
    if subsystem == EKF_PRIMARY:
        return f"lane {code}"
    if subsystem == MODE_REFUSED:
        return f"{mode_name(kind, code)} refused"
    if code == 0:
        return "resolved"
    if subsystem == FENCE:
        names = [name for bit, name in _FENCES if code & bit]
        return f"{', '.join(names) or code} breached"
    named = _CODES.get((subsystem, code))
    if named is not None:
        return named
    if subsystem in _FAILSAFES:
        return "occurred" if code == 1 else f"occurred, code {code}"
    return {1: "failed to initialise", 4: "unhealthy"}.get(code, f"code {code}")
