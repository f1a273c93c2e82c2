"""Numbers of EV, ERR and ARM, bits of internal errors and of EKF flags, by name.

EV and ERR: LogEvent, LogErrorSubsystem and LogErrorCode of libraries/AP_Logger/AP_Logger.h, and those of older
versions; ARM: Method and Check of libraries/AP_Arming; internal errors (MON.IErr, WDOG.IErr): libraries/
AP_InternalError; EKF2 and EKF3: libraries/AP_NavEKF/AP_Nav_Common.h, libraries/AP_NavEKF3.
"""

from __future__ import annotations

from collections.abc import Mapping

from xitl_cli.logs.tables.modes import mode_name
from xitl_cli.logs.tables.vehicles import VehicleKind

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
