"""Measurements of a simulated navigation unit (plain values, SI, FRD and NED), independent of its make."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.navigation.measurements import Quaternion, Vector3

RANGE_ERROR_M = 1.0  # one sigma of a range with open sky; converts an accuracy to a dilution of precision


class InertialSample(NamedTuple):
    """Rate and specific force at `stamp_ns`, with the newest field, pressure and temperature."""

    stamp_ns: int
    gyro_frd_radps: Vector3
    accel_frd_mps2: Vector3
    field_frd_gauss: Vector3
    pressure_pa: float
    temperature_degc: float


class Dilution(NamedTuple):
    """Dilutions of precision, dimensionless."""

    geometric: float
    position: float
    time: float
    vertical: float
    horizontal: float
    north: float
    east: float


class ReceiverFix(NamedTuple):
    """A fix of the receiver. Accuracies are those of a GnssMeasurement."""

    stamp_ns: int
    gps_ns: int
    """Instant of `stamp_ns` since the GPS epoch of 1980."""
    lat_deg: float
    lon_deg: float
    alt_m: float
    """Above mean sea level."""
    vel_ned_mps: Vector3
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    speed_accuracy_mps: float
    fix_type: int
    """0: no fix, 2: two dimensions, 3: three dimensions."""
    satellites: int

    @property
    def dilution(self) -> Dilution:
        """Dilutions derived from the accuracies, divided by the error of one range.

        The time dilution equals the vertical one. North equals east.
        """
        horizontal = min(self.horizontal_accuracy_m / RANGE_ERROR_M, 99.0)
        vertical = min(self.vertical_accuracy_m / RANGE_ERROR_M, 99.0)
        position = math.hypot(horizontal, vertical)
        part = horizontal * math.sqrt(0.5)
        return Dilution(math.hypot(position, vertical), position, vertical, vertical, horizontal, part, part)


class Navigation(NamedTuple):
    """Solution that the unit computes from its own sensors at `stamp_ns`. Accuracies are one sigma per axis."""

    stamp_ns: int
    fix_gps_ns: int
    """GPS time of the newest fix."""
    quat_ned_frd: Quaternion
    """(w, x, y, z), body FRD to NED."""
    euler_rad: Vector3
    """(roll, pitch, yaw)."""
    lat_deg: float
    lon_deg: float
    alt_m: float
    vel_ned_mps: Vector3
    tilt_accuracy_deg: float
    heading_accuracy_deg: float
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    speed_accuracy_mps: float
