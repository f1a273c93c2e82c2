"""Who armed or disarmed, and what is checked before (AP_Arming::Method and AP_Arming::Check, libraries/AP_Arming)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

METHODS: Mapping[int, str] = MappingProxyType(
    {
        0: "rudder stick",
        1: "ground station",
        2: "auxiliary switch",
        3: "motor test",
        4: "script",
        5: "termination",
        6: "CPU failsafe",
        7: "battery failsafe",
        8: "pause when landed",
        9: "advanced failsafe",
        10: "ADS-B collision",
        11: "parachute released",
        12: "crash check",
        13: "landed",
        14: "end of mission",
        15: "fence breached",
        16: "radio failsafe",
        17: "disarm delay",
        18: "ground station failsafe",
        19: "terrain failsafe",
        20: "failsafe: terminate",
        21: "terrain failsafe",
        22: "motor detection done",
        23: "bad flow of control",
        24: "EKF failsafe",
        25: "ground station failsafe, surfacing failed",
        26: "ground station failsafe, holding failed",
        27: "take-off took too long",
        28: "landed by itself",
        29: "pilot input failsafe",
        30: "toy mode: land, throttle",
        31: "toy mode: land, forced",
        32: "landing",
        33: "dead reckoning failsafe",
        34: "black box",
        35: "DDS",
        36: "armed once by itself",
        37: "turtle mode",
        38: "toy mode",
        100: "unknown",
    }
)
FAILSAFE_METHODS = frozenset({5, 6, 7, 9, 10, 12, 15, 16, 18, 19, 20, 21, 23, 24, 25, 26, 29, 33})
"""Methods that are the autopilot's own answer to trouble."""

ALL_CHECKS = 1
CHECKS: Mapping[int, str] = MappingProxyType(
    {
        0: "all",
        1: "barometer",
        2: "compass",
        3: "GPS",
        4: "INS",
        5: "parameters",
        6: "RC",
        7: "board voltage",
        8: "battery",
        9: "airspeed",
        10: "logging",
        11: "safety switch",
        12: "GPS configuration",
        13: "system",
        14: "mission",
        15: "rangefinder",
        16: "camera",
        17: "auxiliary authorisation",
        18: "visual odometry",
        19: "FFT",
        20: "OSD",
    }
)


def method_name(number: int) -> str:
    return METHODS.get(number, f"method {number}")


def checks_left_out(enabled: int) -> tuple[str, ...]:
    """Names of the checks that are not among the bits of `enabled` (ARM.ArmChecks, ARMING_CHECK)."""
    if enabled & ALL_CHECKS:
        return ()
    return tuple(name for bit, name in CHECKS.items() if bit and not enabled >> bit & 1)
