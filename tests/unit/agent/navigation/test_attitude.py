"""Corrections of the integrated attitude."""

from __future__ import annotations

import math

import pytest

from agent.navigation.attitude import (
    AttitudeCorrection,
    InitialAlignment,
    TiltReference,
    heading_error_rad,
    turn_heading,
)
from agent.navigation.inertial import InertialState, euler, ned_to_frd, quaternion
from agent.navigation.measurements import ImuMeasurement

ZERO = (0.0, 0.0, 0.0)
SECOND = 1_000_000_000


def at_rest(*angles_rad: float) -> InertialState:
    """roll, pitch, yaw."""
    return InertialState(0, *quaternion(*angles_rad), *[0.0] * 14)


def tilt_rate_radps(north_rad: float, east_rad: float) -> tuple[float, ...]:
    """The correcting rate for one tilt error of a level vessel that points north, with a gain of 0.1 per second."""
    level = InertialState(0, 1.0, 0.0, 0.0, 0.0, *[0.0] * (len(InertialState._fields) - 5))
    correction = AttitudeCorrection(0.1)
    correction.settle(0.0)
    correction.tilt(level, north_rad, east_rad, 0.01)
    return correction.rate_offset_frd_radps


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_tilt_error_beyond_the_limit_corrects_no_faster(sign: float) -> None:
    """A shock of 1 g looks like a tilt of 45 degrees; it must not turn the attitude by that much."""
    shock = tilt_rate_radps(sign * math.pi / 4, sign * 10.0)
    assert shock == tilt_rate_radps(sign * 0.3, sign * 0.3)
    assert shock != tilt_rate_radps(sign * 0.29, sign * 0.29)
    assert tilt_rate_radps(0.1, 0.0)[0] == pytest.approx(tilt_rate_radps(0.2, 0.0)[0] / 2)


@pytest.mark.parametrize(
    ("since_levelled_s", "dt_s", "trust", "gain_per_s"),
    [
        (0.0, 0.01, 1.0, 0.5),
        (6.0, 0.01, 1.0, 0.1 * (1.0 + 4.0 / math.e)),
        (1e3, 0.01, 1.0, 0.1),
        (1e3, 0.01, 0.25, 0.025),
        (0.0, 2.0, 1.0, 0.25),  # at most half of the error in one interval
    ],
)
def test_the_gain_on_a_tilt_starts_at_five_times_and_settles(
    since_levelled_s: float, dt_s: float, trust: float, gain_per_s: float
) -> None:
    correction = AttitudeCorrection(0.1)
    correction.settle(since_levelled_s)
    correction.tilt(at_rest(0.0, 0.0, math.pi / 2.0), 0.01, 0.02, dt_s, trust)  # north is to port, east ahead
    rate = [part + bias for part, bias in zip(correction.rate_offset_frd_radps, correction.bias_frd_radps)]
    assert rate == pytest.approx([-gain_per_s * 0.02, gain_per_s * 0.01, 0.0])


def test_the_bias_is_the_integral_of_the_tilt_after_two_seconds() -> None:
    """With the proportional gain P, the integral gain of a damping of 0.9 is P^2 / 4 / 0.81."""
    correction = AttitudeCorrection(0.1)
    correction.settle(1.99)
    correction.tilt(at_rest(0.0, 0.0, 0.0), 0.01, 0.02, 0.2)
    assert correction.bias_frd_radps == ZERO
    correction.settle(1e3)
    for _ in range(5):
        correction.tilt(at_rest(0.0, 0.0, 0.0), 0.01, 0.02, 0.2)
    integral = 0.1**2 / 4.0 / 0.81
    assert correction.bias_frd_radps == pytest.approx((integral * 0.01, integral * 0.02, 0.0))
    for _ in range(500):
        correction.tilt(at_rest(0.0, 0.0, 0.0), 0.3, -0.3, 0.2)
    limit_radps = math.radians(3.0)
    assert correction.bias_frd_radps == pytest.approx((limit_radps, -limit_radps, 0.0))


def test_a_turn_of_the_heading_is_about_the_vertical() -> None:
    heeled = at_rest(math.radians(30.0), 0.0, 1.0)
    down = (0.0, 0.5, math.sqrt(0.75))
    correction = AttitudeCorrection(0.1)
    correction.turn(heeled, 0.2, 0.01)
    correction.turn(heeled, 0.2, 0.01)
    assert correction.bias_frd_radps == pytest.approx([0.02 * part for part in down])
    assert correction.rate_offset_frd_radps == pytest.approx([0.18 * part for part in down])
    correction.drop_heading()
    assert correction.rate_offset_frd_radps == pytest.approx([-0.02 * part for part in down])


@pytest.mark.parametrize("declination_rad", [0.0, -0.3])
def test_levelling_is_the_mean_specific_force_and_the_heading_of_the_compass(declination_rad: float) -> None:
    roll_rad, pitch_rad, yaw_rad = 0.2, -0.1, 2.0
    vessel = at_rest(roll_rad, pitch_rad, yaw_rad)
    alignment = InitialAlignment()
    alignment.field_frd_gauss = ned_to_frd(
        vessel, (0.2 * math.cos(declination_rad), 0.2 * math.sin(declination_rad), 0.4)
    )
    force = ned_to_frd(vessel, (0.0, 0.0, -9.8))
    gyro = (0.1, 0.2, 0.3)
    for step in range(201):
        shake = 1.5 if step % 2 else -1.5
        sample = ImuMeasurement(step * 10_000_000, gyro, (force[0] + shake, force[1], force[2] - shake))
        state = alignment.add(sample, declination_rad)
        assert (state is not None) == (step == 200)
    assert state is not None
    assert euler(*state[1:5]) == pytest.approx((roll_rad, pitch_rad, yaw_rad), abs=2e-3)  # 201 shakes are not even
    assert state.stamp_ns == 2 * SECOND
    assert state[5:17] == (*[0.0] * 9, *gyro)


@pytest.mark.parametrize(
    ("stamps_ns", "force_mps2", "levels"),
    [
        (range(0, 2 * SECOND + 1, SECOND // 10), 9.8, True),
        ([sample * 111_111_112 for sample in range(19)], 9.8, False),  # 19 samples are too few
        ([*range(0, SECOND, SECOND // 50), *range(4 * SECOND, 6 * SECOND, SECOND // 50)], 9.8, False),  # a gap
        ([*range(0, 2 * SECOND, SECOND // 50), *range(SECOND, 5 * SECOND // 2, SECOND // 50)], 9.8, False),  # set back
        (range(0, 2 * SECOND + 1, SECOND // 10), 6.9, False),
        (range(0, 2 * SECOND + 1, SECOND // 10), 12.6, False),
    ],
)
def test_levelling_needs_two_seconds_of_samples_about_one_g(
    stamps_ns: list[int], force_mps2: float, levels: bool
) -> None:
    alignment = InitialAlignment()
    states = [alignment.add(ImuMeasurement(at_ns, ZERO, (0.0, 0.0, -force_mps2)), 0.0) for at_ns in stamps_ns]
    assert any(state is not None for state in states) == levels


def test_the_heading_error_is_added_to_the_heading() -> None:
    state = at_rest(0.1, -0.2, math.radians(350.0))
    field = ned_to_frd(at_rest(0.1, -0.2, math.radians(10.0)), (0.2, 0.0, 0.4))
    error_rad = heading_error_rad(state, field, 0.0)
    assert error_rad == pytest.approx(math.radians(20.0))
    assert heading_error_rad(state, field, 0.05) == pytest.approx(math.radians(20.0) + 0.05)
    assert euler(*turn_heading(state, error_rad)[1:5]) == pytest.approx((0.1, -0.2, math.radians(10.0)))


def test_an_acceleration_that_the_fixes_do_not_show_is_unexplained() -> None:
    """Integrated 3 and -2 m/s in a second, of which the fixes show 1 and -0.5 m/s."""
    then = at_rest(0.0, 0.0, 0.0)._replace(sum_north_mps=1.0, sum_east_mps=2.0, acc_north_mps2=3.0, acc_east_mps2=-2.0)
    first = TiltReference.from_fix(then, SECOND // 10, (0.5, 0.25, 0.0))
    assert first == pytest.approx((SECOND // 10, 0.5, 0.25, 1.3, 1.8))
    later = TiltReference(SECOND // 10 + SECOND, 1.5, -0.25, 4.3, -0.2)
    assert later.accelerated(first) == pytest.approx((3.0, -2.0))
    assert later.unexplained(first) == pytest.approx((2.0, -1.5, 1.0))
    for apart_ns in (0, 2 * SECOND):
        again = first._replace(stamp_ns=first.stamp_ns + apart_ns, sum_north_mps=9.0)
        assert again.accelerated(first) == (0.0, 0.0)
        assert again.unexplained(first) is None
    assert later.accelerated(None) == (0.0, 0.0)
