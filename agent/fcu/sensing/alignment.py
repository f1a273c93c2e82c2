"""Levelling: the first attitude, from a few seconds of accelerometer and compass on a vessel that bobs."""

from __future__ import annotations

import math

from agent.fcu.samples import ImuSample, Vector3
from agent.fcu.sensing.inertial import InertialState, frd_to_ned, quaternion

_DURATION_NS = 2_000_000_000
_LEAST_SAMPLES = 20
_GRAVITY_RANGE_MPS2 = (7.0, 12.5)


class Alignment:
    """Averages specific force until a first attitude can be given.

    The average over bobbing is level to a few degrees, which is where the attitude filter starts from; turning while
    levelling does no harm, since heading comes from the newest compass sample.
    """

    def __init__(self) -> None:
        self._start_ns = 0
        self._last_ns = 0
        self._count = 0
        self._sum: Vector3 = (0.0, 0.0, 0.0)
        self.field_frd_gauss: Vector3 | None = None

    def add(self, sample: ImuSample, declination_rad: float) -> InertialState | None:
        """The first state once there is one. Samples that go back in time start the average again."""
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
    """By how much the true heading exceeds that of `state`, as the horizontal field shows it, in [-pi, pi]."""
    field_north, field_east, _ = frd_to_ned(state, field_frd_gauss)
    return math.remainder(declination_rad - math.atan2(field_east, field_north), 2.0 * math.pi)


def turned(state: InertialState, angle_rad: float) -> InertialState:
    """The state with its heading changed by `angle_rad`."""
    c, s = math.cos(0.5 * angle_rad), math.sin(0.5 * angle_rad)
    _, w, x, y, z = state[:5]
    return state._replace(w=c * w - s * z, x=c * x - s * y, y=c * y + s * x, z=c * z + s * w)


def _resting(sample: ImuSample, roll_rad: float, pitch_rad: float, yaw_rad: float) -> InertialState:
    zeros = (0.0,) * 9
    return InertialState(
        sample.stamp_ns, *quaternion(roll_rad, pitch_rad, yaw_rad), *zeros, *sample.gyro_frd_radps, 0.0, 0.0
    )
