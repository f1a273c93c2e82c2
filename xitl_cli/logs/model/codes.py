"""Numbers of ArduPilot and MAVLink by name: vehicles, modes, commands, events.

Vehicle, board and firmware: APM_BUILD (AP_Vehicle_Type.h), HAL_BOARD (AP_HAL_Boards.h), MAV_TYPE and
FIRMWARE_VERSION_TYPE of MAVLink.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from agent.mavlink.modes import ROVER_MODES

VehicleKind = Literal["rover", "copter", "plane", "sub", "unknown"]

_BUILDS: Mapping[int, VehicleKind] = {1: "rover", 2: "copter", 3: "plane", 7: "sub", 13: "copter"}
_IN_NAMES: tuple[tuple[str, VehicleKind], ...] = (
    ("rover", "rover"),
    ("copter", "copter"),
    ("heli", "copter"),
    ("plane", "plane"),
    ("sub", "sub"),
)
_KINDS_BY_TYPE: tuple[tuple[VehicleKind, tuple[int, ...]], ...] = (
    ("plane", (1, 7, 16, 19, 20, 21, 22, 23, 24, 25, 28)),
    ("copter", (2, 3, 4, 13, 14, 15, 29, 35)),
    ("rover", (10, 11)),
    ("sub", (12,)),
)


def kind_from_build(number: int) -> VehicleKind:
    """Kind of vehicle from VER.BU."""
    return _BUILDS.get(number, "unknown")


def kind_from_name(text: str) -> VehicleKind:
    """Kind of vehicle from a firmware's name."""
    lower = text.lower()
    return next((kind for part, kind in _IN_NAMES if part in lower), "unknown")


def kind_from_mav_type(number: int) -> VehicleKind:
    """Kind of vehicle from HEARTBEAT.type of an ArduPilot."""
    return next((kind for kind, numbers in _KINDS_BY_TYPE if number in numbers), "unknown")


MAV_TYPES: Mapping[int, str] = {
    1: "fixed wing", 2: "quadrotor", 3: "coaxial helicopter", 4: "helicopter", 5: "antenna tracker",
    10: "ground rover", 11: "surface boat", 12: "submarine", 13: "hexarotor", 14: "octorotor", 15: "tricopter",
    29: "dodecarotor", 35: "decarotor",
}  # fmt: skip
_BOARDS: Mapping[int, str] = {3: "SITL (a simulator)", 7: "Linux", 10: "ChibiOS", 12: "ESP32", 13: "QURT", 99: "none"}
_SUBTYPES: Mapping[int, str] = {
    1000: "", 1001: "Erle-Board", 1002: "PXF", 1003: "Navio", 1004: "Zynq", 1005: "BBBMini", 1006: "Bebop",
    1009: "Erle-Brain 2", 1010: "BH", 1012: "PXFmini", 1013: "Navio2", 1014: "Disco", 1015: "Aero", 1016: "DARK",
    1018: "BeagleBone Blue", 1019: "OcPoC Zynq", 1020: "Edge", 1021: "RST Zynq", 1022: "PocketBeagle",
    1023: "Navigator", 1024: "VNav", 1025: "OBAL", 1026: "CANZero", 1027: "PilotPi", 1028: "PocketBeagle 2",
    5001: "FMUv3", 5009: "generic", 5013: "FMUv5",
}  # fmt: skip
SITL_BOARD = 3
SURFACE_BOAT = 11  # MAV_TYPE
BOAT_FRAME = 2  # FRAME_CLASS of Rover


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Normal motion of a class of vehicles."""

    lean_deg: float | None
    """Normal roll and pitch; None if any is normal."""
    lean_s: float
    """Time for which a larger lean is normal."""
    overturned_deg: float
    """Tilt from which the vehicle does not right itself."""
    shock_mps2: float
    """Acceleration without gravity that waves, kerbs, gusts and landings cause."""


MOTION_LIMITS: Mapping[VehicleKind, MotionLimits] = {
    # A hull heels to 30 deg in waves and rights itself from 60 to 90; small craft slam at 2 to 3 g (ISO 12217, 2631-5).
    "rover": MotionLimits(45.0, 1.0, 80.0, 35.0),
    # Lean is limited by ANGLE_MAX; hard landings reach 3 g.
    "copter": MotionLimits(65.0, 0.5, 90.0, 40.0),
    # Bank is limited by ROLL_LIMIT_DEG; belly landings and catapults reach 5 g.
    "plane": MotionLimits(65.0, 1.0, 100.0, 60.0),
    "sub": MotionLimits(None, 1.0, 100.0, 30.0),
    "unknown": MotionLimits(None, 1.0, 90.0, 40.0),
}
_RELEASES: Mapping[int, str] = {
    0: "development", 64: "alpha", 128: "beta", 192: "release candidate", 255: "official release",
}  # fmt: skip


def board_name(board: int, subtype: int) -> str:
    """Name of a board from VER.BT and VER.BST."""
    name = _BOARDS.get(board, f"board type {board}")
    detail = _SUBTYPES.get(subtype, "")
    return f"{name} {detail}".strip()


def release_name(number: int) -> str:
    """Release type from VER.FWT, or from the lowest byte of AUTOPILOT_VERSION.flight_sw_version."""
    below = [edge for edge in _RELEASES if edge <= number]
    return _RELEASES[max(below)] if below else ""


# Modes by vehicle, and the reasons of mode changes.
#
# ArduPilot's mode enumerations and ModeReason (libraries/AP_Vehicle/ModeReason.h), 4.7. Older versions use the same
# numbers for fewer modes. The embedded autopilot uses Rover's.

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
OPERATOR_REASONS = frozenset({1, 2})
"""Reasons that are a person's choice: radio control and ground station."""

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


# Mission commands (MAV_CMD) and frames (MAV_FRAME) that ArduPilot accepts, RC auxiliary and servo functions.
#
# RCx_OPTION and AUXF.function: AUX_FUNC of libraries/RC_Channel/RC_Channel.h; SERVOn_FUNCTION:
# SRV_Channel::Function.

WAYPOINT, SPLINE = 16, 82

MISSION_COMMANDS: Mapping[int, str] = {
    16: "WAYPOINT", 17: "LOITER_UNLIM", 18: "LOITER_TURNS", 19: "LOITER_TIME", 20: "RETURN_TO_LAUNCH", 21: "LAND",
    22: "TAKEOFF", 30: "CONTINUE_AND_CHANGE_ALT", 31: "LOITER_TO_ALT", 82: "SPLINE_WAYPOINT", 83: "ALTITUDE_WAIT",
    84: "VTOL_TAKEOFF", 85: "VTOL_LAND", 92: "GUIDED_ENABLE", 93: "DELAY", 94: "PAYLOAD_PLACE",
    112: "CONDITION_DELAY", 114: "CONDITION_DISTANCE", 115: "CONDITION_YAW", 176: "DO_SET_MODE", 177: "DO_JUMP",
    178: "DO_CHANGE_SPEED", 179: "DO_SET_HOME", 181: "DO_SET_RELAY", 182: "DO_REPEAT_RELAY", 183: "DO_SET_SERVO",
    184: "DO_REPEAT_SERVO", 188: "DO_RETURN_PATH_START", 189: "DO_LAND_START", 194: "DO_SET_REVERSE",
    201: "DO_SET_ROI", 203: "DO_DIGICAM_CONTROL", 205: "DO_MOUNT_CONTROL", 206: "DO_SET_CAM_TRIGG_DIST",
    207: "DO_FENCE_ENABLE", 208: "DO_PARACHUTE", 210: "DO_INVERTED_FLIGHT", 211: "DO_GRIPPER",
    212: "DO_AUTOTUNE_ENABLE", 215: "DO_SET_RESUME_REPEAT_DIST", 216: "DO_SPRAYER", 218: "DO_AUX_FUNCTION",
    222: "DO_GUIDED_LIMITS", 223: "DO_ENGINE_CONTROL", 600: "JUMP_TAG", 601: "DO_JUMP_TAG",
    1000: "DO_GIMBAL_MANAGER_PITCHYAW", 42702: "SCRIPT_TIME", 42703: "ATTITUDE_TIME",
}  # fmt: skip
PLACE_COMMANDS = frozenset({16, 17, 18, 19, 21, 22, 31, 82, 84, 85, 94})
"""Commands with a destination."""

ALTITUDE_FRAMES: Mapping[int, str] = {
    0: "above sea level", 3: "above home", 5: "above sea level", 6: "above home", 10: "above terrain",
    11: "above terrain",
}  # fmt: skip


def command_name(number: int) -> str:
    return MISSION_COMMANDS.get(number, f"command {number}")


AUXILIARY_FUNCTIONS: Mapping[int, str] = {
    0: "nothing", 2: "flip", 3: "simple mode", 4: "RTL", 5: "save trim", 7: "save waypoint", 9: "camera trigger",
    10: "rangefinder", 11: "fence", 13: "super simple mode", 14: "acro trainer", 15: "sprayer", 16: "AUTO",
    17: "AUTOTUNE", 18: "LAND", 19: "gripper", 21: "parachute enable", 22: "parachute release",
    23: "parachute, 3 positions", 24: "mission reset", 27: "retract mount 1", 28: "relay 1", 29: "landing gear",
    31: "motor emergency stop", 32: "motor interlock", 33: "BRAKE", 34: "relay 2", 35: "relay 3", 36: "relay 4",
    37: "THROW", 38: "ADS-B avoidance", 39: "precision loiter", 40: "proximity avoidance", 41: "arm and disarm (old)",
    42: "SMART_RTL", 43: "inverted flight", 44: "winch", 46: "RC override", 47: "user function 1",
    48: "user function 2", 49: "user function 3", 50: "learn cruise throttle", 51: "MANUAL", 52: "ACRO",
    53: "STEERING", 54: "HOLD", 55: "GUIDED", 56: "LOITER", 57: "FOLLOW", 58: "clear waypoints", 59: "SIMPLE",
    60: "ZIGZAG", 62: "compass learning", 63: "sailboat tack", 64: "reverse throttle", 65: "GPS off", 66: "relay 5",
    67: "relay 6", 68: "STABILIZE", 69: "POSHOLD", 70: "ALT_HOLD", 71: "FLOWHOLD", 72: "CIRCLE", 73: "DRIFT",
    74: "sailboat motor", 76: "standby", 77: "TAKEOFF", 80: "align visual odometry", 81: "disarm",
    90: "EKF source set", 94: "video transmitter power", 96: "mode switch reset", 99: "AUTO_RTL", 100: "IMU 1 off",
    101: "IMU 2 off", 103: "EKF lane switch", 104: "EKF yaw reset", 105: "GPS yaw off", 108: "QRTL", 110: "IMU 3 off",
    112: "AHRS type", 150: "CRUISE", 151: "TURTLE", 153: "arm and disarm", 154: "arm and disarm with airmode",
    155: "trim to current servo and RC", 158: "optical flow calibration", 164: "pause logging",
    165: "arm and emergency stop", 171: "compass calibration", 178: "pause", 182: "AHRS trim",
    184: "system identification",
}  # fmt: skip
SWITCH_POSITIONS: Mapping[int, str] = {0: "low", 1: "middle", 2: "high"}
SWITCH_SOURCES: Mapping[int, str] = {
    0: "start-up", 1: "RC", 2: "button", 3: "ground station", 4: "mission", 5: "script",
}  # fmt: skip


def auxiliary_function_name(number: int) -> str:
    return AUXILIARY_FUNCTIONS.get(number, f"function {number}")


PORT_THROTTLE, STARBOARD_THROTTLE = 73, 74
THROTTLE = 70
FIXED_OUTPUTS = (134, 135, 136)
"""Outputs that always stay at SERVOn_MIN, _TRIM or _MAX."""

MOTORS = frozenset({*range(33, 41), *range(82, 86), *range(160, 180)})
"""Motors of a multicopter: from idle to full, never backwards."""
CONTROLS = MOTORS | {4, 16, 17, 19, 21, 24, 25, 26, 31, 32, 70, 73, 74, 77, 78, 79, 80, 86, 87, 89}
"""Outputs that steer or drive; the others (tilt, gripper, landing gear, camera …) rest at their ends."""
OLD_FUNCTIONS: Mapping[str, Mapping[int, int]] = {
    "rover": {1: 26, 3: 70},
    "plane": {1: 4, 2: 19, 3: 70, 4: 21},
    "copter": {channel: 32 + channel for channel in range(1, 9)},
}
"""By vehicle and channel, for firmware before 2017: outputs repeated the RC channels and had no function."""

_SERVO_FUNCTIONS = {
    -1: "GPIO", 0: "none", 1: "RC passthrough", 2: "flap", 3: "flap, automatic", 4: "aileron", 6: "mount yaw",
    7: "mount pitch", 8: "mount roll", 9: "mount open", 10: "camera trigger", 12: "mount 2 yaw", 13: "mount 2 pitch",
    14: "mount 2 roll", 15: "mount 2 open", 16: "differential spoiler left 1", 17: "differential spoiler right 1",
    19: "elevator", 21: "rudder", 22: "sprayer pump", 23: "sprayer spinner", 24: "flaperon left",
    25: "flaperon right", 26: "steering", 27: "parachute", 28: "gripper", 29: "landing gear", 30: "engine run enable",
    31: "rotor speed", 32: "tail rotor", 41: "tilt of the motors", 42: "generator", 45: "rear motor tilt",
    46: "rear left motor tilt", 47: "rear right motor tilt", 67: "ignition", 69: "starter", 70: "throttle",
    71: "tracker yaw", 72: "tracker pitch", 73: "throttle port", 74: "throttle starboard", 75: "left motor tilt",
    76: "right motor tilt", 77: "elevon left", 78: "elevon right", 79: "V-tail left", 80: "V-tail right",
    81: "boost throttle", 86: "differential spoiler left 2", 87: "differential spoiler right 2", 88: "winch",
    89: "mainsail sheet", 90: "camera ISO", 91: "camera aperture", 92: "camera focus", 93: "camera shutter",
    110: "airbrake", 120: "NeoPixel 1", 121: "NeoPixel 2", 122: "NeoPixel 3", 123: "NeoPixel 4", 124: "roll",
    125: "pitch", 126: "thrust", 127: "yaw", 128: "wingsail elevator", 129: "ProfiLED 1", 130: "ProfiLED 2",
    131: "ProfiLED 3", 132: "ProfiLED clock", 133: "winch clutch", 134: "at minimum", 135: "at trim",
    136: "at maximum", 137: "mast rotation", 138: "alarm", 139: "alarm, inverted", 156: "lift release",
    180: "camera zoom", 181: "lights 1", 182: "lights 2", 183: "video switch",
}  # fmt: skip
_SERVO_RANGES = (
    (33, 40, "motor", 1),
    (51, 66, "RC input", 1),
    (82, 85, "motor", 9),
    (94, 109, "script", 1),
    (140, 155, "RC input, scaled,", 1),
    (160, 179, "motor", 13),
    (184, 189, "actuator", 1),
)


def servo_function_name(number: int) -> str:
    """Name of a value of SERVOn_FUNCTION; "function 250" if it is unknown."""
    if number in _SERVO_FUNCTIONS:
        return _SERVO_FUNCTIONS[number]
    for low, high, word, first in _SERVO_RANGES:
        if low <= number <= high:
            return f"{word} {number - low + first}"
    return f"function {number}"


# Numbers of EV, ERR and ARM, bits of internal errors and of EKF flags, by name.
#
# EV and ERR: LogEvent, LogErrorSubsystem and LogErrorCode of libraries/AP_Logger/AP_Logger.h, and those of older
# versions; ARM: Method and Check of libraries/AP_Arming; internal errors (MON.IErr, WDOG.IErr): libraries/
# AP_InternalError; EKF2 and EKF3: libraries/AP_NavEKF/AP_Nav_Common.h, libraries/AP_NavEKF3.

# Bits of XKF4.SS; the lowest ten are those of EKF_STATUS_REPORT.flags.
EKF_ABSOLUTE, EKF_CONSTANT_POSITION, EKF_GPS_GLITCHING, EKF_DEAD_RECKONING = 1 << 4, 1 << 7, 1 << 14, 1 << 18

EKF_TIMEOUTS: Mapping[int, str] = {  # XKF4.TS
    0: "position", 1: "velocity", 2: "height", 3: "compass", 4: "airspeed", 5: "drag",
}  # fmt: skip
EKF_TIMEOUTS_THAT_COUNT = 0b1111
"""Relevant timeouts. Airspeed and drag time out on every vehicle without such a sensor."""

EKF_FAULTS: Mapping[int, str] = {  # XKF4.FS
    0: "quaternion not a number", 1: "velocity not a number", 2: "fusion of compass X badly conditioned",
    3: "fusion of compass Y badly conditioned", 4: "fusion of compass Z badly conditioned",
    5: "fusion of airspeed badly conditioned", 6: "fusion of sideslip badly conditioned", 7: "not initialised",
}  # fmt: skip
EKF_NOT_INITIALISED = 1 << 7

EKF_GPS_CHECKS: Mapping[int, str] = {  # XKF4.GPS
    0: "speed accuracy", 1: "horizontal accuracy", 2: "yaw error", 3: "satellites",
    4: "vertical velocity inconsistent", 5: "drifting", 6: "HDOP", 7: "vertical speed", 8: "no 3D fix",
    9: "horizontal speed", 10: "vertical accuracy",
}  # fmt: skip
EKF_ACTIVE: Mapping[int, str] = {0: "DCM", 2: "EKF2", 3: "EKF3", 10: "simulated truth", 11: "external AHRS"}  # ATT.AEKF
EKF_MAG_FUSION: Mapping[int, str] = {0: "none", 1: "yaw", 2: "full field"}
EKF_SOURCE_SETS: Mapping[int, str] = {0: "primary", 1: "secondary", 2: "tertiary"}


def bit_names(names: Mapping[int, str], value: int) -> tuple[str, ...]:
    """Names of the bits set in `value`; "bit 21" for a bit without a name."""
    return tuple(names.get(bit, f"bit {bit}") for bit in range(max(value, 0).bit_length()) if value >> bit & 1)


ARMED, DISARMED = 10, 11
EKF_ALT_RESET, EKF_YAW_RESET = 60, 62

EVENTS: Mapping[int, str] = {
    7: "AP state", 8: "system time set", 9: "simple bearing set", 10: "armed", 11: "disarmed", 15: "armed by itself",
    17: "perhaps landed", 18: "landed", 19: "GPS lost", 21: "flip begins", 22: "flip ends", 25: "home set",
    26: "simple mode on", 27: "simple mode off", 28: "not landed", 29: "super simple mode on", 30: "autotune begins",
    31: "autotune off", 32: "autotune begins again", 33: "autotune succeeded", 34: "autotune failed",
    35: "autotune reached its limit", 36: "autotune: the pilot tests", 37: "autotune gains saved", 38: "trim saved",
    39: "waypoint saved", 41: "fence on", 42: "fence off", 43: "acro trainer off", 44: "acro trainer levelling",
    45: "acro trainer limited", 46: "gripper grabs", 47: "gripper releases", 49: "parachute off", 50: "parachute on",
    51: "parachute released", 52: "landing gear down", 53: "landing gear up", 54: "motors stopped in emergency",
    55: "emergency stop cleared", 56: "motor interlock off", 57: "motor interlock on", 58: "rotor up to speed",
    59: "rotor too slow", 60: "EKF height reset", 61: "landing cancelled by the pilot", 62: "EKF yaw reset",
    63: "ADS-B avoidance on", 64: "ADS-B avoidance off", 65: "proximity avoidance on", 66: "proximity avoidance off",
    67: "primary GPS changed", 68: "winch relaxed", 69: "winch: length control", 70: "winch: rate control",
    71: "zigzag point A stored", 72: "zigzag point B stored", 73: "landing moved by the pilot", 74: "standby on",
    75: "standby off", 76: "upper height fence on", 77: "upper height fence off", 78: "circular fence on",
    79: "circular fence off", 80: "lower height fence on", 81: "lower height fence off", 82: "polygon fence on",
    83: "polygon fence off", 85: "EKF sources: primary set", 86: "EKF sources: secondary set",
    87: "EKF sources: tertiary set", 90: "primary airspeed sensor changed", 163: "surfaced",
    164: "not at the surface", 165: "at the bottom", 166: "not at the bottom",
}  # fmt: skip


def event_name(number: int) -> str:
    return EVENTS.get(number, f"event {number}")


ERR_MAIN, ERR_RADIO, ERR_COMPASS, ERR_RC_FAILSAFE, ERR_BATTERY_FAILSAFE, ERR_GCS_FAILSAFE, ERR_FENCE = (
    1,
    2,
    3,
    5,
    6,
    8,
    9,
)
ERR_MODE_REFUSED, ERR_GPS, ERR_CRASH, ERR_PARACHUTE = 10, 11, 12, 15
ERR_EKF_CHECK, ERR_EKF_FAILSAFE, ERR_BARO, ERR_CPU = 16, 17, 18, 19
ERR_NAVIGATION, ERR_TERRAIN_FAILSAFE, ERR_EKF_PRIMARY, ERR_THRUST_LOSS = 22, 23, 24, 25
ERR_SENSORS, ERR_LEAK, ERR_VIBRATION, ERR_INTERNAL, ERR_DEAD_RECKONING = 26, 27, 29, 30, 31

SUBSYSTEMS: Mapping[int, str] = {
    ERR_MAIN: "main", ERR_RADIO: "radio", ERR_COMPASS: "compass", 4: "optical flow",
    ERR_RC_FAILSAFE: "radio failsafe", ERR_BATTERY_FAILSAFE: "battery failsafe", 7: "GPS failsafe",
    ERR_GCS_FAILSAFE: "ground station failsafe", ERR_FENCE: "fence", ERR_MODE_REFUSED: "mode", ERR_GPS: "GPS",
    ERR_CRASH: "crash check", 13: "flip", 14: "autotune", ERR_PARACHUTE: "parachute", ERR_EKF_CHECK: "EKF check",
    ERR_EKF_FAILSAFE: "EKF failsafe", ERR_BARO: "barometer", ERR_CPU: "CPU failsafe", 20: "ADS-B failsafe",
    21: "terrain data", ERR_NAVIGATION: "navigation", ERR_TERRAIN_FAILSAFE: "terrain failsafe",
    ERR_EKF_PRIMARY: "EKF primary", ERR_THRUST_LOSS: "thrust loss check", ERR_SENSORS: "sensor failsafe",
    ERR_LEAK: "leak", 28: "pilot input failsafe", ERR_VIBRATION: "vibration failsafe", ERR_INTERNAL: "internal error",
    ERR_DEAD_RECKONING: "dead reckoning failsafe",
}  # fmt: skip
_CODES: Mapping[tuple[int, int], str] = {
    (ERR_MAIN, 1): "INS delay", (ERR_RADIO, 2): "late frame", (ERR_CRASH, 1): "crash",
    (ERR_CRASH, 2): "loss of control", (13, 2): "abandoned", (ERR_PARACHUTE, 2): "too low",
    (ERR_PARACHUTE, 3): "landed", (ERR_EKF_CHECK, 2): "bad variance", (ERR_BARO, 2): "glitch",
    (ERR_BARO, 3): "bad depth", (ERR_GPS, 2): "glitch", (21, 2): "missing",
    (ERR_NAVIGATION, 2): "destination refused", (ERR_NAVIGATION, 3): "return started again",
    (ERR_NAVIGATION, 4): "circle refused", (ERR_NAVIGATION, 5): "destination outside the fence",
    (ERR_NAVIGATION, 6): "return needs a rangefinder", (ERR_SENSORS, 3): "bad depth", (ERR_INTERNAL, 1): "detected",
    (ERR_THRUST_LOSS, 1): "detected", (ERR_LEAK, 1): "detected",
}  # fmt: skip
_FAILSAFES = frozenset({5, 6, 7, 8, 17, 19, 20, 23, 26, 28, 29, 31})
_FENCES = ((1, "upper height"), (2, "circle"), (4, "polygon"), (8, "lower height"))
# Code 0 clears the last error of a subsystem; errors of the following subsystems are instants.
_AT_ONCE = frozenset(
    {ERR_MODE_REFUSED, 13, 14, ERR_PARACHUTE, ERR_NAVIGATION, ERR_EKF_PRIMARY, ERR_CRASH, ERR_INTERNAL, ERR_THRUST_LOSS}
)


def subsystem_name(subsystem: int) -> str:
    return SUBSYSTEMS.get(subsystem, f"subsystem {subsystem}")


def is_failsafe_error(subsystem: int) -> bool:
    """Whether an error of the subsystem is a failsafe that acts."""
    return subsystem in _FAILSAFES or subsystem == ERR_FENCE


def error_persists(subsystem: int) -> bool:
    """Whether an error of the subsystem persists until it is cleared. Other errors are instants."""
    return subsystem not in _AT_ONCE


def error_name(subsystem: int, code: int, kind: VehicleKind = "unknown") -> str:
    """Name of an error, such as "EKF check: bad variance". Code 0 of a persistent error is "compass: resolved"."""
    return f"{subsystem_name(subsystem)}: {_code_name(subsystem, code, kind)}"


def _code_name(subsystem: int, code: int, kind: VehicleKind) -> str:
    if subsystem == ERR_EKF_PRIMARY:
        return f"lane {code}"
    if subsystem == ERR_MODE_REFUSED:
        return f"{mode_name(kind, code)} refused"
    if code == 0:
        return "resolved"
    if subsystem == ERR_FENCE:
        names = [name for bit, name in _FENCES if code & bit]
        return f"{', '.join(names) or code} breached"
    named = _CODES.get((subsystem, code))
    if named is not None:
        return named
    if subsystem in _FAILSAFES:
        return "occurred" if code == 1 else f"occurred, code {code}"
    return {1: "failed to initialise", 4: "unhealthy"}.get(code, f"code {code}")


WATCHDOG_RESET = 1 << 11

INTERNAL_ERRORS: Mapping[int, str] = {
    0: "logger: mapping failed", 1: "logger: structure missing", 2: "logger: format missing",
    3: "logger: too many deletions", 4: "logger: bad file name", 5: "panic",
    6: "logger: flushed without the semaphore", 7: "logger: bad block", 8: "logger: block count",
    9: "logger: dequeue failed", 10: "not a number constrained", 11: "watchdog reset", 12: "IOMCU reset",
    13: "IOMCU failed", 14: "SPI failed", 15: "main loop stuck", 16: "mission protocol link", 17: "bitmask range",
    18: "telemetry offset", 19: "I2C interrupts", 20: "flow of control", 21: "full sector recursion",
    22: "bad rotation", 23: "stack overflow", 24: "IMU reset", 25: "GPIO interrupts", 26: "memory guard",
    27: "DMA failed", 28: "parameters restored from backup", 29: "invalid argument or result",
}  # fmt: skip


def internal_error_names(mask: int) -> tuple[str, ...]:
    return bit_names(INTERNAL_ERRORS, mask)


ARMING_METHODS: Mapping[int, str] = {
    0: "rudder stick", 1: "ground station", 2: "auxiliary switch", 3: "motor test", 4: "script", 5: "termination",
    6: "CPU failsafe", 7: "battery failsafe", 8: "pause when landed", 9: "advanced failsafe", 10: "ADS-B collision",
    11: "parachute released", 12: "crash check", 13: "landed", 14: "end of mission", 15: "fence breached",
    16: "radio failsafe", 17: "disarm delay", 18: "ground station failsafe", 19: "terrain failsafe",
    20: "failsafe: terminate", 21: "terrain failsafe", 22: "motor detection done", 23: "bad flow of control",
    24: "EKF failsafe", 25: "ground station failsafe, surfacing failed",
    26: "ground station failsafe, holding failed", 27: "take-off took too long", 28: "landed by itself",
    29: "pilot input failsafe", 30: "toy mode: land, throttle", 31: "toy mode: land, forced", 32: "landing",
    33: "dead reckoning failsafe", 34: "black box", 35: "DDS", 36: "armed once by itself", 37: "turtle mode",
    38: "toy mode", 100: "unknown",
}  # fmt: skip
FAILSAFE_ARMING_METHODS = frozenset({5, 6, 7, 9, 10, 12, 15, 16, 18, 19, 20, 21, 23, 24, 25, 26, 29, 33})
"""Methods that are a failsafe action of the autopilot."""
OPERATOR_ARMING_METHODS = frozenset({0, 1, 2})
"""Methods by which a person arms and disarms."""

ALL_CHECKS = 1
ARMING_CHECKS: Mapping[int, str] = {
    0: "all", 1: "barometer", 2: "compass", 3: "GPS", 4: "INS", 5: "parameters", 6: "RC", 7: "board voltage",
    8: "battery", 9: "airspeed", 10: "logging", 11: "safety switch", 12: "GPS configuration", 13: "system",
    14: "mission", 15: "rangefinder", 16: "camera", 17: "auxiliary authorisation", 18: "visual odometry", 19: "FFT",
    20: "OSD",
}  # fmt: skip


def arming_method_name(number: int) -> str:
    return ARMING_METHODS.get(number, f"method {number}")


def checks_left_out(enabled: int) -> tuple[str, ...]:
    """Names of the checks without a bit in `enabled` (ARM.ArmChecks, ARMING_CHECK)."""
    if enabled & ALL_CHECKS:
        return ()
    return tuple(name for bit, name in ARMING_CHECKS.items() if bit and not enabled >> bit & 1)
