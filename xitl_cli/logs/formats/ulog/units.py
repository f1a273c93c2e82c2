"""Units of the columns of PX4's messages. A ULog has no units; these are from PX4's message definitions (msg/*.msg).

Suffixes give the unit of a field (`_us`, `_rad`, `_v` …). The fields of the messages that analyses use are listed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Measure:
    """Unit of a field."""

    unit: str = ""
    raw_unit: str = ""
    divisor: float = 1.0
    """From the stored number, in raw_unit, to a number in unit."""


_SUFFIXES: Mapping[str, str] = {
    "m": "m", "s": "s", "ms": "ms", "us": "us", "usec": "us", "deg": "deg", "rad": "rad", "m_s": "m/s", "v": "V",
    "a": "A", "w": "W", "celcius": "degC", "celsius": "degC", "degc": "degC", "pa": "Pa", "hz": "Hz", "ns": "ns",
    "rpm": "rpm", "wh": "Wh", "mah": "mAh",
}  # fmt: skip
_LOCAL = {
    **dict.fromkeys(("x", "y", "z", "eph", "epv", "ref_alt", "dist_bottom"), "m"),
    **dict.fromkeys(("vx", "vy", "vz", "evh", "evv", "z_deriv"), "m/s"),
    **dict.fromkeys(("ax", "ay", "az"), "m/s/s"),
    **dict.fromkeys(("ref_lat", "ref_lon"), "deg"),
    "heading": "rad",
}
_GLOBAL = {**dict.fromkeys(("lat", "lon"), "deg"), **dict.fromkeys(("alt", "alt_ellipsoid", "eph", "epv"), "m")}
_WHOLE_FIX = {
    **dict.fromkeys(("lat", "lon"), Measure("deg", "1e-7 deg", 1e7)),
    **dict.fromkeys(("alt", "alt_ellipsoid"), Measure("m", "mm", 1e3)),
}
"""Until 1.14, a fix was in whole numbers."""
_FIX = dict.fromkeys(("eph", "epv"), "m")
_BY_MESSAGE: Mapping[str, Mapping[str, str]] = {
    "vehicle_local_position": _LOCAL,
    "vehicle_local_position_groundtruth": _LOCAL,
    "vehicle_global_position": _GLOBAL,
    "vehicle_global_position_groundtruth": _GLOBAL,
    "vehicle_gps_position": _FIX,
    "sensor_gps": _FIX,
    "sensor_combined": {"gyro_rad": "rad/s", "accelerometer_m_s2": "m/s/s"},
    "sensor_gyro": dict.fromkeys("xyz", "rad/s"),
    "sensor_accel": dict.fromkeys("xyz", "m/s/s"),
    "sensor_mag": dict.fromkeys("xyz", "Gauss"),
    "vehicle_magnetometer": {"magnetometer_ga": "Gauss"},
    "vehicle_angular_velocity": {"xyz": "rad/s"},
    "vehicle_acceleration": {"xyz": "m/s/s"},
    "sensor_baro": {"pressure": "Pa", "temperature": "degC"},
    "vehicle_rates_setpoint": dict.fromkeys(("roll", "pitch", "yaw"), "rad/s"),
    "input_rc": {"values": "us"},
    "dropouts": {"duration": "ms"},
}


def measure_of(message: str, field: str, *, whole: bool = False) -> Measure:
    """Measure of a field; empty if unknown. whole: the field has whole numbers."""
    if whole and message in ("vehicle_gps_position", "sensor_gps") and field in _WHOLE_FIX:
        return _WHOLE_FIX[field]
    unit = _unit(message, field)
    return Measure(unit, unit)


def _unit(message: str, field: str) -> str:
    if field.startswith(("timestamp", "time_")):
        return "us"
    known = _BY_MESSAGE.get(message, {}).get(field)
    if known is not None:
        return known
    words = field.rpartition(".")[2].split("_")
    suffixes = ("_".join(words[-length:]) for length in (2, 1) if length < len(words))
    return next((_SUFFIXES[suffix] for suffix in suffixes if suffix in _SUFFIXES), "")
