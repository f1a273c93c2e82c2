"""Attitude: initial levelling, then corrections of the integrated attitude toward gravity and the compass.

Mahony, Hamel and Pflimlin 2008, eq 32: the correcting rate is proportional to the error, and the bias is its integral.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.navigation.inertial import InertialState, frd_to_ned, ned_to_frd, quaternion
from agent.navigation.measurements import ImuMeasurement, Vector3

_ZERO: Vector3 = (0.0, 0.0, 0.0)
_BIAS_LIMIT_RADPS = math.radians(3.0)
_ERROR_LIMIT_RAD = 0.3
_BOOST = 4.0
_BOOST_DECAY_S = 6.0
_BIAS_DAMPING = 0.9  # joint damping ratio of attitude and bias error
_BIAS_WAIT_S = 2.0  # the error of levelling must not be estimated as a bias
_DURATION_NS = 2_000_000_000
_LEAST_SAMPLES = 20
_GRAVITY_RANGE_MPS2 = (7.0, 12.5)
_INTERVAL_S = (0.02, 2.0)


class AttitudeCorrection:
    """Correcting rates in body FRD.

    Gains start high and then settle, so that the turn-on bias is estimated in seconds.
    """

    def __init__(self, tilt_gain_per_s: float) -> None:
        self.configure(tilt_gain_per_s)
        self.bias_frd_radps = _ZERO
        self.rate_offset_frd_radps = _ZERO  # added to the measured rate
        self._tilt_rate = _ZERO
        self._yaw_rate = _ZERO
        self._boost = 1.0 + _BOOST
        self._learns = False

    def configure(self, tilt_gain_per_s: float) -> None:
        """Apply a new gain."""
        self._tilt_gain = tilt_gain_per_s

    def settle(self, since_levelled_s: float) -> None:
        """Set the gains for the time since levelling."""
        self._boost = 1.0 + _BOOST * math.exp(-since_levelled_s / _BOOST_DECAY_S)
        self._learns = since_levelled_s >= _BIAS_WAIT_S

    def tilt(self, state: InertialState, north_rad: float, east_rad: float, dt_s: float, trust: float = 1.0) -> None:
        """Correct a tilt error: the estimate is rotated too far about north and east.

        dt_s: interval of the measurement.
        """
        north_rad, east_rad = _limited(north_rad), _limited(east_rad)
        gain = min(self._tilt_gain * self._boost, 0.5 / dt_s) * trust
        self._tilt_rate = ned_to_frd(state, (-gain * north_rad, -gain * east_rad, 0.0))
        self._learn(gain, self._tilt_rate, dt_s)

    def turn(self, state: InertialState, rate_radps: float, bias_radps: float) -> None:
        """Turn the heading at a rate until further notice, and change the bias about the vertical."""
        self._yaw_rate = ned_to_frd(state, (0.0, 0.0, rate_radps))
        change, bias = ned_to_frd(state, (0.0, 0.0, bias_radps)), self.bias_frd_radps
        self.bias_frd_radps = (
            _clamped(bias[0] + change[0], _BIAS_LIMIT_RADPS),
            _clamped(bias[1] + change[1], _BIAS_LIMIT_RADPS),
            _clamped(bias[2] + change[2], _BIAS_LIMIT_RADPS),
        )
        self._sum_up()

    def drop_heading(self) -> None:
        """Stop correcting toward the compass, because it has no data."""
        self._yaw_rate = _ZERO
        self._sum_up()

    def _learn(self, gain: float, rate: Vector3, dt_s: float) -> None:
        """Update the bias. The integral gain is P²/4/damping². `rate` already contains one factor P."""
        if not self._learns:
            self._sum_up()
            return
        share = 0.25 / (_BIAS_DAMPING * _BIAS_DAMPING) * gain * dt_s
        bx, by, bz = self.bias_frd_radps
        self.bias_frd_radps = (
            _clamped(bx - share * rate[0], _BIAS_LIMIT_RADPS),
            _clamped(by - share * rate[1], _BIAS_LIMIT_RADPS),
            _clamped(bz - share * rate[2], _BIAS_LIMIT_RADPS),
        )
        self._sum_up()

    def _sum_up(self) -> None:
        (tx, ty, tz), (yx, yy, yz), (bx, by, bz) = self._tilt_rate, self._yaw_rate, self.bias_frd_radps
        self.rate_offset_frd_radps = (tx + yx - bx, ty + yy - by, tz + yz - bz)


def _limited(error_rad: float) -> float:
    return _clamped(error_rad, _ERROR_LIMIT_RAD)


def _clamped(value: float, limit: float) -> float:
    return limit if value > limit else -limit if value < -limit else value


class InitialAlignment:
    """Averages specific force until an initial attitude is available.

    The average over heave motion is level to a few degrees, which is enough for the attitude filter to start. Turning
    while levelling does no harm, because the heading is from the newest compass sample.
    """

    def __init__(self) -> None:
        self._start_ns = 0
        self._last_ns = 0
        self._count = 0
        self._sum: Vector3 = (0.0, 0.0, 0.0)
        self.field_frd_gauss: Vector3 | None = None

    def add(self, sample: ImuMeasurement, declination_rad: float) -> InertialState | None:
        """Return the initial state when it is available. Samples that go back in time restart the average."""
        if self._count == 0 or not 0 < sample.stamp_ns - self._last_ns <= _DURATION_NS:
            self._start_ns = sample.stamp_ns
            self._count = 0
            self._sum = (0.0, 0.0, 0.0)
        self._last_ns = sample.stamp_ns
        self._count += 1
        fx, fy, fz = sample.accel_frd_mps2
        self._sum = (self._sum[0] + fx, self._sum[1] + fy, self._sum[2] + fz)
        if sample.stamp_ns - self._start_ns < _DURATION_NS or self._count < _LEAST_SAMPLES:
            return None
        fx, fy, fz = (total / self._count for total in self._sum)
        if not _GRAVITY_RANGE_MPS2[0] < math.sqrt(fx * fx + fy * fy + fz * fz) < _GRAVITY_RANGE_MPS2[1]:
            self._count = 0
            return None
        roll_rad = math.atan2(-fy, -fz)
        pitch_rad = math.atan2(fx, math.hypot(fy, fz))
        level = _resting(sample, roll_rad, pitch_rad, 0.0)
        if self.field_frd_gauss is None:
            return level
        return _resting(sample, roll_rad, pitch_rad, heading_error_rad(level, self.field_frd_gauss, declination_rad))


def heading_error_rad(state: InertialState, field_frd_gauss: Vector3, declination_rad: float) -> float:
    """Heading error in [-pi, pi], positive when the true heading exceeds that of `state`, from the horizontal field."""
    field_north, field_east, _ = frd_to_ned(state, field_frd_gauss)
    return math.remainder(declination_rad - math.atan2(field_east, field_north), 2.0 * math.pi)


def turn_heading(state: InertialState, angle_rad: float) -> InertialState:
    """Return the state with its heading changed by `angle_rad`."""
    c, s = math.cos(0.5 * angle_rad), math.sin(0.5 * angle_rad)
    _, w, x, y, z = state[:5]
    return state._replace(w=c * w - s * z, x=c * x - s * y, y=c * y + s * x, z=c * z + s * w)


def _resting(sample: ImuMeasurement, roll_rad: float, pitch_rad: float, yaw_rad: float) -> InertialState:
    zeros = (0.0,) * 9
    return InertialState(
        sample.stamp_ns, *quaternion(roll_rad, pitch_rad, yaw_rad), *zeros, *sample.gyro_frd_radps, 0.0, 0.0
    )


class TiltReference(NamedTuple):
    """Velocity of a fix, with the integrated acceleration up to its instant."""

    stamp_ns: int
    vel_north_mps: float
    vel_east_mps: float
    sum_north_mps: float
    sum_east_mps: float

    @classmethod
    def from_fix(cls, then: InertialState, stamp_ns: int, vel_ned_mps: Vector3) -> TiltReference:
        """Return the reference of a fix. then: last state not newer than the fix."""
        late_s = (stamp_ns - then.stamp_ns) * 1e-9
        return cls(
            stamp_ns,
            vel_ned_mps[0],
            vel_ned_mps[1],
            then.sum_north_mps + late_s * then.acc_north_mps2,
            then.sum_east_mps + late_s * then.acc_east_mps2,
        )

    def accelerated(self, last: TiltReference | None) -> tuple[float, float]:
        """Mean measured acceleration (north, east) since `last`. Zero when `last` is too long ago."""
        dt_s = 0.0 if last is None else (self.stamp_ns - last.stamp_ns) * 1e-9
        if last is None or not _INTERVAL_S[0] < dt_s < _INTERVAL_S[1]:
            return 0.0, 0.0
        return (self.sum_north_mps - last.sum_north_mps) / dt_s, (self.sum_east_mps - last.sum_east_mps) / dt_s

    def unexplained(self, last: TiltReference) -> tuple[float, float, float] | None:
        """Acceleration (north, east) that was integrated but did not occur, and its duration.

        None when too far apart.
        """
        dt_s = (self.stamp_ns - last.stamp_ns) * 1e-9
        if not _INTERVAL_S[0] < dt_s < _INTERVAL_S[1]:
            return None
        north_mps2 = (self.sum_north_mps - last.sum_north_mps - self.vel_north_mps + last.vel_north_mps) / dt_s
        east_mps2 = (self.sum_east_mps - last.sum_east_mps - self.vel_east_mps + last.vel_east_mps) / dt_s
        return north_mps2, east_mps2, dt_s
