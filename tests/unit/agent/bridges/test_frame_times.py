"""Instants of frames, and what ArduPilot's clock makes of them."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.bridges.json_world import FrameTimes


def its_clock(clock_us: int, last_s: float, told_s: float) -> int:
    """A step in whole microseconds, what is over is cut off; the text has nine digits."""
    return int(clock_us + (told_s - last_s) * 1e6)


@settings(max_examples=25, deadline=None)
@given(rate_hz=st.integers(11, 20_000), start_us=st.sampled_from([0, 10_000, 3_600_000_000]))
def test_its_clock_keeps_to_ours(rate_hz: int, start_us: int) -> None:
    times = FrameTimes(start_us)
    times.set_rate(rate_hz)
    frames = times.next_frames(start_us + 2_000_000, 100_000)
    assert len(frames) == 2 * rate_hz
    assert frames[-1][0] == start_us + 2_000_000
    clock_us, last_s = start_us, start_us * 1e-6
    for at_us, told_s in frames:
        told_s = float(f"{told_s:.9f}")
        clock_us, last_s = its_clock(clock_us, last_s, told_s), told_s
        assert clock_us == at_us


def test_at_most_so_many_and_on_from_there() -> None:
    times = FrameTimes(0)
    times.set_rate(1000)
    first, rest = times.next_frames(10_000, 4), times.next_frames(10_000, 100)
    assert [at_us for at_us, _ in first + rest] == list(range(1000, 11_000, 1000))
    assert times.next_frames(10_000, 100) == []


def test_a_new_rate_counts_from_the_last_frame() -> None:
    times = FrameTimes(0)
    times.set_rate(1000)
    times.next_frames(2000, 100)
    times.set_rate(400)
    assert [at_us for at_us, _ in times.next_frames(8000, 100)] == [4500, 7000]
    assert times.last_us == 7000


def test_slower_than_the_exchanges() -> None:
    times = FrameTimes(0)
    times.set_rate(50)
    assert [len(times.next_frames(end_us, 10)) for end_us in (10_000, 20_000, 30_000, 40_000)] == [0, 1, 0, 1]


def test_what_it_is_told_stays_near() -> None:
    times = FrameTimes(0)
    times.set_rate(1200)
    at_us, told_s = times.next_frames(600_000_000, 10_000_000)[-1]
    assert told_s == pytest.approx(at_us * 1e-6, abs=1e-3)
