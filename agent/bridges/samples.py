"""What a simulated navigation unit measures (plain values, SI, FRD and NED), whoever made it."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.fcu.vehicle_state import Quaternion, Vector3

RANGE_ERROR_M = 1.0  # one sigma of a range in the open, which makes an accuracy of a dilution of precision


class InertialSample(NamedTuple):
    """Rate and specific force at `stamp_ns`, with the newest field, pressure and temperature beside them."""

    stamp_ns: int
    gyro_frd_radps: Vector3
    accel_frd_mps2: Vector3
    field_frd_gauss: Vector3
    pressure_pa: float
    temperature_degc: float


class Dilution(NamedTuple):
    """Dilutions of precision, without unit."""

    geometric: float
    position: float
    time: float
    vertical: float
    horizontal: float
    north: float
    east: float


class ReceiverFix(NamedTuple):
    """A fix at `stamp_ns`, which is `gps_ns` since the GPS epoch of 1980; `fix_type` 0 none, 2 or 3 dimensions.

    The altitude is above mean sea level; accuracies are those of a GnssMeasurement.
    """

    stamp_ns: int
    gps_ns: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    vel_ned_mps: Vector3
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    speed_accuracy_mps: float
    fix_type: int
    satellites: int

    @property
    def dilution(self) -> Dilution:
        """As far as accuracies tell it: those over the error of one range; time like the vertical, north like east."""
        horizontal = min(self.horizontal_accuracy_m / RANGE_ERROR_M, 99.0)
        vertical = min(self.vertical_accuracy_m / RANGE_ERROR_M, 99.0)
        position = math.hypot(horizontal, vertical)
        part = horizontal * math.sqrt(0.5)
        return Dilution(math.hypot(position, vertical), position, vertical, vertical, horizontal, part, part)


class Navigation(NamedTuple):
    """What the unit makes of its own sensors at `stamp_ns`; `fix_gps_ns` is the GPS time of its newest fix.

    The quaternion is (w, x, y, z), body FRD to NED, `euler_rad` (roll, pitch, yaw); accuracies are one sigma of an
    axis.
    """

    stamp_ns: int
    fix_gps_ns: int
    quat_ned_frd: Quaternion
    euler_rad: Vector3
    lat_deg: float
    lon_deg: float
    alt_m: float
    vel_ned_mps: Vector3
    tilt_accuracy_deg: float
    heading_accuracy_deg: float
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    speed_accuracy_mps: float
