"""Last seconds of the autopilot's motion, which give the pose at an instant."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple, TypeVar

import numpy as np

from agent.companion.rigid_motion import Array, quaternion_product, rotation_matrix, turn_quaternion

KEPT_NS = 5_000_000_000
AHEAD_NS = 500_000_000  # limit of extrapolation past the newest sample
_GAP_NS = 1_500_000_000  # no interpolation between samples farther apart
_STEP_RAD, _STEP_SHARE = math.radians(1.0), 0.1  # allowed difference of attitudes from the rates: more is a step
_RATES_HOLD_S = 0.3  # samples farther apart are not compared with the rates
_BACK = np.array((1.0, -1.0, -1.0, -1.0))


class VehiclePose(NamedTuple):
    """Pose and velocity of the body."""

    pos_ned_m: Array
    """(3,) from the autopilot's local origin."""
    rot_ned_frd: Array
    """(3, 3)."""
    vel_ned_mps: Array
    """(3,)."""


class _Turned(NamedTuple):
    stamp_ns: int
    quat: Array  # w, x, y, z, body FRD to NED
    steady: Array  # the same without the steps of an estimator that corrected itself
    rate_frd_radps: Array


class _Placed(NamedTuple):
    stamp_ns: int
    pos_ned_m: Array
    vel_ned_mps: Array


class PoseHistory:
    """Attitudes and positions, each in order of time; `pose_at` interpolates both."""

    def __init__(self) -> None:
        self._turned: deque[_Turned] = deque()
        self._placed: deque[_Placed] = deque()
        self.epoch = 0  # number of times that all samples were dropped

    def clear(self) -> None:
        """Drop all samples."""
        self.epoch += 1
        self._turned.clear()
        self._placed.clear()

    def add_attitude(self, stamp_ns: int, quat: Array, rate_frd_radps: Array) -> None:
        """Add an attitude as a quaternion (4,) of any length, and body rates (3,)."""
        length = float(np.linalg.norm(quat))
        if not (math.isfinite(length) and length > 0.5 and np.isfinite(rate_frd_radps).all()):
            return
        quat = quat / length
        steady = quat
        if self._turned:
            before = self._turned[-1]
            if stamp_ns <= before.stamp_ns:
                return
            steady = turn_quaternion(before.steady, _turn(before, stamp_ns, quat, rate_frd_radps))
        self._turned.append(_Turned(stamp_ns, quat, steady, rate_frd_radps))
        while self._turned[0].stamp_ns < stamp_ns - KEPT_NS:
            self._turned.popleft()

    def add_position(self, stamp_ns: int, pos_ned_m: Array, vel_ned_mps: Array) -> None:
        """Add a position and a velocity, both (3,)."""
        if not (np.isfinite(pos_ned_m).all() and np.isfinite(vel_ned_mps).all()):
            return
        if self._placed and stamp_ns <= self._placed[-1].stamp_ns:
            return
        self._placed.append(_Placed(stamp_ns, pos_ned_m, vel_ned_mps))
        while self._placed[0].stamp_ns < stamp_ns - KEPT_NS:
            self._placed.popleft()

    @property
    def newest_ns(self) -> int | None:
        """Instant up to which both are known, None before the first samples."""
        if not self._turned or not self._placed:
            return None
        return min(self._turned[-1].stamp_ns, self._placed[-1].stamp_ns)

    def pose_at(self, stamp_ns: int) -> VehiclePose | None:
        """Pose at an instant.

        Extrapolated by the rates a little past the newest sample, None farther off or before all samples.
        """
        turned, (placed, later) = self._turned_at(stamp_ns), _bracket(self._placed, stamp_ns)
        if turned is None or placed is None:
            return None
        if later is None:
            pos_ned_m = placed.pos_ned_m + placed.vel_ned_mps * ((stamp_ns - placed.stamp_ns) * 1e-9)
            return VehiclePose(pos_ned_m, rotation_matrix(turned.quat), placed.vel_ned_mps)
        share = (stamp_ns - placed.stamp_ns) / (later.stamp_ns - placed.stamp_ns)
        pos_ned_m = placed.pos_ned_m + (later.pos_ned_m - placed.pos_ned_m) * share
        vel_ned_mps = placed.vel_ned_mps + (later.vel_ned_mps - placed.vel_ned_mps) * share
        return VehiclePose(pos_ned_m, rotation_matrix(turned.quat), vel_ned_mps)

    def steady_attitude_at(self, stamp_ns: int) -> Array | None:
        """Body axes (3, 3) in a frame that is fixed for the epoch, without the estimator's steps. None if unknown.

        An estimator that corrects itself in one step, for example when it finds north, has not rotated the body.
        """
        turned = self._turned_at(stamp_ns)
        return None if turned is None else rotation_matrix(turned.steady)

    def _turned_at(self, stamp_ns: int) -> _Turned | None:
        sample, later = _bracket(self._turned, stamp_ns)
        if sample is None:
            return None
        if later is None:
            turn = (stamp_ns - sample.stamp_ns) * 1e-9 * sample.rate_frd_radps
            return sample._replace(quat=turn_quaternion(sample.quat, turn), steady=turn_quaternion(sample.steady, turn))
        share = (stamp_ns - sample.stamp_ns) / (later.stamp_ns - sample.stamp_ns)
        return sample._replace(
            quat=_between(sample.quat, later.quat, share), steady=_between(sample.steady, later.steady, share)
        )


_Sample = TypeVar("_Sample", _Turned, _Placed)


def _bracket(samples: deque[_Sample], stamp_ns: int) -> tuple[_Sample | None, _Sample | None]:
    """Return the samples before and after an instant. The second is None if the first must be extrapolated.

    Both are None too far past the newest sample, in a gap, and before all samples.
    """
    later: _Sample | None = None
    for sample in reversed(samples):
        if sample.stamp_ns <= stamp_ns:
            end_ns, limit_ns = (stamp_ns, AHEAD_NS) if later is None else (later.stamp_ns, _GAP_NS)
            return (sample, later) if end_ns - sample.stamp_ns <= limit_ns else (None, None)
        later = sample
    return None, None


def _between(first: Array, second: Array, share: float) -> Array:
    """Interpolate along the chord, which over a tenth of a second equals the arc."""
    if float(first @ second) < 0.0:
        second = -second
    mixed = first + (second - first) * share
    turned: Array = mixed / np.linalg.norm(mixed)
    return turned


def _turn(before: _Turned, stamp_ns: int, quat: Array, rate_frd_radps: Array) -> Array:
    """Rotation (3,) from one attitude to the next: by the difference, or by the rates if the difference is a step."""
    ahead_s = (stamp_ns - before.stamp_ns) * 1e-9
    w, *axis = quaternion_product(before.quat * _BACK, quat).tolist()
    sine = math.hypot(*axis)
    difference = (
        np.array(axis) * (2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, abs(w)) / sine) * math.copysign(1.0, w)
    )
    by_rates: Array = 0.5 * ahead_s * (before.rate_frd_radps + rate_frd_radps)
    is_step = float(np.linalg.norm(difference - by_rates)) > _STEP_RAD + _STEP_SHARE * float(np.linalg.norm(by_rates))
    return by_rates if is_step and ahead_s <= _RATES_HOLD_S else difference
