"""The wait for the answer to a tick, and who is asked meanwhile."""

from __future__ import annotations

from typing import Any

import pytest

from xitl_cli.errors import UserError
from xitl_cli.run.links import connection
from xitl_cli.run.links.connection import AgentConnection


class Agent:
    """In place of an AgentConnection: answers once the tick has been sent `after` times."""

    wait_s = 0.0

    def __init__(self, after: int) -> None:
        self.inbox = self.peer = self
        self.answered_tick = -1
        self.ticks: list[tuple[int, int]] = []
        self._after = after

    def send_tick(self, sim_ns: int, number: int) -> None:
        self.ticks.append((sim_ns, number))

    def again_s(self, interval_s: float, patience_s: float) -> float:
        return interval_s

    def receive(self, seconds: float) -> None:
        if len(self.ticks) >= self._after:
            self.answered_tick = self.ticks[-1][1]

    def check(self) -> None:
        """Its process is well."""

    def silent(self, seconds: float) -> UserError:
        return UserError("silent")


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "TICK_REPEAT_S", 0.0)


def well() -> None:
    """The autopilot runs."""


def test_a_tick_that_got_lost_is_sent_again_as_it_was() -> None:
    agent: Any = Agent(after=3)
    AgentConnection.wait_for_answer(agent, 7, 4, 60.0, well)
    assert agent.ticks == [(7, 4)] * 3


def test_an_autopilot_that_is_gone_ends_the_wait_and_so_does_silence() -> None:
    def gone() -> None:
        raise UserError("it ended by itself")

    silent: Any = Agent(after=1_000_000)
    with pytest.raises(UserError, match="it ended by itself"):
        AgentConnection.wait_for_answer(silent, 7, 4, 60.0, gone)
    with pytest.raises(UserError, match="silent"):
        AgentConnection.wait_for_answer(silent, 7, 4, 0.01, well)
