"""EV: what happened, by number (LogEvent of libraries/AP_Logger/AP_Logger.h, and those that older versions had)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

ARMED, DISARMED = 10, 11
EKF_ALT_RESET, EKF_YAW_RESET, GPS_PRIMARY_CHANGED = 60, 62, 67

EVENTS: Mapping[int, str] = MappingProxyType(
    {
        7: "AP state",
        8: "system time set",
        9: "simple bearing set",
        10: "armed",
        11: "disarmed",
        15: "armed by itself",
        17: "perhaps landed",
        18: "landed",
        19: "GPS lost",
        21: "flip begins",
        22: "flip ends",
        25: "home set",
        26: "simple mode on",
        27: "simple mode off",
        28: "not landed",
        29: "super simple mode on",
        30: "autotune begins",
        31: "autotune off",
        32: "autotune begins again",
        33: "autotune succeeded",
        34: "autotune failed",
        35: "autotune reached its limit",
        36: "autotune: the pilot tests",
        37: "autotune gains saved",
        38: "trim saved",
        39: "waypoint saved",
        41: "fence on",
        42: "fence off",
        43: "acro trainer off",
        44: "acro trainer levelling",
        45: "acro trainer limited",
        46: "gripper grabs",
        47: "gripper releases",
        49: "parachute off",
        50: "parachute on",
        51: "parachute released",
        52: "landing gear down",
        53: "landing gear up",
        54: "motors stopped in emergency",
        55: "emergency stop cleared",
        56: "motor interlock off",
        57: "motor interlock on",
        58: "rotor up to speed",
        59: "rotor too slow",
        60: "EKF height reset",
        61: "landing cancelled by the pilot",
        62: "EKF yaw reset",
        63: "ADS-B avoidance on",
        64: "ADS-B avoidance off",
        65: "proximity avoidance on",
        66: "proximity avoidance off",
        67: "primary GPS changed",
        68: "winch relaxed",
        69: "winch: length control",
        70: "winch: rate control",
        71: "zigzag point A stored",
        72: "zigzag point B stored",
        73: "landing moved by the pilot",
        74: "standby on",
        75: "standby off",
        76: "upper height fence on",
        77: "upper height fence off",
        78: "circular fence on",
        79: "circular fence off",
        80: "lower height fence on",
        81: "lower height fence off",
        82: "polygon fence on",
        83: "polygon fence off",
        85: "EKF sources: primary set",
        86: "EKF sources: secondary set",
        87: "EKF sources: tertiary set",
        90: "primary airspeed sensor changed",
        163: "surfaced",
        164: "not at the surface",
        165: "at the bottom",
        166: "not at the bottom",
    }
)


def event_name(number: int) -> str:
    return EVENTS.get(number, f"event {number}")
