"""What a run does for nodes of ROS beside the bridge: sensors without an autopilot, and the rate of the estimate."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.wire import dialect
from agent.wire.codec import Message, decode
from tests.unit.sim_core.motion import at_rest
from xitl_cli.profile.load import load_profile
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
from xitl_cli.run.nodes.companion import ASKS, EstimateRate
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
    """An autopilot that tells its estimate at a rate, which it changes when it is asked for the n-th time."""

    def __init__(self, heeds: int = 1) -> None:
        self.view = AgentView(local_frame(PROFILE.site), lambda severity, text: None, lambda agent_us, estimate: None)
        self.messages: list[Message] = []
        self.rate_hz = 10.0
        self.node = EstimateRate(AutopilotCommands(self.view, self._send, 1, 1), 25.0)
        self._heeds = heeds
        self._said: Any = None
        self.node.begin(SimpleNamespace(recorder=SimpleNamespace(watch=self._watch)))  # type: ignore[arg-type]

    def _watch(self, topic: str, seen: Any) -> None:
        assert topic == "/estimate/odometry"
        self._said = seen

    def _send(self, message: Message) -> None:
        self.messages.append(message)
        if len(self.messages) >= 2 * self._heeds:
            self.rate_hz = 1e6 / message.param2

    def run(self, seconds: float) -> None:
        told = 0.0
        for number in range(1, round(seconds * 50.0)):
            told += self.rate_hz / 50.0
            while told >= 1.0:
                told -= 1.0
                self._said(0)
            self.node.exchange(step_at(number, 50.0))


def test_position_and_attitude_are_asked_for_once_each_when_that_is_heeded() -> None:
    autopilot = Asked()
    autopilot.run(1.0)
    assert autopilot.messages == []  # nobody is there yet
    autopilot.view.heard = True
    autopilot.run(30.0)
    assert [(round(one.param1), one.param2) for one in autopilot.messages] == [(POSITION, 40e3), (ATTITUDE, 40e3)]


@pytest.mark.medium
def test_one_whose_bridge_asks_otherwise_is_asked_again() -> None:
    autopilot = Asked(heeds=3)
    autopilot.view.heard = True
    autopilot.run(60.0)
    assert len(autopilot.messages) == 6


@pytest.mark.medium
def test_one_that_keeps_to_its_rate_is_left_alone_after_some_time() -> None:
    autopilot = Asked(heeds=1000)
    autopilot.view.heard = True
    autopilot.run(120.0)
    assert len(autopilot.messages) == 2 * ASKS


@pytest.mark.medium
def test_one_that_has_no_estimate_yet_is_not_pestered() -> None:
    autopilot = Asked(heeds=1000)
    autopilot.view.heard, autopilot.rate_hz = True, 0.0
    autopilot.run(60.0)
    assert len(autopilot.messages) == 2
