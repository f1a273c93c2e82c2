"""Samples of a simulated navigation unit from the host's messages, and its navigation solution.

Samples are plain values (SI, FRD and NED), independent of the make of the unit.
"""

from __future__ import annotations

import math
from typing import Callable, NamedTuple, Union

from agent.bridges.declination import declination_rad
from agent.navigation.estimator import Estimator
from agent.navigation.gps_time import GpsTime
from agent.navigation.measurements import (
    BarometerMeasurement,
    GnssMeasurement,
    ImuMeasurement,
    MagnetometerMeasurement,
    Quaternion,
    Vector3,
)
from agent.navigation.parameters import ESTIMATOR_ROWS
from agent.wire import dialect as mav
from agent.wire.codec import Message

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


TILT_ACCURACY_DEG = 0.5  # accuracy of the estimator at sea; it has no covariance of the tilt

Measurement = Union[ImuMeasurement, MagnetometerMeasurement, BarometerMeasurement, ReceiverFix]


class NavigationSolution:
    """Our own estimator on the samples of a simulated unit, so that the solution has errors like a real one.

    It has no lever arms: the position is the position of the antenna. The first fix sets the declination.
    """

    def __init__(self, time: GpsTime) -> None:
        self._time = time
        self._parameters = {row.name: float(row.default) for row in ESTIMATOR_ROWS}
        self._estimator = Estimator(self._parameters)
        self._fix: ReceiverFix | None = None

    def add(self, sample: Measurement) -> None:
        """Add a sample. The estimator ignores implausible samples."""
        if isinstance(sample, ImuMeasurement):
            self._estimator.on_imu(sample)
        elif isinstance(sample, MagnetometerMeasurement):
            self._estimator.on_magnetometer(sample)
        elif isinstance(sample, BarometerMeasurement):
            self._estimator.on_barometer(sample)
        else:
            fix = GnssMeasurement(
                sample.stamp_ns, sample.lat_deg, sample.lon_deg, sample.alt_m, sample.vel_ned_mps,
                sample.horizontal_accuracy_m, sample.vertical_accuracy_m, sample.speed_accuracy_mps,
                sample.fix_type, sample.satellites,
            )  # fmt: skip
            if not self._estimator.on_gnss(fix) or fix.fix_type < 3:
                return
            if self._fix is None:
                year = self._time.year_at(fix.stamp_ns)
                self._parameters["COMPASS_DEC"] = declination_rad(fix.lat_deg, fix.lon_deg, fix.alt_m, year)
                self._estimator.configure()
            self._fix = sample

    def solution(self) -> Navigation | None:
        """Return the solution, None while attitude or position are unknown."""
        frame, fix = self._estimator.frame, self._fix
        if frame is None or fix is None:
            return None
        e, variances = self._estimator.estimate(), self._estimator.variances()
        if not (e.attitude_valid and e.position_valid) or variances is None:
            return None
        north, east, down = e.pos_ned_m
        lat_deg, lon_deg = frame.to_geodetic(north, east)
        heading_deg = math.degrees(math.sqrt(variances.heading_rad2))
        return Navigation(
            e.stamp_ns, fix.gps_ns, e.quat_ned_frd, (e.roll_rad, e.pitch_rad, math.remainder(e.yaw_rad, 2.0 * math.pi)),
            lat_deg, lon_deg, frame.alt_m - down, e.vel_ned_mps, TILT_ACCURACY_DEG, heading_deg,
            math.sqrt(variances.horizontal_m2), math.sqrt(variances.vertical_m2), math.sqrt(variances.speed_m2ps2),
        )  # fmt: skip


LATEST_US = (1 << 62) // 1000
LARGEST = 1e7  # limit of any value in its unit: a larger or non-finite value is no measurement


def imu_sample_from(message: Message) -> ImuMeasurement | None:
    """Read an XITL_IMU. Return None for values that no sensor can measure."""
    gx, gy, gz = message.gyro
    fx, fy, fz = message.accel
    if not _is_measured(message.time_usec, gx, gy, gz, fx, fy, fz, message.temperature):
        return None
    return ImuMeasurement(message.time_usec * 1000, (gx, gy, gz), (fx, fy, fz), message.temperature)


def magnetometer_sample_from(message: Message) -> MagnetometerMeasurement | None:
    """Read an XITL_MAGNETOMETER. Return None for values that no sensor can measure."""
    x, y, z = message.field
    if not _is_measured(message.time_usec, x, y, z):
        return None
    return MagnetometerMeasurement(message.time_usec * 1000, (x, y, z))


def barometer_sample_from(message: Message) -> BarometerMeasurement | None:
    """Read an XITL_BAROMETER. Return None for values that no sensor can measure."""
    if not _is_measured(message.time_usec, message.pressure, message.temperature):
        return None
    return BarometerMeasurement(message.time_usec * 1000, message.pressure, message.temperature)


def receiver_fix_from(message: Message, time: GpsTime) -> ReceiverFix | None:
    """Read an XITL_GNSS. Return None for values that no receiver can report."""
    vn, ve, vd = message.velocity
    if not _is_measured(message.time_usec, vn, ve, vd, message.h_acc, message.v_acc, message.s_acc):
        return None
    stamp_ns = message.time_usec * 1000
    return ReceiverFix(
        stamp_ns, time.gps_ns(stamp_ns), message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3, (vn, ve, vd),
        message.h_acc, message.v_acc, message.s_acc, message.fix_type, message.satellites,
    )  # fmt: skip


def _is_measured(time_us: int, *values: float) -> bool:
    return time_us <= LATEST_US and all(-LARGEST < value < LARGEST for value in values)


class SampleDecimator:
    """Selects samples at a period. A `period_ns` of 0 selects every sample.

    A stamp that steps back restarts the period.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._early_ns = period_ns // 8
        self._next_ns: int | None = None
        self._last_ns = 0

    def is_due(self, stamp_ns: int) -> bool:
        """Whether this sample is selected."""
        if self._period_ns == 0:
            return True
        if self._next_ns is None or stamp_ns < self._last_ns or stamp_ns > self._next_ns + self._period_ns:
            self._next_ns = stamp_ns
        self._last_ns = stamp_ns
        if stamp_ns + self._early_ns < self._next_ns:
            return False
        self._next_ns += self._period_ns
        return True


class SensorReadings:
    """Samples of one run, the newest samples of the slow sensors, the date, and the unit's navigation solution.

    field, pressure: None before the first sample.
    refused: number of messages with invalid values, which are ignored.
    solves: compute a solution.

    The date is fixed in lockstep. Otherwise it is the value of `unix_s` at the first inertial sample.
    """

    def __init__(self, lockstep: bool, unix_s: Callable[[], float], solves: bool = True) -> None:
        self.field: MagnetometerMeasurement | None = None
        self.pressure: BarometerMeasurement | None = None
        self.refused = 0
        self._lockstep = lockstep
        self._unix_s = unix_s
        self._time: GpsTime | None = None
        self._solves = solves
        self._solver: NavigationSolution | None = None

    def handle(self, message: Message) -> Measurement | None:
        """Return the sample of a sensor message. Return None for a refused message and for any other message.

        Samples of the slow sensors reach the estimator at once. Call `solve` with the other samples.
        """
        sample: Measurement | None
        if isinstance(message, mav.MAVLink_xitl_imu_message):
            sample = imu_sample_from(message)
            if sample is not None and self._time is None:
                is_fixed, stamp_ns = self._lockstep, sample.stamp_ns
                self._time = GpsTime.fixed() if is_fixed else GpsTime.from_unix_time(self._unix_s(), stamp_ns)
                self._solver = NavigationSolution(self._time) if self._solves else None
        elif isinstance(message, mav.MAVLink_xitl_magnetometer_message):
            sample = magnetometer_sample_from(message)
            self.field = sample or self.field
        elif isinstance(message, mav.MAVLink_xitl_barometer_message):
            sample = barometer_sample_from(message)
            self.pressure = sample or self.pressure
        elif isinstance(message, mav.MAVLink_xitl_gnss_message):
            sample = receiver_fix_from(message, self._time or GpsTime.fixed())
        else:
            return None
        self.refused += sample is None
        if isinstance(sample, (MagnetometerMeasurement, BarometerMeasurement)) and self._solver is not None:
            self._solver.add(sample)
        return sample

    def inertial_sample(
        self, imu: ImuMeasurement, pressure_pa: float = 0.0, temperature_degc: float = 0.0
    ) -> InertialSample:
        """Return an IMU sample with the newest field, pressure and temperature.

        Before the first samples, the field is zero and the given pressure and temperature are used.
        """
        field_frd_gauss = (0.0, 0.0, 0.0) if self.field is None else self.field.field_frd_gauss
        if self.pressure is not None:
            pressure_pa, temperature_degc = self.pressure.pressure_pa, self.pressure.temperature_degc
        motion = imu.gyro_frd_radps, imu.accel_frd_mps2
        return InertialSample(imu.stamp_ns, *motion, field_frd_gauss, pressure_pa, temperature_degc)

    def solve(self, sample: ImuMeasurement | ReceiverFix) -> None:
        """Give a sample to the estimator. This takes a while, so send urgent frames first."""
        if self._solver is not None:
            self._solver.add(sample)

    def solution(self) -> Navigation | None:
        """Return the solution at the newest inertial sample, None while there is none."""
        return None if self._solver is None else self._solver.solution()
