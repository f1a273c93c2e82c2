from __future__ import annotations

from agent.timing.clock import MonotonicClock, TickClock


def test_the_monotonic_clock_starts_near_zero_and_never_steps_back() -> None:
    clock = MonotonicClock()
    times_ns = [clock.now_ns() for _ in range(100)]
    assert times_ns[0] >= 0
    assert times_ns == sorted(times_ns)


def test_the_tick_clock_moves_only_forward_and_only_by_ticks() -> None:
    clock = TickClock()
    assert clock.now_ns() == 0
    assert clock.advance_to(2_500_000)
    assert not clock.advance_to(2_500_000)
    assert not clock.advance_to(1)
    assert clock.now_ns() == 2_500_000
