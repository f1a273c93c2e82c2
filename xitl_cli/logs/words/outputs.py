"""What an output of ArduPilot drives: names of the values of SERVOn_FUNCTION."""

from __future__ import annotations

PORT_THROTTLE, STARBOARD_THROTTLE = 73, 74
THROTTLE = 70
FIXED = (134, 135, 136)
"""Outputs that stay at SERVOn_MIN, _TRIM or _MAX whatever happens."""

_NAMES = {
    -1: "GPIO", 0: "none", 1: "RC passthrough", 2: "flap", 3: "flap, automatic", 4: "aileron", 6: "mount yaw",
    7: "mount pitch", 8: "mount roll", 9: "mount open", 10: "camera trigger", 12: "mount 2 yaw", 13: "mount 2 pitch",
    14: "mount 2 roll", 15: "mount 2 open", 16: "differential spoiler left 1", 17: "differential spoiler right 1",
    19: "elevator", 21: "rudder", 22: "sprayer pump", 23: "sprayer spinner", 24: "flaperon left", 25: "flaperon right",
    26: "steering", 27: "parachute", 28: "gripper", 29: "landing gear", 30: "engine run enable", 31: "rotor speed",
    32: "tail rotor", 41: "tilt of the motors", 42: "generator", 45: "rear motor tilt", 46: "rear left motor tilt",
    47: "rear right motor tilt", 67: "ignition", 69: "starter", 70: "throttle", 71: "tracker yaw", 72: "tracker pitch",
    73: "throttle port", 74: "throttle starboard", 75: "left motor tilt", 76: "right motor tilt", 77: "elevon left",
    78: "elevon right", 79: "V-tail left", 80: "V-tail right", 81: "boost throttle",
    86: "differential spoiler left 2", 87: "differential spoiler right 2", 88: "winch", 89: "mainsail sheet",
    90: "camera ISO", 91: "camera aperture", 92: "camera focus", 93: "camera shutter", 110: "airbrake",
    120: "NeoPixel 1", 121: "NeoPixel 2", 122: "NeoPixel 3", 123: "NeoPixel 4", 124: "roll", 125: "pitch",
    126: "thrust", 127: "yaw", 128: "wingsail elevator", 129: "ProfiLED 1", 130: "ProfiLED 2", 131: "ProfiLED 3",
    132: "ProfiLED clock", 133: "winch clutch", 134: "at minimum", 135: "at trim", 136: "at maximum",
    137: "mast rotation", 138: "alarm", 139: "alarm, inverted", 156: "lift release", 180: "camera zoom",
    181: "lights 1", 182: "lights 2", 183: "video switch",
}  # fmt: skip
_RANGES = (
    (33, 40, "motor", 1),
    (51, 66, "RC input", 1),
    (82, 85, "motor", 9),
    (94, 109, "script", 1),
    (140, 155, "RC input, scaled,", 1),
    (160, 179, "motor", 13),
    (184, 189, "actuator", 1),
)


def function_name(number: int) -> str:
    """Of a value of SERVOn_FUNCTION; "function 250" of one that is not known."""
    if number in _NAMES:
        return _NAMES[number]
    for low, high, word, first in _RANGES:
        if low <= number <= high:
            return f"{word} {number - low + first}"
    return f"function {number}"
