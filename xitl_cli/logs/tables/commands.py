"""Mission commands (MAV_CMD) and frames (MAV_FRAME) that ArduPilot accepts, RC auxiliary and servo functions.

RCx_OPTION and AUXF.function: AUX_FUNC of libraries/RC_Channel/RC_Channel.h; SERVOn_FUNCTION: SRV_Channel::Function.
"""

from __future__ import annotations

from collections.abc import Mapping

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
