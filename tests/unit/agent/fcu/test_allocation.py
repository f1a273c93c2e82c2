"""Allocation: what the propellers then do is what was asked for, as far as it fits."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.fcu.control.allocation import Allocation, AllocationGains, allocate

demand = st.floats(-1.0, 1.0)
gains = st.builds(AllocationGains, astern=st.floats(0.1, 1.0), expo=st.floats(-0.9, 1.0), slew_per_s=st.just(0.0))


def thrust(g: AllocationGains, command: float) -> float:
    """ArduPilot's curve, forward: (1 - expo) c + expo c²; astern weaker."""
    size = (1.0 - g.expo) * abs(command) + g.expo * command * command
    return size if command >= 0.0 else -g.astern * size


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


@given(demand, demand, demand, demand)
def test_slew_limits_every_step(a: float, b: float, c: float, d: float) -> None:
    g = AllocationGains(astern=0.6, expo=1.0, slew_per_s=2.0)
    first = allocate(g, Allocation(), a, b, 0.02)
    second = allocate(g, first, c, d, 0.02)
    assert all(abs(y - x) <= 0.04 + 1e-12 for x, y in zip((0.0, 0.0), first.command, strict=True))
    assert all(abs(y - x) <= 0.04 + 1e-12 for x, y in zip(first.command, second.command, strict=True))
