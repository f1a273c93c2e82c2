"""Streams of commands against an autopilot that the test plays: GUIDED, who overrules, silence."""

from __future__ import annotations

from functools import cache
from typing import Any, cast

import pytest

from agent.wire import dialect
from sim_core.geodesy import LocalFrame
from xitl_cli.profile import RunProfile, load_profile
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
from xitl_cli.run.nodes.drivers import RosDriver, VehicleDriver
from xitl_cli.run.nodes.vessel_orders import VesselOrders
from xitl_cli.run.operator.actions import (
    ActionError,
    Arm,
    ChangeMission,
    ChangeMode,
    CommandMotor,
    EndRun,
    SteerVelocity,
)

MS = 1_000_000
FRAME = LocalFrame(-8.8, -63.95, 70.0)
SET_MODE, START = dialect.MAV_CMD_DO_SET_MODE, dialect.MAV_CMD_MISSION_START
HOLD, AUTO, GUIDED = 4, 10, 15
BODY_NED, SPEED_AND_TURN_RATE = 8, 0x05C7  # mavlink.io/en/messages/common.html


class Driver(VehicleDriver):
    """Who brings the vessel under way: `left` once it has."""

    left, finished = True, False

    @property
    def departed(self) -> bool:
        return self.left

    def finish(self) -> None:
        self.finished = True


@cache
def run_profile(name: str, driver: str) -> RunProfile:
    return load_profile(name, [f"driver.kind={driver}", "ros.enabled=false"]).runnable()


class Helm:
    """Orders, and the autopilot at the other end of them; `beat` is its heartbeat in a mode."""

    def __init__(self, driver: str = "mission", profile: str = "sitl") -> None:
        self.view = AgentView(FRAME, lambda severity, text: None, lambda stamp, estimate: None)
        self.sent: list[Any] = []
        self.said: list[str] = []
        self.driver = Driver()
        self.now_ns = 0
        run = run_profile(profile, driver)
        commands = AutopilotCommands(self.view, self.sent.append, 1, 1)
        self.orders = VesselOrders(run, commands, FRAME, cast(Any, None), self.driver)
        self.beat(HOLD)

    def steer(self, speed_mps: float = 1.0, turn_rate_radps: float = 0.2) -> None:
        self.orders.give(SteerVelocity(speed_mps=speed_mps, turn_rate_radps=turn_rate_radps))

    def go_on(self, ms: int = 20) -> None:
        self.now_ns += ms * MS
        self.orders.update(self.now_ns, self.said.append)

    def accept(self, command: int) -> None:
        self.view.handle(dialect.MAVLink_command_ack_message(command, dialect.MAV_RESULT_ACCEPTED, 0, 0, 255, 190))

    def beat(self, mode: int) -> None:
        self.view.handle(dialect.MAVLink_heartbeat_message(11, 3, 0, mode, 4, 3))

    def under_way(self) -> None:
        """A stream in force, and the autopilot's word for it."""
        self.steer()
        self.go_on()
        self.accept(SET_MODE)
        self.go_on()
        self.beat(GUIDED)
        self.go_on()
        self.sent.clear()

    def modes(self) -> list[float]:
        return [m.param2 for m in self.sent if m.get_msgId() == 76 and m.command == SET_MODE]

    def targets(self) -> list[Any]:
        return [m for m in self.sent if isinstance(m, dialect.MAVLink_set_position_target_local_ned_message)]


def test_the_first_velocity_brings_guided_and_then_each_is_sent() -> None:
    helm = Helm()
    helm.steer(1.5, -0.3)
    helm.go_on()
    assert helm.modes() == [GUIDED]
    assert helm.targets() == []
    helm.accept(SET_MODE)
    helm.go_on()
    (sent,) = helm.targets()
    assert (sent.coordinate_frame, sent.type_mask) == (BODY_NED, SPEED_AND_TURN_RATE)
    assert (sent.vx, sent.vy, sent.yaw_rate) == (1.5, 0.0, -0.3)
    helm.steer(2.0, 0.0)
    helm.go_on()
    assert [m.vx for m in helm.targets()] == [1.5, 2.0]
    assert helm.said == ["velocity: in GUIDED"]


def test_a_stream_that_falls_silent_is_hold_and_one_that_comes_back_is_guided() -> None:
    helm = Helm()
    helm.under_way()
    helm.go_on(900)
    assert helm.modes() == []
    helm.go_on(200)
    assert helm.modes() == [HOLD]
    assert helm.orders.silences == 1
    assert helm.said[-1] == "no velocity for 1 s: HOLD, outputs neutral"
    helm.accept(SET_MODE)
    helm.beat(HOLD)
    helm.go_on()
    helm.go_on(5000)
    assert helm.orders.silences == 1
    helm.steer()
    helm.go_on()
    assert helm.modes() == [HOLD, GUIDED]


def test_who_chooses_another_mode_has_the_vessel_until_the_stream_pauses() -> None:
    helm = Helm()
    helm.under_way()
    helm.beat(AUTO)
    for _ in range(200):
        helm.steer()
        helm.go_on()
    assert helm.modes() == []
    assert len(helm.targets()) == 0
    assert "because AUTO was chosen" in helm.said[-1]
    helm.go_on(1100)
    assert helm.modes() == []  # nor is it brought to HOLD: it was not the stream that drove
    helm.steer()
    helm.go_on()
    assert helm.modes() == [GUIDED]


@pytest.mark.parametrize(("order", "goes_on"), [("HOLD", False), ("GUIDED", True)])
def test_a_mode_that_is_asked_for_overrules_a_stream_but_for_its_own(order: str, goes_on: bool) -> None:
    helm = Helm()
    helm.under_way()
    helm.orders.give(ChangeMode(mode=order))
    helm.go_on()
    helm.accept(SET_MODE)
    helm.sent.clear()
    for _ in range(10):
        helm.steer()
        helm.go_on()
        helm.accept(SET_MODE)
    assert bool(helm.targets()) == goes_on


def test_arming_does_not_end_a_stream_nor_a_stream_an_arming() -> None:
    helm = Helm()
    helm.orders.give(Arm(armed=True))
    helm.steer()
    helm.go_on()
    assert sorted(m.command for m in helm.sent) == sorted([dialect.MAV_CMD_COMPONENT_ARM_DISARM, SET_MODE])
    helm.under_way()
    helm.orders.give(Arm(armed=False))
    helm.steer()
    helm.go_on()
    assert len(helm.targets()) == 1


def test_a_stream_from_before_the_first_heartbeat_is_no_error() -> None:
    helm = Helm()
    helm.view.heard = False
    helm.orders.check(SteerVelocity(speed_mps=1.0, turn_rate_radps=0.0))
    helm.steer()
    helm.go_on()
    assert helm.modes() == []
    with pytest.raises(ActionError, match="has not sent a heartbeat yet"):
        helm.orders.check(Arm())
    helm.beat(HOLD)
    helm.steer()
    helm.go_on()
    assert helm.modes() == [GUIDED]


def test_a_stream_from_before_the_departure_takes_over_after_it() -> None:
    helm = Helm()
    helm.driver.left = False
    for _ in range(600):
        helm.steer()
        helm.go_on()
    assert helm.modes() == []
    assert helm.said == []
    helm.driver.left = True
    helm.steer()
    helm.go_on()
    assert helm.modes() == [GUIDED]


def test_a_refused_guided_is_asked_for_as_long_as_the_stream_goes_on() -> None:
    helm = Helm()
    for _ in range(700):
        helm.steer()
        helm.go_on()
    assert len(helm.modes()) >= 13
    assert len([text for text in helm.said if "not in GUIDED after 10 s" in text]) == 1


def test_a_mission_is_started_cleared_and_replaced() -> None:
    helm = Helm()
    helm.orders.give(ChangeMission(do="start"))
    helm.go_on()
    assert helm.sent[-1].command == START
    helm.accept(START)
    helm.go_on()
    helm.orders.give(ChangeMission(do="clear"))
    helm.go_on()
    assert isinstance(helm.sent[-1], dialect.MAVLink_mission_clear_all_message)
    helm.orders.handle(dialect.MAVLink_mission_ack_message(255, 190, dialect.MAV_MISSION_ACCEPTED, 0))
    helm.go_on()
    helm.orders.give(ChangeMission(do="replace", waypoints_ned_m=((10.0, 5.0), (20.0, 5.0))))
    helm.go_on()
    assert helm.sent[-1].count == 3  # home is the first
    for seq in range(3):
        helm.orders.handle(dialect.MAVLink_mission_request_int_message(255, 190, seq, 0))
    north_m, east_m, _ = FRAME.ned([helm.sent[-1].x * 1e-7], [helm.sent[-1].y * 1e-7], [70.0])[0]
    assert (north_m, east_m) == pytest.approx((20.0, 5.0), abs=0.02)  # 1e-7 of a degree is 11 mm
    helm.orders.handle(dialect.MAVLink_mission_ack_message(255, 190, dialect.MAV_MISSION_ACCEPTED, 0))
    helm.go_on()
    assert helm.said == ["start the mission: accepted", "clear the mission: accepted", "replace the mission: accepted"]


def test_what_nobody_could_carry_out_is_refused() -> None:
    helm = Helm()
    with pytest.raises(ActionError, match="the autopilot commands the motors"):
        helm.orders.check(CommandMotor(number=0, command=0.5))
    with pytest.raises(ActionError, match=r"this action needs driver\.kind: ros"):
        helm.orders.check(EndRun())
    helm = Helm(profile="sitl-px4")
    with pytest.raises(ActionError, match="PX4 does not accept a speed and a turn rate"):
        helm.orders.check(SteerVelocity(speed_mps=1.0, turn_rate_radps=0.0))


def test_a_run_that_nodes_drive_has_the_end_that_they_ask_for() -> None:
    helm = Helm("ros")
    helm.orders.check(EndRun())
    helm.orders.give(EndRun())
    assert helm.driver.finished
    view = AgentView(FRAME, lambda severity, text: None, lambda stamp, estimate: None)
    driver = RosDriver(AutopilotCommands(view, lambda message: None, 1, 1), FRAME, arms=True)
    assert not driver.progress().completed
    driver.finish()
    assert driver.progress().finished
