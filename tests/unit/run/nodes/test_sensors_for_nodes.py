"""What a run does for nodes of ROS beside the bridge: sensors without an autopilot, and the rate of the estimate."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any

import numpy as np

from agent.wire import dialect
from agent.wire.codec import Message, decode
from tests.unit.sim_core.motion import at_rest
from xitl_cli.profile.load import load_profile
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.nodes.autopilot_commands import REPEAT_S, AutopilotCommands
from xitl_cli.run.nodes.estimate_rate import ASKED_S, EstimateRate
from xitl_cli.run.nodes.recorders import SensorRecorder
from xitl_cli.run.world.world import local_frame
from xitl_cli.seeds import Seeds

POSITION, ATTITUDE = dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
PROFILE = load_profile("ros-thrusters").runnable()


def step_at(number: int, rate_hz: float = 400.0) -> Any:
    still = at_rest()
    state = SimpleNamespace(wind_ned_mps=np.zeros((1, 3)))
    return SimpleNamespace(number=number, now_ns=round(number * 1e9 / rate_hz), motion=still, state=state)


def test_sensors_are_recorded_at_their_rates_without_an_autopilot() -> None:
    assert PROFILE.sensors is not None
    assert PROFILE.autopilot.kind == "none"
    frames: list[Message] = []
    recorder = SimpleNamespace(frame_sent=lambda stamp_ns, frame: frames.append(decode(frame)))
    node = SensorRecorder(PROFILE, Seeds(1))
    node.begin(SimpleNamespace(recorder=recorder))  # type: ignore[arg-type]
    for number in range(1, 401):
        node.sense(step_at(number))
    counts = Counter(frame.get_type() for frame in frames)
    sensors = PROFILE.sensors
    assert counts["XITL_IMU"] == sensors.imu.rate_hz
    assert counts["XITL_MAGNETOMETER"] == sensors.magnetometer.rate_hz
    assert counts["XITL_BAROMETER"] == sensors.barometer.rate_hz
    assert 0 < counts["XITL_GNSS"] <= sensors.gnss.rate_hz  # the last may be on its way
    accel = np.mean([frame.accel for frame in frames if frame.get_type() == "XITL_IMU"], axis=0)
    assert abs(accel[2] + 9.78) < 0.5  # at rest, in FRD


class Asked:
    """An autopilot that answers SET_MESSAGE_INTERVAL, or does not."""

    def __init__(self, answers: bool = True) -> None:
        self.view = AgentView(local_frame(PROFILE.site), lambda severity, text: None, lambda agent_us, estimate: None)
        self.messages: list[Message] = []
        self.answers = answers
        self.node = EstimateRate(AutopilotCommands(self.view, self._send, 1, 1), 25.0)

    def _send(self, message: Message) -> None:
        self.messages.append(message)

    def run(self, seconds: float, rate_hz: float = 50.0) -> None:
        for number in range(1, round(seconds * rate_hz)):
            sent = len(self.messages)
            self.node.exchange(step_at(number, rate_hz))
            if self.answers and len(self.messages) > sent:
                self.view.acks[dialect.MAV_CMD_SET_MESSAGE_INTERVAL] = 0


def test_position_and_attitude_are_asked_for_once_each_when_accepted() -> None:
    autopilot = Asked()
    autopilot.run(1.0)
    assert autopilot.messages == []  # nobody is there yet
    autopilot.view.heard = True
    autopilot.run(5.0)
    assert [(round(one.param1), one.param2) for one in autopilot.messages] == [(POSITION, 40e3), (ATTITUDE, 40e3)]


def test_one_that_does_not_answer_is_asked_again_and_then_left_alone() -> None:
    autopilot = Asked(answers=False)
    autopilot.view.heard = True
    autopilot.run(ASKED_S + 20.0)
    assert {round(one.param1) for one in autopilot.messages} == {POSITION}
    assert abs(len(autopilot.messages) - ASKED_S / REPEAT_S) <= 1
