"""Allocation: what the propellers then do is what was asked for, as far as it fits."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from python39 import strict_zip

from agent.fcu.control.allocation import Allocation, AllocationGains, ThrustAllocator, allocate
from agent.fcu.control.controller import Demand
from agent.fcu.parameters import Parameters

demand = st.floats(-1.0, 1.0)
gains = st.builds(AllocationGains, astern=st.floats(0.1, 1.0), expo=st.floats(-0.9, 1.0), slew_per_s=st.just(0.0))


def thrust(g: AllocationGains, command: float) -> float:
    """ArduPilot's curve, forward: (1 - expo) c + expo c²; astern weaker."""
    size = (1.0 - g.expo) * abs(command) + g.expo * command * command
    return size if command >= 0.0 else -g.astern * size


@pytest.mark.medium
@given(gains, demand, demand)
def test_steering_is_met_first_and_thrust_as_far_as_it_fits(g: AllocationGains, surge: float, turn: float) -> None:
    result = allocate(g, Allocation(), surge, turn, 0.02)
    port, starboard = (thrust(g, command) for command in result.command)
    widest = 0.5 * (1.0 + g.astern)
    wanted_turn = min(max(turn, -widest), widest)
    assert all(-1.0 <= command <= 1.0 for command in result.command)
    assert 0.5 * (port - starboard) == pytest.approx(wanted_turn, abs=1e-6)
    assert result.steering_limited == (wanted_turn != turn)
    if result.thrust_limited:
        assert max(port, starboard) > 1.0 - 1e-6 or min(port, starboard) < -g.astern + 1e-6
    else:
        assert 0.5 * (port + starboard) == pytest.approx(surge, abs=1e-6)


def test_square_propellers_ahead_and_astern() -> None:
    g = AllocationGains(astern=0.5, expo=1.0, slew_per_s=0.0)
    assert allocate(g, Allocation(), 0.25, 0.0, 0.02).command == pytest.approx((0.5, 0.5))
    assert allocate(g, Allocation(), -0.125, 0.0, 0.02).command == pytest.approx((-0.5, -0.5))
    assert allocate(g, Allocation(), 0.0, 0.25, 0.02).command == pytest.approx((0.5, -(0.5**0.5)))


@pytest.mark.medium
@given(demand, demand, demand, demand)
def test_slew_limits_every_step(a: float, b: float, c: float, d: float) -> None:
    g = AllocationGains(astern=0.6, expo=1.0, slew_per_s=2.0)
    first = allocate(g, Allocation(), a, b, 0.02)
    second = allocate(g, first, c, d, 0.02)
    assert all(abs(y - x) <= 0.04 + 1e-12 for x, y in strict_zip((0.0, 0.0), first.command))
    assert all(abs(y - x) <= 0.04 + 1e-12 for x, y in strict_zip(first.command, second.command))


VECTORED = {"SERVO1_FUNCTION": 26.0, "SERVO3_FUNCTION": 70.0, "MOT_VEC_ANGLEMAX": 45.0, "MOT_SLEWRATE": 0.0}


def allocator(**values: float) -> ThrustAllocator:
    return ThrustAllocator(Parameters({"MOT_THST_ASYM": 2.0, **values}))


@pytest.mark.medium
@given(demand, demand)
def test_thrust_that_turns_gives_steering_first_and_thrust_as_far_as_they_fit(surge: float, turn: float) -> None:
    """Throttle along a direction: its parts ahead and aside are what was asked for; thrust is raised for steering."""
    made = allocator(**VECTORED)
    throttle, gear = made.allocate(Demand(surge, turn), 0.02)
    last, angle_rad = made.last, gear * math.radians(45.0)
    size = thrust(AllocationGains(0.5, 1.0, 0.0), throttle)
    ahead, aside = size * math.cos(angle_rad), size * math.sin(angle_rad)
    assert -0.5 - 1e-9 <= size <= 1.0 + 1e-9
    lent = min(abs(surge), (1.0 if surge >= 0.0 else 0.5) * math.sqrt(0.5))  # at 45 degrees as much aside as ahead
    widest = math.sqrt(0.5) if abs(turn) > 0.05 else lent
    assert aside == pytest.approx(min(max(turn, -widest), widest), abs=1e-6)
    assert last.steering_limited == (abs(turn) > widest + 1e-9)
    if abs(turn) <= lent - 1e-9 and math.hypot(surge, turn) <= (1.0 if surge >= 0.0 else 0.5):
        assert ahead == pytest.approx(surge, abs=1e-6)
        assert not last.thrust_limited
    if ahead != pytest.approx(max(surge, -0.5), abs=2e-3):
        assert last.thrust_limited


def test_a_rudder_turns_less_with_speed_the_other_way_astern_and_helps_nothing_at_rest() -> None:
    """ArduRover's MOT_SPD_SCA_BASE."""
    made = allocator(SERVO1_FUNCTION=26, SERVO3_FUNCTION=70, SERVO5_FUNCTION=26, MOT_SPD_SCA_BASE=1.5, MOT_SLEWRATE=0.0)
    assert made.mixer.outputs == (3, 1, 5)
    assert not made.mixer.pivots
    assert made.allocate(Demand(0.25, 0.4), 0.02, 3.0) == pytest.approx((0.5, 0.2, 0.2))
    assert not made.last.steering_limited
    assert made.allocate(Demand(0.25, 0.4), 0.02, 1.0) == pytest.approx((0.5, 0.4, 0.4))
    assert made.last.steering_limited
    assert made.allocate(Demand(0.0, 0.4), 0.02, -1.0)[1:] == pytest.approx((-0.4, -0.4))
    assert made.allocate(Demand(0.25, 1.0), 0.02, 6.0, by_hand=True)[1:] == (1.0, 1.0)
    assert made.allocate(Demand(-0.25, 1.0), 0.02, 1.0, by_hand=True)[1:] == (-1.0, -1.0)


@pytest.mark.parametrize(("mix", "steering"), [(1.0, 0.7), (0.75, 0.6), (0.5, 0.5), (0.25, 0.4)])
def test_the_mix_of_steering_and_throttle_is_that_of_ardurover(mix: float, steering: float) -> None:
    """0.7 of both is 1.4 of an output: at 0.5 both fall to 0.5, above it thrust falls more, below it steering."""
    made = allocator(MOT_STR_THR_MIX=mix, MOT_THST_ASYM=1.0, MOT_THST_EXPO=0.0, MOT_SLEWRATE=0.0)
    port, starboard = made.allocate(Demand(0.7, 0.7), 0.02)
    assert 0.5 * (port - starboard) == pytest.approx(steering)
    assert max(port, starboard) == pytest.approx(1.0)
    assert made.last.steering_limited == (mix < 1.0)
    assert made.allocate(Demand(0.3, 0.3), 0.02) == pytest.approx((0.6, 0.0))


def test_with_way_on_a_brake_does_not_take_the_steering_away() -> None:
    made = allocator(**VECTORED)
    made.allocate(Demand(-0.4, 0.3), 0.02, 2.0)
    assert made.last.command == pytest.approx((math.sqrt(0.3 * math.sqrt(2.0)), 1.0))
    assert made.last.thrust_limited
    throttle, gear = made.allocate(Demand(-0.4, 0.3), 0.02, -1.0)  # astern by intention
    assert throttle < 0.0
    assert gear < 0.0
    rudder = allocator(SERVO1_FUNCTION=26, SERVO3_FUNCTION=70, MOT_SLEWRATE=0.0)
    assert rudder.allocate(Demand(-0.4, 0.5), 0.02, 2.0)[0] == 0.0
    assert rudder.allocate(Demand(-0.4, 0.1), 0.02, 2.0)[0] < 0.0


def test_without_any_output_nothing_is_driven() -> None:
    made = allocator(SERVO1_FUNCTION=0, SERVO3_FUNCTION=0)
    assert made.allocate(Demand(0.5, 0.5), 0.02, 1.0) == ()
