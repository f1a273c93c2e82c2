"""Heading and speed loops on plants with a closed form."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from python39 import pairwise

from agent.fcu.control.heading_speed import (
    SpeedGains,
    SpeedState,
    SteeringGains,
    SteeringState,
    ground_speed_mps,
    heading_rate_radps,
    speed_control,
    turn_rate_control,
)
from agent.fcu.parameters import Parameters

STEERING = SteeringGains.from_parameters(Parameters())
SPEED = SpeedGains.from_parameters(Parameters())
DT = 0.02


def test_heading_settles_against_a_steady_moment() -> None:
    """The full-size vessel's yaw with a disturbance of a fifth of full steering: no error remains."""
    yaw, rate, state = 2.5, 0.0, SteeringState()
    for _ in range(2000):
        state, demand = turn_rate_control(STEERING, state, heading_rate_radps(STEERING, -2.8, yaw), rate, False, DT)
        moment = 190.0 * demand + 38.0 - 150.0 * rate - 200.0 * rate * abs(rate)
        rate += moment / 64.0 * DT
        yaw += rate * DT
    assert math.remainder(yaw + 2.8, 2.0 * math.pi) == pytest.approx(0.0, abs=math.radians(0.5))
    assert yaw > 2.5  # the short way round, through pi


def test_turn_rate_and_its_change_are_limited() -> None:
    state, rates = SteeringState(), []
    for _ in range(100):
        state, _ = turn_rate_control(STEERING, state, heading_rate_radps(STEERING, 3.0, 0.0), 0.0, False, DT)
        rates.append(state.desired_rate_radps)
    assert max(rates) == pytest.approx(math.radians(30.0))
    assert max(b - a for a, b in pairwise(rates)) <= math.radians(90.0) * DT * 1.0001


def test_speed_settles_in_a_head_current() -> None:
    """Over ground 3 m/s against 0.5 m/s of current: the integral makes up for what the feed-forward does not know."""
    u, state = 0.0, SpeedState(0.0)
    for _ in range(3000):
        state, demand = speed_control(SPEED, state, 3.0, u, False, DT)
        water = u + 0.5
        u += (380.0 * demand - 15.0 * water - 20.0 * water * abs(water)) / 113.0 * DT
    assert u == pytest.approx(3.0, abs=0.01)


def test_desired_speed_ramps() -> None:
    state = SpeedState(0.0)
    for step in range(1, 50):
        state, _ = speed_control(SPEED, state, 3.0, 0.0, False, DT)
        assert state.desired_mps == pytest.approx(0.7 * DT * step)


def test_integrals_do_not_wind_up_while_limited() -> None:
    speed, steering = SpeedState(3.0, 0.1), SteeringState(0.0, 0.1)
    for _ in range(500):
        speed, _ = speed_control(SPEED, speed, 3.0, 0.0, True, DT)
        steering, _ = turn_rate_control(STEERING, steering, heading_rate_radps(STEERING, 1.0, 0.0), 0.0, True, DT)
    assert speed.integral == 0.1
    assert steering.integral == 0.1
    speed, _ = speed_control(SPEED, speed, 3.0, 4.0, True, DT)
    assert speed.integral < 0.1  # the way back stays open


@pytest.mark.medium
@given(st.floats(-math.pi, math.pi), st.floats(0.5, 10.0), st.floats(-10.0, 10.0))
def test_ground_speed_with_way_on_is_the_length_of_the_velocity(yaw: float, ahead: float, aside: float) -> None:
    north = ahead * math.cos(yaw) - aside * math.sin(yaw)
    east = ahead * math.sin(yaw) + aside * math.cos(yaw)
    assert ground_speed_mps(yaw, north, east) == pytest.approx(math.hypot(ahead, aside), rel=1e-6)


def test_ground_speed_astern_is_negative_and_at_rest_zero() -> None:
    assert ground_speed_mps(0.0, -1.0, 0.0) == -1.0
    assert ground_speed_mps(0.0, 0.0, 0.0) == 0.0


@pytest.mark.medium
@given(*[st.floats(-1e3, 1e3) for _ in range(4)])
def test_demands_stay_within_full(heading: float, yaw: float, rate: float, speed: float) -> None:
    assert (
        -1.0
        <= turn_rate_control(STEERING, SteeringState(), heading_rate_radps(STEERING, heading, yaw), rate, False, DT)[1]
        <= 1.0
    )
    assert -1.0 <= speed_control(SPEED, SpeedState(0.0), heading, speed, False, DT)[1] <= 1.0
