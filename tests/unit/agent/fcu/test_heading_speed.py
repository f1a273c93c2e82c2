"""Heading and speed loops on plants with a closed form."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from python39 import pairwise

from agent.fcu.control.controller import Order
from agent.fcu.control.heading_speed import (
    HeadingSpeedController,
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
from agent.fcu.vehicle.autopilot import Autopilot

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


TURN = SteeringGains(
    angle_p=2.0,
    rate_max_radps=1.0,
    acceleration_max_radps2=2.0,
    p=0.3,
    i=0.5,
    d=0.1,
    feed_forward=0.4,
    integral_max=0.25,
    derivative_hz=5.0,
)
PACE = SpeedGains(
    p=0.2,
    i=0.5,
    integral_max=0.3,
    acceleration_max_mps2=1.0,
    deceleration_max_mps2=2.0,
    cruise_speed_mps=2.0,
    cruise_thrust=0.4,
)


@pytest.mark.parametrize(
    ("wanted", "before", "desired"),
    [
        (0.5, 0.4, 0.5),
        (5.0, 0.95, 1.0),
        (-5.0, -0.95, -1.0),
        (0.9, 0.0, 0.2),  # 2 rad/s² for 0.1 s
        (-0.9, 0.0, -0.2),
        (0.2, 0.0, 0.2),
    ],
)
def test_a_turn_rate_is_wanted_within_its_limits(wanted: float, before: float, desired: float) -> None:
    state, _ = turn_rate_control(TURN, SteeringState(desired_rate_radps=before), wanted, 0.0, False, 0.1)
    assert state.desired_rate_radps == pytest.approx(desired)
    free = TURN._replace(acceleration_max_radps2=0.0)
    state, _ = turn_rate_control(free, SteeringState(desired_rate_radps=before), wanted, 0.0, False, 0.1)
    assert state.desired_rate_radps == pytest.approx(min(max(wanted, -1.0), 1.0))


def test_the_steering_demand_is_the_sum_of_its_parts() -> None:
    """Feed-forward of the desired rate, error, integral, and the derivative of the measured rate behind a low pass."""
    before = SteeringState(desired_rate_radps=0.4, integral=0.1, last_rate_radps=0.05, derivative_radps2=0.2)
    state, demand = turn_rate_control(TURN, before, 0.5, 0.15, False, 0.1)
    smoothing = 0.1 / (0.1 + 1.0 / (math.tau * 5.0))
    derivative = 0.2 + smoothing * (1.0 - 0.2)
    integral = 0.1 + 0.5 * 0.35 * 0.1
    assert state == pytest.approx(SteeringState(0.5, integral, 0.15, derivative))
    assert demand == pytest.approx(0.4 * 0.5 + 0.3 * 0.35 - 0.1 * derivative + integral)


@pytest.mark.parametrize(
    ("error", "before", "limited", "after"),
    [
        (0.4, 0.1, False, 0.12),
        (0.4, 0.1, True, 0.1),  # it would grow
        (-0.4, 0.1, True, 0.08),
        (-0.4, -0.1, True, -0.1),
        (0.4, -0.1, True, -0.08),
        (0.4, 0.0, True, 0.0),
        (0.4, 0.245, False, 0.25),
        (-0.4, -0.245, False, -0.25),
        (0.4, 0.3, True, 0.25),  # the limit was lowered
    ],
)
def test_an_integral_grows_only_while_its_demand_is_met(
    error: float, before: float, limited: bool, after: float
) -> None:
    """0.5 /s for 0.1 s, within 0.25."""
    still = TURN._replace(acceleration_max_radps2=0.0)
    state, _ = turn_rate_control(still, SteeringState(integral=before), error, 0.0, limited, 0.1)
    assert state.integral == pytest.approx(after)
    # A speed loop whose desired speed has arrived integrates in the same way.
    pace = PACE._replace(integral_max=0.25)
    speed, _ = speed_control(pace, SpeedState(1.0, before), 1.0, 1.0 - error, limited, 0.1)
    assert speed.integral == pytest.approx(after)


@pytest.mark.parametrize(
    ("target", "desired", "ramps"),
    [(1.0, 1.0, False), (1.1, 1.1, False), (1.2, 1.1, True), (0.8, 0.8, False), (0.7, 0.8, True), (-9.0, 0.8, True)],
)
def test_the_desired_speed_ramps_and_the_integral_waits(target: float, desired: float, ramps: bool) -> None:
    """1 m/s² up and 2 m/s² down from 1 m/s, for 0.1 s; the drag grows with the square, 0.4 at 2 m/s."""
    state, thrust = speed_control(PACE, SpeedState(1.0, 0.05), target, 0.5, False, 0.1)
    assert state.desired_mps == pytest.approx(desired)
    integral = 0.05 if ramps else 0.05 + 0.5 * (desired - 0.5) * 0.1
    assert state.integral == pytest.approx(integral)
    assert thrust == pytest.approx(0.4 * (desired / 2.0) ** 2 + 0.2 * (desired - 0.5) + integral)


def test_astern_the_thrust_is_astern() -> None:
    _, thrust = speed_control(PACE, SpeedState(-1.0), -1.0, -1.0, False, 0.1)
    assert thrust == pytest.approx(-0.1)
    _, most = speed_control(PACE, SpeedState(20.0), 20.0, 0.0, False, 0.1)
    _, least = speed_control(PACE, SpeedState(-20.0), -20.0, 0.0, False, 0.1)
    assert (most, least) == (1.0, -1.0)


@pytest.mark.parametrize(
    ("yaw_deg", "north", "east", "speed"),
    [
        (0.0, 3.0, 4.0, 5.0),  # with way on: the length of the velocity
        (90.0, 4.0, 3.0, 5.0),
        (0.0, -2.0, 0.0, -2.0),
        (0.0, 0.0, 1.5, 1.5**2 / (1.5 + 0.5)),  # aside at rest: less than the length
        (0.0, 0.3, 0.4, 0.3 + 0.16 / (0.5 + 0.5)),
        (0.0, -0.3, 0.4, -0.3 + 0.16 / (0.5 + 0.5)),
        (0.0, 0.0, 0.0, 0.0),
    ],
)
def test_the_speed_over_ground_blends_into_the_speed_ahead(
    yaw_deg: float, north: float, east: float, speed: float
) -> None:
    assert ground_speed_mps(math.radians(yaw_deg), north, east) == pytest.approx(speed)


def order(**changes: float | None) -> Order:
    made = Order(0.5, 0.0, 1.0)
    return made._replace(**changes)  # type: ignore[arg-type]


def test_the_controller_steers_by_heading_or_by_turn_rate_from_the_present_speed() -> None:
    """Against the two loops, cycle by cycle."""
    parameters = Parameters()
    controller = HeadingSpeedController(parameters)
    estimate = Autopilot().state.estimate._replace(yaw_rad=0.2, gyro_frd_radps=(0.0, 0.0, 0.05))
    steering, speed = SteeringState(), SpeedState(0.4)
    for now in (order(ground_speed_mps=0.4), order(heading_rad=None, turn_rate_radps=-0.3, ground_speed_mps=0.5)):
        wanted = -0.3 if now.heading_rad is None else STEERING.angle_p * 0.3
        steering, turn = turn_rate_control(STEERING, steering, wanted, 0.05, False, DT)
        speed, thrust = speed_control(SPEED, speed, 1.0, now.ground_speed_mps, False, DT)
        demand = controller.control(now, estimate, DT)
        assert (demand.thrust, demand.steering) == pytest.approx((thrust, turn))
    parameters.set("ATC_SPEED_P", 0.0)
    controller.configure()
    controller.restart()
    demand = controller.control(order(ground_speed_mps=0.0, speed_mps=0.0), estimate, DT)
    assert demand.thrust == 0.0
