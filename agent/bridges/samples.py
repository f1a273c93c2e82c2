"""What a simulated navigation unit measures, whoever made it (plain values, SI, FRD and NED), and the date it gives."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.fcu.vehicle_state import Quaternion, Vector3

SECOND_NS = 1_000_000_000
WEEK_S = 7 * 86_400
EPOCH_UNIX_S = 315_964_800  # 1980-01-06 00:00 UTC
LEAP_S = 18  # by which GPS time is ahead of UTC since 2017
START_OF_RUNS_S = 2_371 * WEEK_S  # 2025-06-15 00:00 GPS time: the date of runs that have to repeat themselves
_YEAR_S = 365.2425 * 86_400
_FIRST_YEAR = 1980.0 + 5.0 / 366.0


class GpsTime(NamedTuple):
    """GPS time of the sensors' clock. zero_ns: at its zero, in nanoseconds since the GPS epoch."""

    zero_ns: int

    def gps_ns(self, stamp_ns: int) -> int:
        """Nanoseconds since the GPS epoch."""
        return self.zero_ns + stamp_ns

    def year_at(self, stamp_ns: int) -> float:
        """Decimal year."""
        return _FIRST_YEAR + self.gps_ns(stamp_ns) / SECOND_NS / _YEAR_S

    @classmethod
    def fixed(cls) -> GpsTime:
        """The same date for every run."""
        return cls(START_OF_RUNS_S * SECOND_NS)

    @classmethod
    def from_unix_time(cls, unix_s: float, stamp_ns: int) -> GpsTime:
        """The date at `stamp_ns` is `unix_s`; the fixed one on a board that does not know its date."""
        gps_s = unix_s - EPOCH_UNIX_S + LEAP_S
        if gps_s < START_OF_RUNS_S:
            return cls.fixed()
        return cls(round(gps_s * SECOND_NS) - stamp_ns)


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

    The altitude is above mean sea level; accuracies are one sigma.
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

    The quaternion is (w, x, y, z), body FRD to NED, `euler_rad` (roll, pitch, yaw); accuracies are one sigma.
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
