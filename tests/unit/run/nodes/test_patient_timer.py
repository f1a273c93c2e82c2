"""How long an answer may take."""

from __future__ import annotations

import pytest

from xitl_cli.run.nodes import preparation
from xitl_cli.run.nodes.preparation import WALL_SHARE, PatientTimer

S = 1_000_000_000


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(preparation.time, "monotonic", lambda: now[0])
    return now


def test_it_is_over_when_both_clocks_say_so(wall: list[float]) -> None:
    waiting = PatientTimer()
    assert not waiting.started
    assert not waiting.is_over(50 * S, 1.0)
    waiting.start(10 * S)
    wall[0] += 0.9 * WALL_SHARE
    assert not waiting.is_over(30 * S, 1.0)  # twenty seconds of simulation in a moment
    wall[0] += 0.2 * WALL_SHARE
    assert waiting.is_over(30 * S, 1.0)
    assert not waiting.is_over(10 * S + S // 2, 1.0)


def test_it_starts_anew_and_stops(wall: list[float]) -> None:
    waiting = PatientTimer()
    waiting.start(0)
    wall[0] += 10.0
    waiting.start(5 * S)
    assert not waiting.is_over(6 * S, 1.0)
    waiting.stop()
    assert not waiting.is_over(60 * S, 1.0)
