"""Measurements of the sensors and the estimate from them, without MAVLink.

`stamp_ns` is the instant of a measurement, on the sensors' clock. These are named tuples, because a tuple has a third
of the cost of a dataclass. A slow board creates 200 measurements a second.
"""

from __future__ import annotations

from typing import NamedTuple

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class ImuMeasurement(NamedTuple):
    """Angular rate and specific force in body FRD."""

    stamp_ns: int
    gyro_frd_radps: Vector3
    accel_frd_mps2: Vector3
    temperature_degc: float = 20.0


class GnssMeasurement(NamedTuple):
    """Position and velocity of the antenna, with accuracies as a receiver reports them."""

    stamp_ns: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    vel_ned_mps: Vector3
    horizontal_accuracy_m: float = 1.0
    """RMS error of both horizontal axes together."""
    vertical_accuracy_m: float = 1.0
    """RMS error of the vertical axis."""
    speed_accuracy_mps: float = 0.2
    """RMS error of all three axes of the velocity together."""
    fix_type: int = 3
    """3 is a three-dimensional fix."""
    satellites: int = 10


class MagnetometerMeasurement(NamedTuple):
    """Magnetic field in body FRD."""

    stamp_ns: int
    field_frd_gauss: Vector3


class BarometerMeasurement(NamedTuple):
    """Static pressure."""

    stamp_ns: int
    pressure_pa: float
    temperature_degc: float = 20.0


class StateEstimate(NamedTuple):
    """Estimate of the body origin."""

    stamp_ns: int
    """Sensors' clock."""
    quat_ned_frd: Quaternion
    """(w, x, y, z), body FRD to NED."""
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    gyro_frd_radps: Vector3
    """Angular rate without the estimated bias."""
    pos_ned_m: Vector3
    """From the estimator's origin."""
    vel_ned_mps: Vector3
    attitude_valid: bool
    position_valid: bool
    """Whether position and velocity are good enough for steering."""


class ArmingProblem(NamedTuple):
    """Reason against arming."""

    check: str
    """Part that was checked."""
    text: str
    """ArduPilot's words."""
