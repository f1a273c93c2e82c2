"""Loss accounting against a channel whose losses are known."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.wire.link import SENDERS, SequenceMonitor


def heard(numbers: list[int]) -> SequenceMonitor:
    monitor = SequenceMonitor()
    for number in numbers:
        monitor.note(1, 1, number & 0xFF)
    return monitor


def counts(monitor: SequenceMonitor) -> tuple[int, int, int]:
    return monitor.lost, monitor.late, monitor.repeated


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        (list(range(1000)), (0, 0, 0)),
        ([17, 18, 19], (0, 0, 0)),  # a sender may start anywhere
        ([0, 1, 4, 5], (2, 0, 0)),
        ([254, 255, 2], (2, 0, 0)),
        ([0, 1, 1, 2], (0, 0, 1)),
        ([0, 2, 1, 3], (0, 1, 0)),
        ([0, 2, 1, 1, 3], (0, 1, 1)),
        ([255, 1, 0, 2], (0, 1, 0)),
        ([0, 128], (127, 0, 0)),
        ([0, 3, 2, 1, 0], (0, 2, 1)),
    ],
)
def test_small_cases(numbers: list[int], expected: tuple[int, int, int]) -> None:
    assert counts(heard(numbers)) == expected


def test_a_number_lost_long_ago_is_not_taken_back() -> None:
    numbers = [0, *range(2, 200), 1 + 256]  # 1 is lost; 257 has the same number on the wire, 57 ahead of 200
    monitor = heard(numbers)
    assert counts(monitor) == (1 + 57, 0, 0)


@given(
    st.lists(st.sampled_from(["sent", "lost", "repeated"]), min_size=1, max_size=2000),
    st.integers(0, 255),
    st.integers(0, 2**32),
)
def test_frames_add_up_over_a_lossy_repeating_and_reordering_channel(kinds: list[str], first: int, seed: int) -> None:
    """At most 60 lost in a row and shifts of at most 20 places: within what numbers modulo 256 can tell."""
    rng = random.Random(seed)
    numbers: list[int] = []
    lost = repeated = in_a_row = 0
    for index, kind in enumerate(kinds):
        in_a_row = in_a_row + 1 if kind == "lost" else 0
        if kind == "lost" and in_a_row <= 60:
            lost += 1
            continue
        numbers += [first + index] * (2 if kind == "repeated" else 1)
        repeated += kind == "repeated"
    if not numbers:
        return
    lost -= numbers[0] - first  # before the first and after the last nobody can know
    lost -= first + len(kinds) - 1 - numbers[-1]
    middle = sorted(numbers[1:-1], key=lambda number: number + rng.uniform(0.0, 20.0))
    monitor = heard([numbers[0], *middle, *numbers[1:][-1:]])
    assert monitor.lost == lost
    assert monitor.repeated == repeated


@pytest.mark.parametrize("in_a_row", [1, 127, 128, 150, 200, 223, 224, 255, 256, 257, 300, 511, 512, 1000])
@pytest.mark.parametrize("twice", [False, True])
def test_nothing_is_taken_for_repeated_that_was_not(in_a_row: int, twice: bool) -> None:
    """However many were lost in a row; what did come twice is told by its check value."""
    monitor = SequenceMonitor()
    for number in [*range(300), *range(300 + in_a_row, 700 + in_a_row)]:
        for _ in range(1 + twice):
            monitor.note(1, 1, number & 0xFF, number.to_bytes(2, "little"))
    assert monitor.repeated == 700 * twice
    if in_a_row < 224:
        assert counts(monitor) == (in_a_row, 0, 700 * twice)


def test_a_frame_from_before_the_first_is_late_and_nothing_is_lost() -> None:
    monitor = SequenceMonitor()
    for number in [7, 5, 8, 6, 9]:
        monitor.note(1, 1, number, bytes([number]))
    assert counts(monitor) == (0, 2, 0)


def test_senders_are_counted_apart_and_forgotten_by_a_reset() -> None:
    monitor = SequenceMonitor()
    for sequence in range(10):
        monitor.note(1, 1, sequence)
        monitor.note(1, 2, sequence * 2)
    assert counts(monitor) == (9, 0, 0)
    monitor.reset()
    monitor.note(1, 1, 77)
    assert counts(monitor) == (0, 0, 0)


def test_invented_senders_take_bounded_memory() -> None:
    monitor = SequenceMonitor()
    for system in range(256):
        for component in range(4):
            monitor.note(system, component, 0)
    assert len(vars(monitor)["_senders"]) == SENDERS
