"""Commands of a mission (MAV_CMD) and the frames of their places (MAV_FRAME), as far as ArduPilot takes them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

WAYPOINT, SPLINE = 16, 82

COMMANDS: Mapping[int, str] = MappingProxyType(
    {
        16: "WAYPOINT",
        17: "LOITER_UNLIM",
        18: "LOITER_TURNS",
        19: "LOITER_TIME",
        20: "RETURN_TO_LAUNCH",
        21: "LAND",
        22: "TAKEOFF",
        30: "CONTINUE_AND_CHANGE_ALT",
        31: "LOITER_TO_ALT",
        82: "SPLINE_WAYPOINT",
        83: "ALTITUDE_WAIT",
        84: "VTOL_TAKEOFF",
        85: "VTOL_LAND",
        92: "GUIDED_ENABLE",
        93: "DELAY",
        94: "PAYLOAD_PLACE",
        112: "CONDITION_DELAY",
        114: "CONDITION_DISTANCE",
        115: "CONDITION_YAW",
        176: "DO_SET_MODE",
        177: "DO_JUMP",
        178: "DO_CHANGE_SPEED",
        179: "DO_SET_HOME",
        181: "DO_SET_RELAY",
        182: "DO_REPEAT_RELAY",
        183: "DO_SET_SERVO",
        184: "DO_REPEAT_SERVO",
        188: "DO_RETURN_PATH_START",
        189: "DO_LAND_START",
        194: "DO_SET_REVERSE",
        201: "DO_SET_ROI",
        203: "DO_DIGICAM_CONTROL",
        205: "DO_MOUNT_CONTROL",
        206: "DO_SET_CAM_TRIGG_DIST",
        207: "DO_FENCE_ENABLE",
        208: "DO_PARACHUTE",
        210: "DO_INVERTED_FLIGHT",
        211: "DO_GRIPPER",
        212: "DO_AUTOTUNE_ENABLE",
        215: "DO_SET_RESUME_REPEAT_DIST",
        216: "DO_SPRAYER",
        218: "DO_AUX_FUNCTION",
        222: "DO_GUIDED_LIMITS",
        223: "DO_ENGINE_CONTROL",
        600: "JUMP_TAG",
        601: "DO_JUMP_TAG",
        1000: "DO_GIMBAL_MANAGER_PITCHYAW",
        42702: "SCRIPT_TIME",
        42703: "ATTITUDE_TIME",
    }
)
PLACES = frozenset({16, 17, 18, 19, 21, 22, 31, 82, 84, 85, 94})
"""Commands that go to a place."""

FRAMES: Mapping[int, str] = MappingProxyType(
    {
        0: "above sea level",
        3: "above home",
        5: "above sea level",
        6: "above home",
        10: "above terrain",
        11: "above terrain",
    }
)


def command_name(number: int) -> str:
    return COMMANDS.get(number, f"command {number}")
