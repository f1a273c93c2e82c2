"""An agent that does not have our run on any more: said at once, before it falls silent, and never 'commands again'."""

from __future__ import annotations

import time
from typing import Any

import pytest

from agent.wire import dialect
from agent.wire.impaired import LinkFaults
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from sim_core.geodesy import LocalFrame
from xitl_cli.profile import load_profile
from xitl_cli.run.core.faults import FaultsInForce
from xitl_cli.run.links import connection as connection_module
from xitl_cli.run.links.connection import AgentConnection
from xitl_cli.run.links.inbox import AgentInbox

SOME_RUN, NONE = 1, 0


def token_of(connection: AgentConnection) -> int:
    """Token of the run, which the agent repeats."""
    return connection._token


class Reached:
    """An agent at the other end of memory that has been reached; `told` is what it says of itself."""

    def __init__(self) -> None:
        here, there = memory_pair("agent")
        self.transport, self.agent = here, Link(there, 1, 1)
        inbox = AgentInbox("agent", LocalFrame(-8.8, -63.95, 70.0), 2, False, lambda stamp_ns, estimate: None)
        self.connection = AgentConnection("agent", load_profile("hitl-loopback").runnable(), inbox)
        self.connection._peer = self
        self.connection.link = inbox.accounts.link = Link(here, 255, 190)
        self.connection._reached = True

    def pump(self) -> None:
        pass

    def check(self) -> None:
        pass

    def tells(self, running: int) -> str | None:
        fields = dict.fromkeys(dialect.MAVLink_xitl_node_status_message.fieldnames, 0)
        self.agent.send(dialect.MAVLink_xitl_node_status_message(**{**fields, "running": running}))
        self.connection.receive()
        self.connection.watch()
        return None if self.connection.gone is None else str(self.connection.gone)


@pytest.fixture
def reached() -> Reached:
    return Reached()


def test_our_run_is_ours_and_one_of_an_earlier_release_tells_no_token(reached: Reached) -> None:
    assert token_of(reached.connection) > SOME_RUN
    assert reached.tells(token_of(reached.connection)) is None
    assert reached.tells(SOME_RUN) is None


def test_an_agent_that_was_started_anew_has_no_run(reached: Reached) -> None:
    assert "it was restarted" in str(reached.tells(NONE))


def test_an_agent_whose_clock_stepped_is_asked_for_its_run_though_it_is_not_silent(reached: Reached) -> None:
    inbox = reached.connection.inbox
    inbox.fresh, inbox.command_ns = True, time.monotonic_ns()
    assert reached.tells(token_of(reached.connection)) is None
    assert reached.agent.receive() == []
    inbox.clock_stepped = True
    reached.connection.watch()
    (asked,) = reached.agent.receive()
    assert asked.command == dialect.XITL_RUN_COMMAND_HELLO
    reached.connection.watch()
    assert reached.agent.receive() == []


def test_an_agent_that_was_started_by_another_host_has_another(reached: Reached) -> None:
    said = str(reached.tells(token_of(reached.connection) % 254 + 2))
    assert "is in another run" in said
    assert "--link-key" in said


@pytest.mark.parametrize(("system", "component"), [(1, 2), (9, 1), (255, 190)])
def test_what_another_sender_claims_to_be_the_agents_is_refused_and_counted(
    reached: Reached, system: int, component: int
) -> None:
    other: Any = Link(reached.agent.transport, system, component)
    fields = dict.fromkeys(dialect.MAVLink_xitl_actuators_message.fieldnames, 0) | {
        "command": [1.0] * 8,
        "more": [0.0] * 8,
    }
    other.send(
        dialect.MAVLink_xitl_actuators_message(**fields),
        dialect.MAVLink_xitl_timesync_message(1, 2, 3, 4),
        dialect.MAVLink_statustext_message(2, b"Failsafe"),
    )
    assert reached.connection.receive() == []
    assert not reached.connection.inbox.fresh
    assert not reached.connection.inbox.view.texts
    _, back = reached.connection.links()
    assert back.refused == 3
    assert back.received == 0
    assert "refused" in reached.connection.warnings()[0]


def test_a_token_would_make_a_run_in_lockstep_another_one() -> None:
    inbox = AgentInbox("agent", LocalFrame(-8.8, -63.95, 70.0), 2, True, lambda stamp_ns, estimate: None)
    assert token_of(AgentConnection("agent", load_profile("sitl").runnable(), inbox)) == 0


def test_frames_that_a_fault_delays_are_sent_before_the_run_ends(
    reached: Reached, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection_module, "STOP_WAIT_S", 0.05)
    reached.connection.apply_faults(0, FaultsInForce(LinkFaults(delay_s=0.1)))
    reached.connection.link.send(dialect.MAVLink_heartbeat_message(0, 0, 0, 0, 0, 3))
    reached.connection.stop()
    heard = [message.get_type() for message in reached.agent.receive()]
    assert heard.index("HEARTBEAT") < heard.index("XITL_RUN")
