"""The host's messages as the samples that a simulated unit has measured, and what the unit makes of them."""

from __future__ import annotations

from typing import Callable

from agent.bridges.gps_time import GpsTime, fixed, of_unix_time
from agent.bridges.navigation_solution import NavigationSolution
from agent.bridges.samples import Navigation, ReceiverFix
from agent.fcu.samples import BarometerSample, ImuSample, MagnetometerSample
from agent.wire.codec import Message

LATEST_US = (1 << 62) // 1000
LARGEST = 1e7  # of any value in its unit: a sensor that says more, or no number, has measured nothing


def imu_of(message: Message) -> ImuSample | None:
    """An XITL_IMU; None for what no sensor measures."""
    gx, gy, gz = message.gyro
    fx, fy, fz = message.accel
    if not _is_measured(message.time_usec, gx, gy, gz, fx, fy, fz, message.temperature):
        return None
    return ImuSample(message.time_usec * 1000, (gx, gy, gz), (fx, fy, fz), message.temperature)


def field_of(message: Message) -> MagnetometerSample | None:
    """An XITL_MAGNETOMETER; None for what no sensor measures."""
    x, y, z = message.field
    return MagnetometerSample(message.time_usec * 1000, (x, y, z)) if _is_measured(message.time_usec, x, y, z) else None


def pressure_of(message: Message) -> BarometerSample | None:
    """An XITL_BAROMETER; None for what no sensor measures."""
    if not _is_measured(message.time_usec, message.pressure, message.temperature):
        return None
    return BarometerSample(message.time_usec * 1000, message.pressure, message.temperature)


def fix_of(message: Message, time: GpsTime) -> ReceiverFix | None:
    """An XITL_GNSS; None for what no receiver says."""
    vn, ve, vd = message.velocity
    if not _is_measured(message.time_usec, vn, ve, vd, message.h_acc, message.v_acc, message.s_acc):
        return None
    stamp_ns = message.time_usec * 1000
    return ReceiverFix(
        stamp_ns,
        time.at(stamp_ns),
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


class Readings:
    """Of one run: the newest samples of the slow sensors, the date, and the solution of the unit's own estimator.

    field, pressure: None before the first. refused: messages that were no measurement; they are passed over. The date
    is fixed in lockstep, else that of `unix_s` at the first inertial sample. Without `solves` there is no solution.
    """

    def __init__(self, lockstep: bool, unix_s: Callable[[], float], solves: bool = True) -> None:
        self.field: MagnetometerSample | None = None
        self.pressure: BarometerSample | None = None
        self.refused = 0
        self._lockstep = lockstep
        self._unix_s = unix_s
        self._time: GpsTime | None = None
        self._solves = solves
        self._solver: NavigationSolution | None = None

    def imu(self, message: Message) -> ImuSample | None:
        """The sample, None when it is refused."""
        sample = imu_of(message)
        if sample is None:
            self.refused += 1
        elif self._time is None:
            self._time = fixed() if self._lockstep else of_unix_time(self._unix_s(), sample.stamp_ns)
            self._solver = NavigationSolution(self._time) if self._solves else None
        return sample

    def fix(self, message: Message) -> ReceiverFix | None:
        """The fix, None when it is refused."""
        fix = fix_of(message, self._time or fixed())
        self.refused += fix is None
        return fix

    def take_field(self, message: Message) -> bool:
        """Whether there is a new field."""
        sample = field_of(message)
        if sample is None:
            self.refused += 1
            return False
        self.field = sample
        if self._solver is not None:
            self._solver.on_magnetometer(sample)
        return True

    def take_pressure(self, message: Message) -> bool:
        """Whether there is a new pressure."""
        sample = pressure_of(message)
        if sample is None:
            self.refused += 1
            return False
        self.pressure = sample
        if self._solver is not None:
            self._solver.on_barometer(sample)
        return True

    def solve(self, sample: ImuSample | ReceiverFix) -> None:
        """Let the estimator have a sample; it takes a while, so that what is urgent goes out before."""
        if self._solver is None:
            return
        if isinstance(sample, ImuSample):
            self._solver.on_imu(sample)
        else:
            self._solver.on_fix(sample)

    def newest(self) -> Navigation | None:
        """The solution at the newest inertial sample, None while there is none."""
        return None if self._solver is None else self._solver.newest()
