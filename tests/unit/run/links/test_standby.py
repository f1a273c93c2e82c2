"""A standby agent is brought to where the active one is, by the orders a ground station would give."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from agent.wire import dialect
from sim_core.geodesy import LocalFrame
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.standby import StandbyFollower

S = 1_000_000_000
FRAME = LocalFrame(-8.8, -63.95, 70.0)
AUTO, HOLD = 10, 4


def view() -> AgentView:
    return AgentView(FRAME, lambda severity, text: None, lambda stamp, estimate: None)


class Standby:
    """The standby's side of the link: keeps what it is told."""

    def __init__(self) -> None:
        self.view = view()
        self.sent: list[Any] = []
        agent: Any = SimpleNamespace(target=(3, 1), inbox=SimpleNamespace(view=self.view), send=self.sent.append)
        self.follower = StandbyFollower(agent)

    def told(self, sim_s: float, active: AgentView) -> list[tuple[Any, ...]]:
        self.follower.update(round(sim_s * S), active)
        assert all((message.target_system, message.target_component) == (3, 1) for message in self.sent)
        sent = [
            (message.command, *([message.param1, message.param2] if message.command == SET_MODE else [message.param1]))
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_LONG
            else ("waypoint", message.seq)
            for message in self.sent
        ]
        self.sent.clear()
        return sent


ARM, SET_MODE = dialect.MAV_CMD_COMPONENT_ARM_DISARM, dialect.MAV_CMD_DO_SET_MODE


def beat(seen: AgentView, mode: int, armed: bool, target: int = 0) -> None:
    base = dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    seen.handle(dialect.MAVLink_heartbeat_message(11, 3, base, mode, 4, 3))
    seen.handle(dialect.MAVLink_mission_current_message(target))


@pytest.fixture
def active() -> AgentView:
    seen = view()
    beat(seen, HOLD, armed=False)
    return seen


@pytest.fixture
def standby() -> Standby:
    one = Standby()
    beat(one.view, HOLD, armed=False)
    return one


def accept(one: Standby, command: int) -> None:
    one.view.handle(dialect.MAVLink_command_ack_message(command, dialect.MAV_RESULT_ACCEPTED, 0, 0, 255, 190))


def test_nothing_is_said_while_both_are_alike(active: AgentView, standby: Standby) -> None:
    assert [standby.told(number * 0.02, active) for number in range(500)] == [[]] * 500


def test_it_is_set_to_the_mode_and_armed_once_it_is_ready(active: AgentView, standby: Standby) -> None:
    beat(active, AUTO, armed=True)
    assert standby.told(0.0, active) == []
    assert standby.told(1.5, active) == [(SET_MODE, 1.0, AUTO)]
    assert standby.told(2.0, active) == []  # waits for the answer
    assert standby.told(2.6, active) == [(SET_MODE, 1.0, AUTO)]  # and asks again
    accept(standby, SET_MODE)
    beat(standby.view, AUTO, armed=False)
    assert standby.told(2.7, active) == []  # not ready to arm
    standby.view.ready_to_arm = True
    assert standby.told(2.8, active) == [(ARM, 1.0)]


def test_it_is_disarmed_when_the_active_one_is(active: AgentView, standby: Standby) -> None:
    beat(standby.view, HOLD, armed=True)
    assert standby.told(1.0, active) == []
    assert standby.told(2.5, active) == [(ARM, 0.0)]


def test_two_that_were_told_the_same_may_say_so_a_heartbeat_apart(active: AgentView, standby: Standby) -> None:
    """Armed both, and the standby's heartbeat comes first: it is not to be disarmed, the active one may go any time."""
    beat(standby.view, HOLD, armed=True)
    assert [standby.told(1.0 + number * 0.02, active) for number in range(60)] == [[]] * 60
    beat(active, HOLD, armed=True)
    assert [standby.told(2.2 + number * 0.02, active) for number in range(100)] == [[]] * 100


def test_nobody_follows_one_that_is_silent(active: AgentView, standby: Standby) -> None:
    beat(standby.view, AUTO, armed=True)
    standby.told(1.0, active)
    for number in range(200):
        standby.follower.update(round((1.0 + number * 0.02) * S), active, speaks=False)
    assert standby.sent == []
    assert standby.told(5.0, active) == []  # it speaks again, and its heartbeat is to be waited for


def test_one_that_falls_out_of_line_is_told_again(active: AgentView, standby: Standby) -> None:
    """Accepted once is not enough: a failsafe may have disarmed it since."""
    beat(active, AUTO, armed=True)
    beat(standby.view, AUTO, armed=False)
    standby.view.ready_to_arm = True
    assert standby.told(1.0, active) == []
    assert standby.told(2.5, active) == [(ARM, 1.0)]
    accept(standby, ARM)
    assert [standby.told(2.5 + number * 0.1, active) for number in range(1, 15)] == [[]] * 14
    assert standby.told(4.1, active) == []  # out of patience: what was accepted counts no more
    assert standby.told(4.2, active) == []
    assert standby.told(5.7, active) == [(ARM, 1.0)]


def test_a_waypoint_behind_is_moved_on_only_when_it_stays_behind(active: AgentView, standby: Standby) -> None:
    beat(active, AUTO, armed=True, target=3)
    beat(standby.view, AUTO, armed=True, target=2)
    assert [standby.told(number * 0.1, active) for number in range(30)] == [[]] * 30
    assert standby.told(3.1, active) == [("waypoint", 3)]
    beat(standby.view, AUTO, armed=True, target=3)
    assert standby.told(3.2, active) == []


def test_what_either_has_reached_stays_reached_over_a_takeover() -> None:
    front, other = view(), view()
    beat(front, AUTO, armed=True)
    beat(other, AUTO, armed=True, target=3)
    front.reached_seqs, other.reached_seqs = {1, 2}, {1}
    front.acks, other.acks = {ARM: 0}, {SET_MODE: 0}
    front.adopt(other)
    assert front.reached_seqs == {1, 2}
    assert front.target_seq == 3
    assert front.acks == {ARM: 0, SET_MODE: 0}
