"""Mode changes and failsafes, from messages of the embedded autopilot, a real ArduRover and a real PX4."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agent.wire import dialect
from agent.wire.codec import decode
from agent.wire.framing import Framer
from sim_core.geodesy import LocalFrame
from tests.doubles.capture import MAVLINK, read_capture
from tests.golden import Golden
from xitl_cli.record.topics import AutopilotEvent
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.nodes.autopilot_events import AutopilotEventNode
from xitl_cli.run.summary import stop_text

DATA = Path(__file__).parents[3] / "data"
AUTO, HOLD, RTL, GUIDED = 10, 4, 11, 15
PX4_AUTO, PX4_LOITER = 4 << 16 | 4 << 24, 4 << 16 | 3 << 24
ACTIVE, CRITICAL = dialect.MAV_STATE_ACTIVE, dialect.MAV_STATE_CRITICAL
ARDUPILOT, PX4 = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, dialect.MAV_AUTOPILOT_PX4


class Vessel:
    """An autopilot as the run hears it, and the record of its events."""

    def __init__(self, autopilot: int = ARDUPILOT) -> None:
        self.view = AgentView(LocalFrame(-8.8, -63.95, 70.0), lambda severity, text: None, lambda stamp, estimate: None)
        self.node = AutopilotEventNode(self.view)
        self.recorded: list[tuple[int, AutopilotEvent]] = []
        self.log: list[str] = []
        self._autopilot = autopilot
        self._now_ns = 0
        recorder = SimpleNamespace(
            write=lambda stamp_ns, event: self.recorded.append((stamp_ns, event)),
            log=lambda stamp_ns, severity, source, text: self.log.append(text),
        )
        context: Any = SimpleNamespace(recorder=recorder, clock=SimpleNamespace(now_ns=lambda: self._now_ns))
        self.node.begin(context)

    def hear(self, at_s: float, message: Any) -> None:
        self.pass_until(at_s)
        self.view.handle(message)
        self.node.handle(message)

    def beat(self, at_s: float, mode: int, armed: bool = True, status: int = ACTIVE) -> None:
        base = dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        self.hear(at_s, dialect.MAVLink_heartbeat_message(11, self._autopilot, base, mode, status, 3))

    def say(self, at_s: float, text: str) -> None:
        self.hear(at_s, dialect.MAVLink_statustext_message(2, text.encode(), 0, 0))

    def fence(self, at_s: float, mitigation: int, breached: bool = False) -> None:
        kind = 3 if breached else 0  # FENCE_BREACH_BOUNDARY
        self.hear(at_s, dialect.MAVLink_fence_status_message(breached, breached, kind, 0, mitigation))

    def pass_until(self, at_s: float) -> None:
        self._now_ns = round(at_s * 1e9)
        step: Any = SimpleNamespace(now_ns=self._now_ns)
        self.node.exchange(step)

    def stop(self, driver: str = "mission") -> str:
        self.node.end()
        assert self.node.report()["autopilot_events"] == [event for _, event in self.recorded]
        return stop_text(self.node.events, driver)


@pytest.fixture
def vessel() -> Vessel:
    """Armed, in AUTO."""
    made = Vessel()
    made.beat(0.0, HOLD, armed=False)
    made.beat(1.0, AUTO)
    return made


def test_the_start_of_a_mission_stops_nothing(vessel: Vessel) -> None:
    assert [event.event for event in vessel.node.events] == ["armed", "mode"]
    assert vessel.node.events[1] == AutopilotEvent(1.0, "mode", "AUTO", "HOLD")
    assert vessel.stop() == ""
    assert vessel.log == ["armed in mode AUTO at 1.0 s", "mode AUTO after HOLD at 1.0 s"]


@pytest.mark.parametrize("sentence_first", [True, False])
def test_a_failsafe_explains_the_mode_whichever_comes_first(vessel: Vessel, sentence_first: bool) -> None:
    """ArduRover sends a heartbeat at a mode change at once, before or behind the sentence."""
    if sentence_first:
        vessel.say(41.0, "EKF failsafe")
        vessel.beat(41.2, HOLD)
    else:
        vessel.beat(41.2, HOLD)
        vessel.say(41.3, "EKF failsafe")
    assert vessel.stop() == "stopped by HOLD (EKF failsafe) at 41.2 s"
    assert vessel.log[-1] == "mode HOLD after AUTO at 41.2 s: EKF failsafe"


@pytest.mark.parametrize(
    ("text", "mode", "stop"),
    [
        ("Fence breached, RTL", RTL, "stopped by RTL (Fence breached) at 20.5 s"),  # the embedded autopilot
        ("Polygon fence breached", RTL, "stopped by RTL (Polygon fence breached) at 20.5 s"),
        ("GCS Failsafe", HOLD, "stopped by HOLD (GCS Failsafe) at 20.5 s"),
        ("Battery 1 is low 10.50V", RTL, "stopped by RTL (Battery 1 is low 10.50V) at 20.5 s"),
        ("Crash: Going to HOLD", HOLD, "stopped by HOLD (Crash: Going to HOLD) at 20.5 s"),
    ],
)
def test_sentences_of_failsafes(vessel: Vessel, text: str, mode: int, stop: str) -> None:
    vessel.say(20.0, text)
    vessel.beat(20.5, mode)
    assert vessel.stop() == stop
    assert vessel.stop("script") == stop


@pytest.mark.parametrize(
    "text", ["EKF failsafe cleared", "GCS Failsafe Cleared", "Polygon fence cleared", "PreArm: Radio failsafe on"]
)
def test_sentences_that_begin_no_failsafe(vessel: Vessel, text: str) -> None:
    vessel.say(20.0, text)
    assert [event.event for event in vessel.node.events] == ["armed", "mode"]


def test_an_ordered_mode_stops_a_mission_but_no_script(vessel: Vessel) -> None:
    vessel.beat(30.0, GUIDED)
    vessel.pass_until(40.0)
    assert vessel.recorded[-1][1] == AutopilotEvent(30.0, "mode", "GUIDED", "AUTO")
    assert vessel.stop("script") == ""
    assert vessel.stop() == "stopped by GUIDED at 30.0 s"


def test_a_vessel_that_sails_on_was_not_stopped(vessel: Vessel) -> None:
    vessel.say(20.0, "EKF failsafe")
    vessel.beat(20.5, HOLD)
    vessel.say(30.0, "EKF failsafe cleared")
    vessel.beat(35.0, AUTO)
    vessel.beat(60.0, HOLD)
    vessel.beat(61.0, AUTO)
    assert vessel.stop() == ""
    changes = [(event.mode, event.reason) for event in vessel.node.events if event.event == "mode"]
    assert changes == [("AUTO", ""), ("HOLD", "EKF failsafe"), ("AUTO", ""), ("HOLD", ""), ("AUTO", "")]


def test_a_disarmed_vessel_is_stopped_by_that(vessel: Vessel, golden: Golden) -> None:
    vessel.say(20.0, "GCS failsafe: no heartbeat for 5 s, disarming")
    vessel.beat(20.5, AUTO, armed=False)
    golden("text", vessel.stop(), "5 s", "20.5 s")


def test_a_failsafe_that_changes_no_mode_is_named_while_in_force(vessel: Vessel, golden: Golden) -> None:
    vessel.say(20.0, "Failsafe: no IMU for 0.25 s, outputs neutral")
    golden("text", vessel.stop(), "20.0 s", "0.25 s")
    vessel.say(25.0, "Failsafe over: IMU is back, outputs resume")
    assert vessel.stop() == ""


def test_a_vessel_that_its_fence_holds_in_auto(vessel: Vessel) -> None:
    """FENCE_STATUS of ArduPilot, whose avoidance limits the speed (FENCE_MITIGATE_VEL_LIMIT) and changes no mode."""
    for second in range(10, 20):
        vessel.fence(second, 2 if second % 2 else 1)
    assert vessel.stop() == "avoidance has kept it at the fence since 11.0 s"
    vessel.pass_until(25.0)
    assert vessel.stop() == ""
    assert [event.event for event in vessel.node.events[2:]] == ["fence limits speed", "fence limit over"]


@pytest.mark.parametrize("status_first", [True, False])
def test_a_breach_without_a_sentence_explains_the_mode(vessel: Vessel, status_first: bool) -> None:
    """ArduPilot Rover 4.7 sends FENCE_STATUS and the mode, and says only "Manual recovery started"."""
    vessel.beat(1.0, AUTO)
    vessel.fence(1.5, 1)
    if status_first:
        vessel.fence(2.0, 1, breached=True)
    vessel.beat(2.1, HOLD)
    vessel.say(2.2, "Manual recovery started")
    vessel.fence(3.0, 1, breached=True)
    vessel.fence(4.0, 1, breached=True)
    vessel.pass_until(9.0)
    assert vessel.stop() == "stopped by HOLD (fence breached) at 2.1 s"
    assert sorted(each.event for each in vessel.node.events[-2:]) == ["failsafe", "mode"]


def test_a_sentence_replaces_the_status_of_a_breach(vessel: Vessel) -> None:
    vessel.beat(1.0, AUTO)
    vessel.fence(2.0, 1, breached=True)
    vessel.say(2.1, "Fence breached: polygon")
    vessel.beat(2.2, RTL)
    vessel.fence(3.0, 1, breached=True)
    vessel.pass_until(9.0)
    assert vessel.stop() == "stopped by RTL (Fence breached: polygon) at 2.2 s"
    assert [each.event for each in vessel.node.events if "failsafe" in each.event] == ["failsafe"]


def test_a_breach_that_changes_no_mode_is_named_until_it_is_over(vessel: Vessel) -> None:
    vessel.beat(1.0, AUTO)
    vessel.fence(2.0, 1, breached=True)
    vessel.pass_until(5.0)
    assert stop_text(vessel.node.events, "mission") == "failsafe active since 2.0 s (fence breached)"
    vessel.fence(6.0, 1)
    assert vessel.stop() == ""
    assert [each.event for each in vessel.node.events if "failsafe" in each.event] == ["failsafe", "failsafe over"]


def test_a_px4_names_a_failsafe_by_its_sentence_or_its_heartbeat(golden: Golden) -> None:
    said, silent = Vessel(PX4), Vessel(PX4)
    for vessel in (said, silent):
        vessel.beat(1.0, PX4_LOITER)
        vessel.beat(2.0, PX4_AUTO)
    said.say(30.0, "Failsafe activated: entering Hold for 5 seconds\t")
    said.beat(30.1, PX4_LOITER, status=CRITICAL)
    golden("message", said.stop(), "30.1 s")
    silent.beat(30.0, PX4_AUTO, status=CRITICAL)
    golden("text", silent.stop(), "30.0 s")
    silent.beat(40.0, PX4_AUTO)
    assert silent.stop() == ""


def captured(name: str, hz: int) -> Iterator[tuple[float, Any]]:
    """Seconds of its simulator and messages of a real autopilot."""
    framer = Framer(stream=True)
    for record in read_capture(DATA / name):
        if record.kind == MAVLINK:
            for frame in framer.feed(record.data):
                yield record.frame / hz, decode(frame)


@pytest.mark.parametrize(
    ("name", "hz", "autopilot", "mode", "hold"),
    [
        ("captures/sitl-ardupilot.xz", 1200, ARDUPILOT, "HOLD", HOLD),
        ("px4/mission.xz", 100, PX4, "LOITER", PX4_LOITER),
    ],
)
def test_a_real_autopilot_that_fails_on_its_second_leg(
    name: str, hz: int, autopilot: int, mode: str, hold: int
) -> None:
    """Its own messages until it has reached the first waypoint, then a failsafe."""
    vessel = Vessel(autopilot)
    at_s = 0.0
    for at_s, message in captured(name, hz):
        vessel.hear(at_s, message)
        if vessel.view.reached_seqs.intersection((1, 2)):
            break
    assert vessel.view.mode == "AUTO"
    assert [event.event for event in vessel.node.events if event.reason] == []
    assert vessel.stop() == ""
    vessel.say(at_s + 1.0, "EKF failsafe" if autopilot == ARDUPILOT else "Failsafe activated")
    vessel.beat(at_s + 1.5, hold)
    reason = vessel.node.events[-1].reason
    assert reason
    assert vessel.stop() == f"stopped by {mode} ({reason}) at {at_s + 1.5:.1f} s"


BREACH_FRAMES = (
    (74.05, "fd0900000c01010000000a0000000b03890403f56f"),
    (74.05, "fd090000160101a200000000000000000000017d0b"),
    (74.58, "fd0900005c0101a2000030230100010001030118f0"),
    (74.67, "fd0900006d0101000000040000000b03810303c0d4"),
    (74.67, "fd1800006e0101fd0000064d616e75616c207265636f766572792073746172746564d96c"),
    (75.06, "fd090000a60101000000040000000b0381030332ac"),
    (75.06, "fd090000af0101a20000302301000100010301a732"),
    (76.05, "fd090000370101000000040000000b03810303bfa7"),
    (76.05, "fd090000400101a200003023010001000103013629"),
)
"""Time (s) and bytes of the heartbeats, fence states and sentences of a Rover 4.7-dev that leaves its polygon."""


def test_a_real_rover_that_breaches_its_fence(vessel: Vessel) -> None:
    framer = Framer(stream=True)
    for at_s, frame in BREACH_FRAMES:
        for each in framer.feed(bytes.fromhex(frame)):
            vessel.hear(at_s, decode(each))
    vessel.pass_until(80.0)
    assert vessel.stop() == "stopped by HOLD (fence breached) at 74.7 s"
