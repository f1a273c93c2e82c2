"""Lockstep that stands still, goes on for a while, and keeps a pace, on a clock of its own."""

from __future__ import annotations

import pytest

from xitl_cli.run.core import pace as pace_module
from xitl_cli.run.core.pace import LISTEN_S, OperatedLockstep

STEP_NS = 2_500_000


class Wall:
    """A clock that goes on while somebody sleeps."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_ns = 0
        self.interrupted = False
        monkeypatch.setattr(pace_module.time, "sleep", self.sleep)

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> Wall:
    return Wall(monkeypatch)


def made(wall: Wall, factor: float | None = None) -> OperatedLockstep:
    return OperatedLockstep(lambda: wall.interrupted, factor, lambda: wall.now_ns)


def go(pace: OperatedLockstep, first: int, last: int) -> None:
    for number in range(first, last + 1):
        pace.wait_until(number * STEP_NS, lambda seconds: None)


def test_as_fast_as_it_can_waits_for_nothing(wall: Wall) -> None:
    go(made(wall), 1, 400)
    assert wall.now_ns == 0


@pytest.mark.parametrize("factor", [0.1, 1.0, 4.0])
def test_a_pace_is_kept(wall: Wall, factor: float) -> None:
    go(made(wall, factor), 1, 401)
    assert wall.now_ns == pytest.approx(1e9 / factor, rel=1e-6)


def test_what_was_lost_by_more_than_half_a_second_is_not_raced_after(wall: Wall) -> None:
    pace = made(wall, 1.0)
    go(pace, 1, 1)
    wall.now_ns += 3_000_000_000
    go(pace, 2, 402)
    assert wall.now_ns == pytest.approx(4e9, rel=2e-3)


def test_a_paused_run_listens_and_goes_on_for_a_step(wall: Wall) -> None:
    pace, heard = made(wall), []

    def listen() -> None:
        heard.append(wall.now_ns)
        if len(heard) == 5:
            pace.step(4 * STEP_NS)
        if len(heard) == 9:
            pace.resume()

    pace.listen = listen
    go(pace, 1, 10)
    pace.pause(10 * STEP_NS)
    assert pace.paused
    go(pace, 11, 14)
    assert len(heard) == 5  # until it was asked to step
    go(pace, 15, 15)
    assert len(heard) == 9
    assert wall.now_ns == round(9 * LISTEN_S * 1e9)
    assert not pace.paused


def test_ctrl_c_ends_a_standstill(wall: Wall) -> None:
    pace = made(wall)

    def listen() -> None:
        wall.interrupted = True

    pace.listen = listen
    pace.pause(0)
    go(pace, 1, 1)
    assert wall.now_ns == round(LISTEN_S * 1e9)


def test_another_pace_begins_from_now(wall: Wall) -> None:
    pace = made(wall, 0.5)
    go(pace, 1, 201)
    pace.set_factor(2.0)
    before_ns = wall.now_ns
    go(pace, 202, 602)
    assert wall.now_ns - before_ns == pytest.approx(0.5e9, rel=1e-2)
    pace.set_factor(None)
    stood_ns = wall.now_ns
    go(pace, 603, 1000)
    assert wall.now_ns == stood_ns
