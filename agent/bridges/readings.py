"""Sensor samples from the host's messages, and the navigation solution that a simulated unit computes from them."""

from __future__ import annotations

import math
from typing import Callable

from agent.bridges.declination import declination_rad
from agent.bridges.samples import GpsTime, Navigation, ReceiverFix
from agent.fcu.estimation.estimator import Estimator
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle_state import BarometerMeasurement, GnssMeasurement, ImuMeasurement, MagnetometerMeasurement
from agent.wire.codec import Message

TILT_ACCURACY_DEG, HEADING_ACCURACY_DEG = 0.5, 2.0  # what the estimator keeps at sea; it has no covariance of attitude


class NavigationSolution:
    """Samples in; `newest` is the solution at the newest inertial sample.

    It knows of no lever arms: the place is that of the antenna. The declination is found with the first fix.
    """

    def __init__(self, time: GpsTime) -> None:
        self._time = time
        self._parameters = Parameters()
        self._estimator = Estimator(self._parameters)
        self._fix: ReceiverFix | None = None

    def on_imu(self, sample: ImuMeasurement) -> None:
        """A sample that cannot be true is passed over, as by the others."""
        self._estimator.on_imu(sample)

    def on_magnetometer(self, sample: MagnetometerMeasurement) -> None:
        """Field, FRD."""
        self._estimator.on_magnetometer(sample)

    def on_barometer(self, sample: BarometerMeasurement) -> None:
        """Pressure."""
        self._estimator.on_barometer(sample)

    def on_fix(self, fix: ReceiverFix) -> None:
        """A fix of the receiver, as late as it comes."""
        accepted = self._estimator.on_gnss(
            GnssMeasurement(
                fix.stamp_ns,
                fix.lat_deg,
                fix.lon_deg,
                fix.alt_m,
                fix.vel_ned_mps,
                fix.horizontal_accuracy_m,
                fix.vertical_accuracy_m,
                fix.speed_accuracy_mps,
                fix.fix_type,
                fix.satellites,
            )
        )
        if not accepted or fix.fix_type < 3:
            return
        if self._fix is None:
            year = self._time.year_at(fix.stamp_ns)
            self._parameters.set("COMPASS_DEC", declination_rad(fix.lat_deg, fix.lon_deg, fix.alt_m, year))
            self._estimator.configure()
        self._fix = fix

    def solution(self) -> Navigation | None:
        """None before attitude and place are known, and while they are lost."""
        frame, fix = self._estimator.frame, self._fix
        if frame is None or fix is None:
            return None
        e = self._estimator.estimate()
        if not (e.attitude_valid and e.position_valid):
            return None
        north, east, down = e.pos_ned_m
        lat_deg, lon_deg = frame.to_geodetic(north, east)
        return Navigation(
            e.stamp_ns,
            fix.gps_ns,
            e.quat_ned_frd,
            (e.roll_rad, e.pitch_rad, math.remainder(e.yaw_rad, 2.0 * math.pi)),
            lat_deg,
            lon_deg,
            frame.alt_m - down,
            e.vel_ned_mps,
            TILT_ACCURACY_DEG,
            HEADING_ACCURACY_DEG,
            fix.horizontal_accuracy_m,
            fix.vertical_accuracy_m,
            fix.speed_accuracy_mps,
        )


LATEST_US = (1 << 62) // 1000
LARGEST = 1e7  # of any value in its unit: a sensor that says more, or no number, has measured nothing


def imu_sample_from(message: Message) -> ImuMeasurement | None:
    """An XITL_IMU; None for what no sensor measures."""
    gx, gy, gz = message.gyro
    fx, fy, fz = message.accel
    if not _is_measured(message.time_usec, gx, gy, gz, fx, fy, fz, message.temperature):
        return None
    return ImuMeasurement(message.time_usec * 1000, (gx, gy, gz), (fx, fy, fz), message.temperature)


def magnetometer_sample_from(message: Message) -> MagnetometerMeasurement | None:
    """An XITL_MAGNETOMETER; None for what no sensor measures."""
    x, y, z = message.field
    return (
        MagnetometerMeasurement(message.time_usec * 1000, (x, y, z))
        if _is_measured(message.time_usec, x, y, z)
        else None
    )


def barometer_sample_from(message: Message) -> BarometerMeasurement | None:
    """An XITL_BAROMETER; None for what no sensor measures."""
    if not _is_measured(message.time_usec, message.pressure, message.temperature):
        return None
    return BarometerMeasurement(message.time_usec * 1000, message.pressure, message.temperature)


def receiver_fix_from(message: Message, time: GpsTime) -> ReceiverFix | None:
    """An XITL_GNSS; None for what no receiver says."""
    vn, ve, vd = message.velocity
    if not _is_measured(message.time_usec, vn, ve, vd, message.h_acc, message.v_acc, message.s_acc):
        return None
    stamp_ns = message.time_usec * 1000
    return ReceiverFix(
        stamp_ns,
        time.gps_ns(stamp_ns),
        message.lat * 1e-7,
        message.lon * 1e-7,
        message.alt * 1e-3,
        (vn, ve, vd),
        message.h_acc,
        message.v_acc,
        message.s_acc,
        message.fix_type,
        message.satellites,
    )


def _is_measured(time_us: int, *values: float) -> bool:
    return time_us <= LATEST_US and all(-LARGEST < value < LARGEST for value in values)


class SampleDecimator:
    """Every sample whose turn it is; with `period_ns` 0 each one. Stamps that step back begin anew."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._early_ns = period_ns // 8
        self._next_ns: int | None = None
        self._last_ns = 0

    def is_due(self, stamp_ns: int) -> bool:
        """Whether this sample is to be passed on."""
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
    """Of one run: the newest samples of the slow sensors, the date, and the solution of the unit's own estimator.

    field, pressure: None before the first. refused: messages that were no measurement; they are passed over. The date
    is fixed in lockstep, else that of `unix_s` at the first inertial sample. Without `solves` there is no solution.
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

    def handle_imu(self, message: Message) -> ImuMeasurement | None:
        """The sample, None when it is refused."""
        sample = imu_sample_from(message)
        if sample is None:
            self.refused += 1
        elif self._time is None:
            self._time = GpsTime.fixed() if self._lockstep else GpsTime.from_unix_time(self._unix_s(), sample.stamp_ns)
            self._solver = NavigationSolution(self._time) if self._solves else None
        return sample

    def handle_fix(self, message: Message) -> ReceiverFix | None:
        """The fix, None when it is refused."""
        fix = receiver_fix_from(message, self._time or GpsTime.fixed())
        self.refused += fix is None
        return fix

    def handle_field(self, message: Message) -> bool:
        """Whether there is a new field."""
        sample = magnetometer_sample_from(message)
        if sample is None:
            self.refused += 1
            return False
        self.field = sample
        if self._solver is not None:
            self._solver.on_magnetometer(sample)
        return True

    def handle_pressure(self, message: Message) -> bool:
        """Whether there is a new pressure."""
        sample = barometer_sample_from(message)
        if sample is None:
            self.refused += 1
            return False
        self.pressure = sample
        if self._solver is not None:
            self._solver.on_barometer(sample)
        return True

    def solve(self, sample: ImuMeasurement | ReceiverFix) -> None:
        """Let the estimator have a sample; it takes a while, so that what is urgent goes out before."""
        if self._solver is None:
            return
        if isinstance(sample, ImuMeasurement):
            self._solver.on_imu(sample)
        else:
            self._solver.on_fix(sample)

    def solution(self) -> Navigation | None:
        """The solution at the newest inertial sample, None while there is none."""
        return None if self._solver is None else self._solver.solution()
