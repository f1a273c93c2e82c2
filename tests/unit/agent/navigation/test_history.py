"""Late corrections: carried forward, they give what integrating from a corrected past would have given."""

from __future__ import annotations

import pytest

from agent.navigation.inertial import InertialHistory, InertialState, StateCorrection, propagate, shift_state
from agent.navigation.measurements import ImuMeasurement

ZERO = (0.0, 0.0, 0.0)
START = InertialState(0, 1.0, *ZERO, 2.0, 0.0, 0.0, *ZERO, *ZERO, *ZERO, 0.0, 0.0)


def run(start: InertialState, bias=ZERO) -> list[InertialState]:
    """Half a second of turning and accelerating."""
    states = [start]
    for step in range(1, 101):
        sample = ImuMeasurement(step * 5_000_000, (0.1, -0.2, 0.5), (0.5, 0.2, -9.7))
        states.append(propagate(states[-1], sample, ZERO, bias, 9.8))
    return states


def test_a_correction_in_the_past_equals_integrating_again() -> None:
    correction = StateCorrection((1.0, -2.0, 0.5), (0.3, 0.1, -0.2), (0.05, -0.02, 0.01))
    history = InertialHistory()
    for state in run(START):
        history.append(state)
    newest = history.correct(correction, 0)
    again = run(shift_state(START, correction.vel_ned_mps, correction.pos_ned_m), correction.bias_ned_mps2)
    assert newest[:11] == pytest.approx(again[-1][:11], abs=1e-9)
    then = history.state_at(250_000_000)
    assert then is not None
    assert then[:11] == pytest.approx(again[50][:11], abs=1e-9)


def test_only_states_since_the_measurement_are_corrected() -> None:
    history = InertialHistory()
    states = run(START)
    for state in states:
        history.append(state)
    history.correct(StateCorrection((1.0, 0.0, 0.0), ZERO, ZERO), 250_000_000)
    before, after = history.state_at(245_000_000), history.state_at(250_000_000)
    assert before is not None
    assert after is not None
    assert before.north_m == states[49].north_m
    assert after.north_m == pytest.approx(states[50].north_m + 1.0)


def test_the_state_of_an_instant_is_the_last_before_it() -> None:
    history = InertialHistory()
    for state in run(START):
        history.append(state)
    got = [history.state_at(stamp) for stamp in (12_499_999, 10_000_000, -1, 10**12)]
    assert [None if state is None else state.stamp_ns for state in got] == [10_000_000, 10_000_000, None, 500_000_000]
