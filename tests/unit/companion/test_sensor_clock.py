"""Stamps of the sensors' clock on the companion's own."""

from __future__ import annotations

import pytest

from agent.companion.perception import SensorClock

S = 1_000_000_000


def test_in_lockstep_they_are_one() -> None:
    clock = SensorClock(lockstep=True)
    clock.note_arrival(5 * S, 7 * S)
    assert clock.own_ns(5 * S) == 5 * S


def test_the_quickest_of_many_tells() -> None:
    clock = SensorClock(lockstep=False)
    offset_ns = 123 * S
    for number in range(100):
        late_ns = (number * 7919 % 50) * 1_000_000  # 0 to 49 ms
        clock.note_arrival(number * S // 10, number * S // 10 + offset_ns + late_ns)
    assert clock.own_ns(3 * S) == 3 * S + offset_ns


@pytest.mark.parametrize("drift_ppm", [-200.0, 200.0])
def test_it_follows_clocks_that_drift(drift_ppm: float) -> None:
    clock = SensorClock(lockstep=False)
    for number in range(6000):  # ten minutes
        stamp_ns = number * S // 10
        clock.note_arrival(stamp_ns, round(stamp_ns * (1.0 + drift_ppm * 1e-6)))
    last_ns = 5999 * S // 10
    # What came within two windows of 20 s counts: 200 ppm of 40 s is 8 ms.
    assert abs(clock.own_ns(last_ns) - last_ns * (1.0 + drift_ppm * 1e-6)) <= 8.1e6


def test_before_anything_came_a_stamp_is_taken_as_it_is() -> None:
    assert SensorClock(lockstep=False).own_ns(S) == S
