"""Faults that a host may ask an agent for: their limits, their end, and what has no effect in lockstep."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from agent.faults import AgentFaults
from agent.timing.clock import SteppedClock
from agent.wire.memory import memory_pair

SECOND = 1_000_000_000
NOTHING = {
    "delay_usec": 0,
    "jitter_usec": 0,
    "loss": 0.0,
    "duplicate": 0.0,
    "reorder": 0.0,
    "cut": 0,
    "clock_offset_ns": 0,
    "clock_skew_ppm": 0.0,
    "cpu_load": 0.0,
    "seed": 0,
}


class Board:
    """Faults of an agent with a link, and a clock that the test turns."""

    def __init__(self, lockstep: bool) -> None:
        self.now_ns = 100 * SECOND
        monotonic: Any = SimpleNamespace(now_ns=lambda: self.now_ns)
        self.faults = AgentFaults(monotonic)
        self.link = self.faults.wrap(memory_pair()[0])
        self.stepped_ns: list[int] = []
        self.clock = SteppedClock(monotonic)
        executor: Any = SimpleNamespace(clock_stepped=self.stepped_ns.append)
        self.faults.start_run(None if lockstep else self.clock, executor)

    def ask(self, **fields: Any) -> list[str]:
        message: Any = SimpleNamespace(**{**NOTHING, **fields})
        return list(self.faults.handle(message))


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        *[({name: value}, "") for name in ("loss", "duplicate", "reorder", "cpu_load") for value in (0.0, 1.0)],
        *[
            ({name: value}, f"{name} {value:g} is not within 0 to 1")
            for name in ("loss", "duplicate", "reorder", "cpu_load")
            for value in (-0.1, 1.1, math.nan)
        ],
        *[({name: 60_000_000}, "") for name in ("delay_usec", "jitter_usec")],
        *[({name: 60_000_001}, f"{name} 60000001 is above 60000000") for name in ("delay_usec", "jitter_usec")],
        *[({"clock_offset_ns": sign * 10**18}, "") for sign in (-1, 1)],
        *[
            ({"clock_offset_ns": sign * (10**18 + 1)}, f"clock_offset_ns {sign * (10**18 + 1)} is not within {10**18}")
            for sign in (-1, 1)
        ],
        *[({"clock_skew_ppm": sign * 99_999.0}, "") for sign in (-1.0, 1.0)],
        *[
            ({"clock_skew_ppm": sign * 1e5}, f"clock_skew_ppm {sign * 1e5:g} is not within 100000")
            for sign in (-1.0, 1.0)
        ],
        ({"clock_skew_ppm": math.inf}, "clock_skew_ppm inf is not within 100000"),
    ],
)
def test_faults_have_limits(fields: dict[str, Any], problem: str) -> None:
    """In lockstep, where clock and load have no effect."""
    board = Board(lockstep=True)
    assert board.ask(**fields) == ([f"Faults refused: {problem}"] if problem else [])
    assert board.ask(**fields) == [], "a repetition is not answered"


def test_a_delay_has_no_effect_in_lockstep_and_loss_has() -> None:
    fields = {"delay_usec": 20_000, "jitter_usec": 3_000, "loss": 0.25, "duplicate": 0.5, "reorder": 0.125, "cut": 1}
    for lockstep, delays in ((True, (0.0, 0.0)), (False, (0.02, 0.003))):
        board = Board(lockstep)
        assert board.ask(**fields) == []
        faults = board.link.faults
        assert (faults.delay_s, faults.jitter_s) == pytest.approx(delays)
        assert (faults.loss, faults.duplicate, faults.reorder, faults.cut) == (0.25, 0.5, 0.125, True)
        assert math.isinf(board.link.patience_s) is lockstep


def test_the_clock_steps_ahead_and_never_back() -> None:
    board = Board(lockstep=False)
    assert board.ask(clock_offset_ns=3 * SECOND) == []
    assert board.clock.offset_ns == 3 * SECOND
    assert board.ask(clock_offset_ns=5 * SECOND) == []
    (refused,) = board.ask(clock_offset_ns=4 * SECOND)
    assert refused == "Fault refused: clock offset 4 s; the clock is 5 s ahead and never steps back"
    assert board.ask() == [], "the end of all faults leaves the clock where it is"
    assert board.clock.offset_ns == 5 * SECOND
    assert board.stepped_ns == [3 * SECOND, 2 * SECOND, 0]


@pytest.mark.parametrize(("after_ns", "lasts"), [(10 * SECOND, True), (10 * SECOND + 1, False)])
def test_faults_end_ten_seconds_after_the_last_request(after_ns: int, lasts: bool) -> None:
    board = Board(lockstep=False)
    board.faults.lapse()
    board.ask(loss=0.5)
    board.now_ns += 9 * SECOND
    board.ask(loss=0.5)
    board.now_ns += after_ns
    board.faults.lapse()
    assert board.link.faults.loss == (0.5 if lasts else 0.0)
    board.ask(loss=0.5)
    assert board.link.faults.loss == 0.5, "the same request begins it again"


def test_a_new_run_has_no_faults_and_counts_anew() -> None:
    board = Board(lockstep=True)
    board.ask(cut=1)
    for _ in range(3):
        board.link.send(b"\xfd" + bytes(11))
    assert board.faults.impaired == 3
    board.faults.start_run(None, SimpleNamespace())  # type: ignore[arg-type]
    assert board.faults.impaired == 0
    assert not board.link.faults.cut
