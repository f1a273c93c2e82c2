"""A clock with faults, under one that moves by hand."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.timing.clock import MonotonicClock, SteppedClock, TickClock
from tests.patience import wait_until

SECOND = 1_000_000_000


def test_without_faults_it_is_the_other_clock() -> None:
    base = TickClock(7)
    clock = SteppedClock(base)
    assert clock.now_ns() == 7
    base.advance_to(5 * SECOND)
    assert clock.now_ns() == 5 * SECOND


def test_a_step_and_a_skew() -> None:
    base = TickClock()
    clock = SteppedClock(base)
    base.advance_to(10 * SECOND)
    assert clock.disturb(3 * SECOND, 80.0)
    assert clock.now_ns() == 13 * SECOND
    base.advance_to(70 * SECOND)
    assert clock.now_ns() == 73 * SECOND + 60 * 80_000  # 80 ppm of 60 s
    assert clock.disturb(3 * SECOND, 0.0)  # true again from now on; what was gained stays
    base.advance_to(80 * SECOND)
    assert clock.now_ns() == 83 * SECOND + 60 * 80_000


def test_time_does_not_step_back() -> None:
    base = TickClock()
    clock = SteppedClock(base)
    assert clock.disturb(SECOND, 0.0)
    assert not clock.disturb(SECOND - 1, 50.0)
    assert not clock.disturb(SECOND, -1e6)
    assert not clock.disturb(SECOND, float("nan"))
    base.advance_to(100 * SECOND)
    assert clock.now_ns() == 101 * SECOND


@pytest.mark.medium
@given(
    st.lists(
        st.tuples(st.integers(0, 10 * SECOND), st.integers(0, 10 * SECOND), st.floats(-99_000.0, 99_000.0)), max_size=30
    )
)
def test_whatever_happens_to_it_it_goes_on(faults: list[tuple[int, int, float]]) -> None:
    base = TickClock()
    clock = SteppedClock(base)
    last_ns = now_ns = 0
    for wait_ns, offset_ns, skew_ppm in faults:
        now_ns += wait_ns
        base.advance_to(now_ns)
        assert clock.now_ns() >= last_ns
        last_ns = clock.now_ns()
        if clock.disturb(offset_ns, skew_ppm):
            assert clock.now_ns() >= last_ns
            last_ns = clock.now_ns()


def test_the_monotonic_clock_starts_at_zero_and_keeps_pace() -> None:
    clock = MonotonicClock()
    start_ns = time.monotonic_ns()
    assert clock.now_ns() >= 0
    wait_until(lambda: time.monotonic_ns() - start_ns > 10_000_000)
    assert clock.now_ns() == pytest.approx(time.monotonic_ns() - start_ns, abs=SECOND)
