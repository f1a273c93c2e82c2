"""Lockstep: a tick, and the wait for its answer."""

from __future__ import annotations

import time
from collections.abc import Callable

from xitl_cli.run.links.connection import AgentConnection

REPEAT_S = 0.5


class StoppedWaitingError(Exception):
    """Somebody ends the run while an answer is waited for."""


def tick_and_wait(agent: AgentConnection, sim_ns: int, tick: int, silent_s: float, check: Callable[[], None]) -> None:
    """Send the tick until it is answered; what comes meanwhile is taken in.

    Raises UserError when there is no answer for `silent_s` or the agent is known to be gone, and what `check` raises.
    """
    inbox = agent.inbox
    agent.send_tick(sim_ns, tick)
    agent.receive(0.0)
    started_s = sent_s = time.monotonic()
    while inbox.answered_tick != tick:
        agent.receive(REPEAT_S)
        if inbox.answered_tick == tick:
            return
        now_s = time.monotonic()
        if now_s - started_s > silent_s:
            raise agent.silent(now_s - started_s)
        if now_s - sent_s > REPEAT_S:
            agent.peer.check()
            check()
            agent.send_tick(sim_ns, tick)
            sent_s = now_s
