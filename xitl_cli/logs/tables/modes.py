"""Modes by vehicle, and the reasons of mode changes.

ArduPilot's mode enumerations and ModeReason (libraries/AP_Vehicle/ModeReason.h), 4.7. Older versions use the same
numbers for fewer modes. The embedded autopilot uses Rover's.
"""

from __future__ import annotations

from collections.abc import Mapping

from agent.mavlink.modes import ROVER_MODES
from xitl_cli.logs.tables.vehicles import VehicleKind

_OFFBOARD = {30: "OFFBOARD"}
_COPTER = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE", 9: "LAND",
    11: "DRIFT", 13: "SPORT", 14: "FLIP", 15: "AUTOTUNE", 16: "POSHOLD", 17: "BRAKE", 18: "THROW", 19: "AVOID_ADSB",
    20: "GUIDED_NOGPS", 21: "SMART_RTL", 22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG", 25: "SYSTEMID", 26: "AUTOROTATE",
    27: "AUTO_RTL", 28: "TURTLE",
}  # fmt: skip
_PLANE = {
    0: "MANUAL", 1: "CIRCLE", 2: "STABILIZE", 3: "TRAINING", 4: "ACRO", 5: "FBWA", 6: "FBWB", 7: "CRUISE",
    8: "AUTOTUNE", 10: "AUTO", 11: "RTL", 12: "LOITER", 13: "TAKEOFF", 14: "AVOID_ADSB", 15: "GUIDED",
    16: "INITIALISING", 17: "QSTABILIZE", 18: "QHOVER", 19: "QLOITER", 20: "QLAND", 21: "QRTL", 22: "QAUTOTUNE",
    23: "QACRO", 24: "THERMAL", 25: "LOITER_ALT_QLAND", 26: "AUTOLAND",
}  # fmt: skip
_SUB = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 7: "CIRCLE", 9: "SURFACE", 16: "POSHOLD",
    19: "MANUAL", 20: "MOTOR_DETECT", 21: "SURFTRAK",
}  # fmt: skip

MODES: Mapping[VehicleKind, Mapping[int, str]] = {
    "rover": {**ROVER_MODES, **_OFFBOARD}, "copter": _COPTER | _OFFBOARD, "plane": _PLANE | _OFFBOARD,
    "sub": _SUB | _OFFBOARD, "unknown": {},
}  # fmt: skip

REASONS: Mapping[int, str] = {
    1: "RC switch", 2: "ground station", 3: "radio failsafe", 4: "battery failsafe", 5: "ground station failsafe",
    6: "EKF failsafe", 7: "GPS glitch", 8: "end of mission", 9: "landing escaped with the throttle",
    10: "fence breached", 11: "terrain failsafe", 12: "time to brake over", 13: "flip complete", 14: "avoidance",
    15: "avoidance over", 16: "throw complete", 17: "termination", 18: "toy mode", 19: "crash",
    20: "soaring: motor running", 21: "soaring: thermal found", 22: "soaring: thermal lost", 23: "transition failed",
    24: "take-off failed", 25: "failsafe", 26: "start-up", 27: "surfaced", 28: "depth not known", 29: "leak",
    30: "servo test", 31: "start-up", 32: "script", 33: "the mode wanted is not available", 34: "autorotation begins",
    35: "autorotation ends", 36: "soaring: too high", 37: "soaring: too low", 38: "soaring: drifted too far",
    39: "return complete, landing as a multicopter", 40: "return complete, landing", 41: "mission command",
    42: "FrSky command", 43: "back inside the fence", 44: "QRTL instead of RTL", 45: "end of the return by mission",
    46: "height reached, landing", 47: "already hovering", 48: "radio failsafe over", 49: "QLAND instead of RTL",
    50: "dead reckoning failsafe", 51: "take-off mode failsafe", 52: "DDS command", 53: "auxiliary switch",
    54: "landing of a fixed wing", 55: "fence enabled again",
}  # fmt: skip

FAILSAFE_REASONS = frozenset({3, 4, 5, 6, 7, 10, 11, 17, 19, 25, 28, 29, 50, 51})
"""Reasons that are a failsafe action of the autopilot."""

NAVIGATING = frozenset({"AUTO", "GUIDED", "RTL", "SMART_RTL", "LOITER", "CIRCLE", "CRUISE", "QRTL", "AUTO_RTL"})
"""Modes that steer by the position estimate."""
HEADING_HELD = frozenset({"AUTO", "GUIDED", "RTL", "SMART_RTL", "CIRCLE", "FOLLOW", "STEERING", "SIMPLE", "DOCK"})
"""Modes of Rover that always steer to a heading; LOITER lets the heading drift within its radius."""

FREE_ATTITUDE: Mapping[VehicleKind, frozenset[str]] = {
    "copter": frozenset({"ACRO", "FLIP", "SPORT", "THROW", "TURTLE", "AUTOROTATE", "SYSTEMID"}),
    "plane": frozenset({"MANUAL", "ACRO", "TRAINING", "QACRO"}),
    "sub": frozenset({"ACRO", "MANUAL"}),
}
"""Modes in which the pilot may command any attitude."""


def mode_name(kind: VehicleKind, number: int) -> str:
    """Name of a mode, such as "AUTO"; "mode 10" if the vehicle or the number is unknown."""
    return MODES[kind].get(number, f"mode {number}")


def reason_name(number: int) -> str:
    """Reason of a mode change, such as "ground station"; "" for 0, which means that no reason was given."""
    return "" if number == 0 else REASONS.get(number, f"reason {number}")
