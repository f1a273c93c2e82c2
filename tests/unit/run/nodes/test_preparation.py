"""What comes before the orders to another autopilot, and how the vessel is held meanwhile."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agent.mavlink.missions import waypoint_items
from agent.wire import dialect
from sim_core.geodesy import LocalFrame
from sim_core.kinematics import Kinematics
from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.record.topics import MotorCommand
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.nodes import preparation
from xitl_cli.run.nodes.bridge import Milestones
from xitl_cli.run.nodes.drivers import VehicleDriver
from xitl_cli.run.nodes.preparation import (
    SHORTEST_HEARTBEAT_S,
    CalibrationStep,
    MissionStep,
    ParameterStep,
    Preparation,
)

SECOND = 1_000_000_000
TARGET = (1, 1)
FRAME = LocalFrame(-8.8, -63.95, 70.0)


@pytest.fixture(autouse=True)
def _no_wall_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here all goes by simulation time."""
    monkeypatch.setattr(preparation, "WALL_SHARE", 0.0)


class CountingDriver(VehicleDriver):
    """The driver behind: counts how often it is asked."""

    def __init__(self) -> None:
        self.asked = 0
        self.waits_for = ""
        self.problem = ""

    def update(self, sim_ns: int) -> None:
        self.asked += 1
        if self.problem:
            raise UserError(self.problem)

    def progress(self) -> Progress:
        return Progress("", waits_for=self.waits_for)


class Case:
    def __init__(self, held: bool = True) -> None:
        self.view = AgentView(FRAME, lambda severity, text: None, lambda stamp, estimate: None)
        self.sent: list[Any] = []
        self.driver = CountingDriver()
        self.preparation = Preparation(
            self.driver,
            self.view,
            ParameterStep(self.sent.append, TARGET, {"WP_SPEED": 3.0}),
            MissionStep(self.sent.append, TARGET, {0: waypoint_items([(0.0, 0.0, 0.0)])}),
            CalibrationStep(self.sent.append, TARGET, wanted=False),
            held,
            "tcp://127.0.0.1:5760",
            heartbeat_s=1.0,
            arm_timeout_s=90.0,
            complained=lambda: "; the bridge reports: the script says nothing",
        )

    def hear(self, message: Any) -> None:
        self.view.handle(message)
        self.preparation.handle(message)

    def beat(self, armed: bool = False, mode: int = 0, autopilot: int = 3, state: int = 4) -> None:
        base = dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        self.hear(dialect.MAVLink_heartbeat_message(11, autopilot, base, mode, state, 3))

    def take_parameters(self) -> None:
        self.hear(dialect.MAVLink_param_value_message(b"WP_SPEED", 3.0, 9, 900, 65535))

    def waits_for(self) -> str:
        return self.preparation.progress().waits_for


def test_heartbeat_parameters_mission_and_then_the_orders(golden: Golden) -> None:
    case = Case()
    assert case.waits_for() == "the autopilot to send its first heartbeat"
    case.preparation.update(SECOND)
    assert case.sent == []
    case.beat()
    case.preparation.update(2 * SECOND)
    assert case.waits_for() == "the autopilot to accept its parameters"
    case.take_parameters()
    case.preparation.update(3 * SECOND)
    assert case.waits_for() == "the autopilot to accept the mission"
    assert case.driver.asked == 0
    case.hear(dialect.MAVLink_mission_request_int_message(255, 190, 0, 0))
    case.hear(dialect.MAVLink_mission_ack_message(255, 190, dialect.MAV_MISSION_ACCEPTED, 0))
    case.preparation.update(4 * SECOND)
    assert case.driver.asked == 1
    assert case.waits_for() == "the autopilot to become ready to arm"
    case.driver.problem = "gave up after 60 s"
    with pytest.raises(UserError) as refused:
        case.preparation.update(5 * SECOND)
    golden("error", refused.value, "60 s")


def test_an_autopilot_that_is_starting_is_given_parameters_and_no_mission() -> None:
    """A Rover has no room for a mission until it has started, and its board may be slow."""
    case = Case()
    case.beat(state=dialect.MAV_STATE_CALIBRATING)
    case.preparation.update(SECOND)
    case.take_parameters()
    case.sent.clear()
    case.preparation.update(2 * SECOND)
    assert case.waits_for() == "the autopilot to start"
    assert case.sent == []
    case.beat(state=dialect.MAV_STATE_STANDBY)
    case.preparation.update(3 * SECOND)
    assert [message.get_type() for message in case.sent] == ["MISSION_COUNT"]
    case.beat(state=dialect.MAV_STATE_CALIBRATING)
    case.preparation.update(4 * SECOND)
    assert case.waits_for() == "the autopilot to accept the mission"


def test_an_autopilot_that_never_says_its_state_is_not_waited_for() -> None:
    case = Case()
    case.beat(state=dialect.MAV_STATE_UNINIT)
    case.preparation.update(SECOND)
    case.take_parameters()
    case.preparation.update(2 * SECOND)
    assert case.waits_for() == "the autopilot to accept the mission"


def test_an_autopilot_that_does_not_finish_starting_ends_the_run_with_what_it_said(golden: Golden) -> None:
    case = Case()
    case.beat(state=dialect.MAV_STATE_CALIBRATING)
    for text in (b"Baro: unable to calibrate", b"fix problem then reboot"):
        case.hear(dialect.MAVLink_statustext_message(2, b"Config Error: " + text))
    case.preparation.update(SECOND)
    case.take_parameters()
    case.preparation.update(90 * SECOND)
    with pytest.raises(UserError) as refused:
        case.preparation.update(91 * SECOND)
    golden("error", refused.value, "90 s")


def test_the_vessel_is_let_go_when_it_arms_and_not_held_again() -> None:
    case = Case()
    case.beat(armed=True)
    case.preparation.update(SECOND)
    assert case.waits_for() == ""
    case.beat(armed=False)
    case.preparation.update(2 * SECOND)
    assert case.waits_for() == ""


def test_a_vessel_that_is_not_to_be_moored_floats_free() -> None:
    assert Case(held=False).waits_for() == ""


def test_what_the_driver_waits_for_goes_first() -> None:
    case = Case()
    case.driver.waits_for = "somebody"
    assert case.waits_for() == "somebody"


def test_an_autopilot_that_is_never_heard_ends_the_run_with_its_address(golden: Golden) -> None:
    case = Case()
    case.preparation.update(round(SHORTEST_HEARTBEAT_S * SECOND))
    with pytest.raises(UserError) as refused:
        case.preparation.update(round((SHORTEST_HEARTBEAT_S + 0.1) * SECOND))
    golden("error", refused.value, "20 s")


def test_modes_are_called_as_the_autopilot_calls_them() -> None:
    case = Case()
    for mode, name in ((0, "MANUAL"), (10, "AUTO"), (12, "SMART_RTL"), (77, "mode 77")):
        case.beat(mode=mode)
        assert case.view.mode == name
    case.beat(mode=4 << 16 | 4 << 24, autopilot=dialect.MAV_AUTOPILOT_PX4)
    assert case.view.mode == "AUTO"


def motion(speed_mps: float) -> Kinematics:
    zero = np.zeros((1, 3))
    velocity = np.array([[0.6 * speed_mps, 0.8 * speed_mps, 0.0]])
    return Kinematics(zero, velocity, zero, np.array([[1.0, 0.0, 0.0, 0.0]]), np.eye(3)[None], zero, zero)


def test_milestones_are_noted_once_and_drifting_is_no_motion() -> None:
    case, times = Case(), Milestones()
    still, drives = MotorCommand((0.0, 0.0)), MotorCommand((0.3, 0.2))
    times.update(1 * SECOND, case.view, still, motion(0.7))
    assert times == Milestones()
    case.beat()
    times.update(2 * SECOND, case.view, still, motion(0.7))
    case.hear(dialect.MAVLink_statustext_message(6, b"EKF3 IMU0 origin set"))
    times.update(3 * SECOND, case.view, still, motion(0.7))
    health = dialect.MAV_SYS_STATUS_PREARM_CHECK
    case.hear(dialect.MAVLink_sys_status_message(health, health, health, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0))
    times.update(4 * SECOND, case.view, still, motion(0.7))
    case.beat(armed=True)
    times.update(5 * SECOND, case.view, still, motion(0.7))
    times.update(6 * SECOND, case.view, drives, motion(0.1))
    times.update(7 * SECOND, case.view, drives, motion(0.25))
    times.update(8 * SECOND, case.view, drives, motion(3.0))
    assert times == Milestones(2.0, 3.0, 4.0, 5.0, 7.0)
