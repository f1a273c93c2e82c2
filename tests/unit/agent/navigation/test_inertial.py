"""Inertial integration against closed forms."""

from __future__ import annotations

import math

import pytest

from agent.navigation.inertial import InertialState, euler, frd_to_ned, ned_to_frd, propagate, quaternion
from agent.navigation.measurements import ImuMeasurement

ZERO = (0.0, 0.0, 0.0)


def at_rest(quat, gyro=ZERO) -> InertialState:
    return InertialState(0, *quat, *ZERO, *ZERO, *ZERO, *gyro, 0.0, 0.0)


def test_a_turn_at_a_constant_rate_is_exact() -> None:
    """Ten seconds at 2 rad/s about a fixed axis: the rotation is |w| t about it, and stays a unit quaternion."""
    rate = (0.6, -1.2, 1.5)
    size = math.sqrt(sum(w * w for w in rate))
    state = at_rest((1.0, 0.0, 0.0, 0.0), rate)
    for step in range(1, 2001):
        state = propagate(state, ImuMeasurement(step * 5_000_000, rate, ZERO), ZERO, ZERO, 0.0)
    half = 0.5 * size * 10.0
    expected = (math.cos(half), *(w / size * math.sin(half) for w in rate))
    assert state[1:5] == pytest.approx(expected, abs=1e-9)


def test_a_long_step_has_the_sine_and_cosine_of_its_angle() -> None:
    """0.8 rad in one step. Their series end before h^6/720 and h^7/5040, for half the angle h."""
    axis = (2.0 / 3.0, -1.0 / 3.0, 2.0 / 3.0)
    rate = (2.0 * axis[0], 2.0 * axis[1], 2.0 * axis[2])
    turned = propagate(at_rest((1.0, 0.0, 0.0, 0.0), rate), ImuMeasurement(400_000_000, rate, ZERO), ZERO, ZERO, 0.0)
    assert turned[1:5] == pytest.approx((math.cos(0.4), *(part * math.sin(0.4) for part in axis)), abs=6e-6)


def test_the_offset_is_added_to_the_rate_and_the_bias_subtracted_from_the_acceleration() -> None:
    rate, offset, bias = (0.1, -0.2, 0.3), (-0.1, 0.2, -0.3), (0.4, -0.5, 0.6)
    state = at_rest((1.0, 0.0, 0.0, 0.0), rate)
    for step in range(1, 201):
        state = propagate(state, ImuMeasurement(step * 5_000_000, rate, ZERO), offset, bias, 0.0)
    assert state[1:5] == pytest.approx((1.0, 0.0, 0.0, 0.0), abs=1e-12)
    assert state[5:8] == pytest.approx((-0.4, 0.5, -0.6))
    assert state[8:11] == pytest.approx((-0.2, 0.25, -0.3))
    assert (state.sum_north_mps, state.sum_east_mps) == (0.0, 0.0)


def test_a_quaternion_off_unit_length_comes_back() -> None:
    state = at_rest((1.02, 0.0, 0.0, 0.0))
    for step in range(1, 6):
        state = propagate(state, ImuMeasurement(step * 5_000_000, ZERO, ZERO), ZERO, ZERO, 0.0)
    assert math.sqrt(sum(q * q for q in state[1:5])) == pytest.approx(1.0, abs=1e-12)


def test_free_fall_and_rest() -> None:
    """Without specific force the fall is g t²/2; with minus gravity in body axes nothing moves."""
    attitude = quaternion(0.3, -0.2, 1.0)
    fall, rest = at_rest(attitude)._replace(acc_down_mps2=9.8), at_rest(attitude)
    held = ned_to_frd(rest, (0.0, 0.0, -9.8))
    for step in range(1, 201):
        fall = propagate(fall, ImuMeasurement(step * 5_000_000, ZERO, ZERO), ZERO, ZERO, 9.8)
        rest = propagate(rest, ImuMeasurement(step * 5_000_000, ZERO, held), ZERO, ZERO, 9.8)
    assert (fall.down_m, fall.vel_down_mps) == pytest.approx((4.9, 9.8))
    assert rest[5:11] == pytest.approx((0.0,) * 6, abs=1e-12)


def test_rotations_agree_with_each_other() -> None:
    """Heading 90 degrees: forward is east, starboard is south."""
    east = at_rest(quaternion(0.0, 0.0, math.pi / 2.0))
    assert frd_to_ned(east, (1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0), abs=1e-12)
    assert frd_to_ned(east, (0.0, 1.0, 0.0)) == pytest.approx((-1.0, 0.0, 0.0), abs=1e-12)
    angles = (0.3, -0.7, 2.5)
    assert euler(*quaternion(*angles)) == pytest.approx(angles)
    state = at_rest(quaternion(*angles))
    assert ned_to_frd(state, frd_to_ned(state, (1.0, 2.0, 3.0))) == pytest.approx((1.0, 2.0, 3.0))
