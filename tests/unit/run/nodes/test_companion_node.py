"""A companion in a run, with a connection that the test plays: what it gets, when its answers count, and its end."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any, cast

import pytest

from agent.wire import dialect
from agent.wire.codec import Packer
from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.record.topics import DETECTIONS
from xitl_cli.run.nodes import companion
from xitl_cli.run.nodes.companion import (
    ASKS,
    CompanionNode,
    EstimateRate,
    RosCompanionNode,
    StoppedWaitingError,
    companion_parameters,
)
from xitl_cli.run.nodes.perception import PerceptionNode

S = 1_000_000_000
PROFILE = load_profile("sitl-perception").runnable()


class Connection:
    """Stands in for the link to the companion. log: what happened to it. answers: messages of each receive, in turn."""

    def __init__(self, name: str, profile: Any, inbox: Any, signing: Any, terms: Any) -> None:
        self.inbox, self._packer = inbox, Packer(1, 191)
        self.log: list[tuple[Any, ...]] = []
        self.gone: UserError | None = None
        self.answers: list[list[Any]] = []
        self.peer = SimpleNamespace(check=lambda: None)
        self.room: list[bool] = []
        transport = SimpleNamespace(wait_for_room=lambda wait_s: self.room.pop(0) if self.room else True)
        self.link = SimpleNamespace(transport=transport, wait_for_room=None, pass_on=self._pass_on)

    def begin(self, context: Any, parameters: Any, options: Any) -> None:
        self.log.append(("begin", parameters, options))

    def send_sensors(self, messages: list[Any]) -> None:
        self.log.append(("sensors", *messages))

    def _pass_on(self, *messages: Any) -> None:
        self.log.append(("pass on", *messages))

    def send_tick(self, now_ns: int, tick: int) -> None:
        self.log.append(("tick", now_ns, tick))

    def receive(self, timeout_s: float) -> None:
        if self.answers:
            messages = self.answers.pop(0)
            for message in messages:
                self.inbox.tap("rx", self._packer.pack(message))
            self.inbox.handle(messages)

    def request_time(self) -> None:
        self.log.append(("time",))

    def watch(self) -> None:
        self.log.append(("watch",))

    def again_s(self, repeat_s: float, silent_s: float) -> float:
        return 1.0

    def silent(self, waited_s: float) -> UserError:
        return UserError(f"silent for {waited_s:g} s")

    def stop(self) -> None:
        self.log.append(("stop",))

    def close(self) -> None:
        self.log.append(("close",))


class Clock:
    """The wall clock, which goes on at each look."""

    def __init__(self, step_s: float = 0.3) -> None:
        self.now_s, self.step_s = 0.0, step_s

    def monotonic(self) -> float:
        self.now_s += self.step_s
        return self.now_s

    def monotonic_ns(self) -> int:
        return round(self.now_s * S)


class Ride:
    """A companion of a run. sent: messages to the autopilot."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, lockstep: bool = True, interrupted: bool = False) -> None:
        monkeypatch.setattr(companion, "AgentConnection", Connection)
        self.clock = Clock()
        monkeypatch.setattr(companion, "time", self.clock)
        mode = "lockstep" if lockstep else "realtime"
        self.sent: list[Any] = []
        self.asked_to_stop = interrupted
        profile = load_profile("sitl-perception", ["companion.lag=1", f"clock.mode={mode}"]).runnable()
        self.node = CompanionNode(profile, self.sent.append, lambda: self.asked_to_stop)
        self.connection = cast(Connection, self.node.agent)
        self.watched: dict[str, Any] = {}
        self.said: list[tuple[int, str]] = []
        recorder = SimpleNamespace(
            watch=lambda topic, seen: self.watched.update({topic: seen}),
            log=lambda stamp_ns, severity, source, text: self.said.append((severity, text)),
            frame_received=lambda *given: None,
        )
        self.now_ns = 0
        clock = SimpleNamespace(now_ns=lambda: self.now_ns)
        context = cast(Any, SimpleNamespace(recorder=recorder, clock=clock, pace=None))
        self.node.inbox.begin(context)
        self.node.begin(context)
        self.node.inbox.say = lambda severity, source, text: self.said.append((severity, text))  # type: ignore[method-assign]
        self.connection.log.clear()

    def exchange(self) -> None:
        step = cast(Any, SimpleNamespace(now_ns=self.now_ns))
        self.node.intake.exchange(step)
        self.node.exchange(step)
        self.now_ns += S // 50


def tick(number: int) -> Any:
    return dialect.MAVLink_xitl_tick_message(0, number)


def order(confirmation: int = 0) -> Any:
    return dialect.MAVLink_command_long_message(1, 1, 400, confirmation, 1, 0, 0, 0, 0, 0, 0)


def test_its_parameters_follow_from_vessel_lidar_and_mission() -> None:
    values = companion_parameters(PROFILE)
    vessel = PROFILE.vehicle
    assert (values["HULL_LENGTH"], values["HULL_WIDTH"]) == (vessel.length_m, vessel.width_m)
    assert values["WP_SPEED"] == PROFILE.mission.speed_mps
    assert values["AVD_VESSELS"] == 0.0
    assert PROFILE.sensors is not None
    assert PROFILE.sensors.lidar is not None
    assert values["LIDAR_YAW"] == PROFILE.sensors.lidar.yaw_deg
    heavier = load_profile("sitl-perception", [f"vehicle.mass_kg={1.2 * vessel.mass_kg}"]).runnable()
    assert companion_parameters(heavier)["HULL_WATER"] < values["HULL_WATER"]  # it floats deeper
    changed = load_profile("sitl-perception", ["companion.parameters={HULL_LENGTH: 9.5}"]).runnable()
    assert companion_parameters(changed)["HULL_LENGTH"] == 9.5


def test_each_exchange_sends_a_tick_and_waits_for_the_answer_to_the_one_before(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = Ride(monkeypatch)
    ride.exchange()
    assert ride.connection.log == [("tick", 0, 1)]
    ride.connection.answers = [[order()], [tick(1)]]
    ride.exchange()
    assert ride.connection.log[-1] == ("tick", S // 50, 2)
    assert [message.command for message in ride.sent] == [400]  # it took effect with the answer


def test_orders_after_the_answer_wait_for_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = Ride(monkeypatch)
    ride.exchange()
    ride.connection.answers = [[tick(1), order()]]
    ride.exchange()
    assert ride.sent == []
    ride.connection.answers = [[tick(2)]]
    ride.exchange()
    assert len(ride.sent) == 1


def test_only_messages_for_the_companion_are_passed_on_with_the_next_exchange(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = Ride(monkeypatch)
    heartbeat = dialect.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3)
    ride.node.forward(heartbeat)
    ride.node.forward(dialect.MAVLink_param_value_message(b"A", 1.0, 9, 1, 0))
    ride.exchange()
    assert ride.connection.log == [("pass on", heartbeat), ("tick", 0, 1)]
    ride.connection.answers = [[tick(1)]]
    ride.exchange()
    assert ride.connection.log[-1] == ("tick", S // 50, 2)


def test_sensor_data_and_detections_are_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = Ride(monkeypatch)
    cloud = object()
    ride.node.send([cloud])
    assert ride.connection.log == [("sensors", cloud)]
    ride.node._cameras = {"bow": (0.5, 0.25, -0.75)}
    ride.watched[DETECTIONS](3_000_999, "bow", 7, "b\u00fcoy", 1.0, 2.0, 3.0, 4.0, 0.75, 0.1, 0.2, -0.3, 0.4)
    kind, message = ride.connection.log[-1]
    assert kind == "sensors"
    assert message.time_usec == 3000
    assert list(message.position) == [0.5, 0.25, -0.75]
    assert (message.bearing, message.width, message.bottom, message.top) == (0.1, 0.2, -0.3, 0.4)
    assert message.confidence == 0.75
    assert message.label == "b?oy"


def test_a_tick_without_an_answer_is_sent_again(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = Ride(monkeypatch)
    ride.exchange()
    ride.connection.answers = [[], [], [], [], [tick(1)]]
    ride.exchange()
    ticks = [entry for entry in ride.connection.log if entry[0] == "tick"]
    assert ticks == [("tick", 0, 1), ("tick", 0, 1), ("tick", S // 50, 2)]


def test_a_silent_companion_is_given_up_and_the_run_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = Ride(monkeypatch)
    ride.exchange()
    ride.exchange()
    assert ride.node.gone is not None
    waited_s = float(str(ride.node.gone).split()[2])
    assert PROFILE.companion is not None
    assert PROFILE.companion.silent_s < waited_s <= PROFILE.companion.silent_s + 1.0
    assert ride.node.gone_s == pytest.approx(0.02)
    assert ride.said == [(4, f"the run continues without its companion: {ride.node.gone}")]
    assert ride.node.links() == []
    ride.connection.log.clear()
    ride.node.forward(dialect.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3))
    ride.node.send([object()])
    ride.exchange()
    assert ride.connection.log == []
    assert ride.node.gone is not None


def test_a_companion_that_ended_is_given_up_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = Ride(monkeypatch)
    ride.exchange()

    def ended() -> None:
        raise UserError("it ended with status 3")

    ride.connection.peer.check = ended
    ride.exchange()
    assert str(ride.node.gone) == "it ended with status 3"


def test_a_user_who_ends_the_run_ends_the_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = Ride(monkeypatch)
    ride.exchange()
    ride.asked_to_stop = True
    with pytest.raises(StoppedWaitingError):
        ride.exchange()


def test_a_full_line_is_waited_for_unless_the_companion_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = Ride(monkeypatch)
    wait = ride.connection.link.wait_for_room
    assert wait is not None
    ride.connection.room = [False, False, True]
    wait()
    assert ride.connection.room == []
    ride.connection.room = [False] * 1000
    wait()
    tried = 1000 - len(ride.connection.room)
    assert PROFILE.companion is not None
    assert tried == pytest.approx(PROFILE.companion.silent_s / ride.clock.step_s, abs=2)
    ride.connection.room = [False, True]
    wait()  # one look is enough while it hangs
    assert ride.connection.room == [True]
    wait()
    ride.connection.room = [False, True]
    wait()  # it reads again, so it is waited for
    assert ride.connection.room == []


def test_in_real_time_messages_count_when_they_arrive(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = Ride(monkeypatch, lockstep=False)
    ride.clock.step_s = 0.04
    ride.connection.answers = [[order()]]
    ride.exchange()
    assert len(ride.sent) == 1
    for _ in range(5):
        ride.exchange()
    log = [entry[0] for entry in ride.connection.log]
    assert "tick" not in log
    assert log.count("watch") == 6
    assert log.count("time") == 2  # at 0.1 s, at looks of 0.04 s


def test_the_end_waits_for_the_last_answer_and_orders_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    ride = Ride(monkeypatch)
    ride.exchange()
    ride.connection.answers = [[order()], [tick(1)], [order()]]
    heard: list[Any] = []
    ride.node.heard.subscribe(heard.append)
    ride.node.end()
    assert ride.connection.log[-1] == ("stop",)
    assert ride.sent == []  # the run is over
    assert [message.command for message in heard] == [400]
    assert not ride.node.inbox.holds
    assert len(ride.connection.answers) == 1


# -- nodes of ROS in its place


class Watched:
    def __init__(self) -> None:
        self.seen: dict[str, Any] = {}

    def watch(self, topic: str, seen: Any) -> None:
        self.seen[topic] = seen


def test_nodes_of_ros_count_as_present_when_they_gave_an_order() -> None:
    asked: Counter[str] = Counter()
    spec = cast(Any, SimpleNamespace(runs="board"))
    node, recorder = RosCompanionNode(spec, asked), Watched()
    node.begin(cast(Any, SimpleNamespace(recorder=recorder)))
    for topic, count in (("/lidar/points", 3), ("/sonar/ping", 2), ("/estimate/odometry", 7)):
        for number in range(count):
            recorder.seen[topic](number)
    assert node.report() == {}
    asked["ros"] = 5
    report = node.report()
    (shown,) = report["nodes"]
    assert (shown.estimates, shown.efforts, shown.kind, shown.machine) == (5, 5, "real", "companion board")
    on_host = RosCompanionNode(cast(Any, SimpleNamespace(runs="process")), asked).report()["nodes"][0]
    assert (on_host.kind, on_host.machine) == ("virtual", "this machine")
    (traffic,) = report["agents"]
    assert traffic.to_agent[dialect.MAVLINK_MSG_ID_XITL_CLOUD] == 3
    assert traffic.to_agent[dialect.MAVLINK_MSG_ID_MISSION_CURRENT] == 1


class Commands:
    def __init__(self) -> None:
        self.view = SimpleNamespace(heard=True)
        self.asked: list[tuple[int, float]] = []

    def stream(self, message: int, rate_hz: float) -> None:
        self.asked.append((message, rate_hz))


def requests(arrivals: list[int], heard: bool = True) -> list[int]:
    """How often the rate was requested after each three seconds with so many estimates."""
    commands, recorder = Commands(), Watched()
    commands.view.heard = heard
    rate = EstimateRate(cast(Any, commands), 10.0)
    rate.begin(cast(Any, SimpleNamespace(recorder=recorder)))
    counts = []
    for number, arrived in enumerate(arrivals):
        for _ in range(arrived):
            recorder.seen["/estimate/odometry"](0)
        for part in (0.0, 1.0, 2.9):
            rate.exchange(cast(Any, SimpleNamespace(now_ns=round((3.0 * number + part) * S))))
        counts.append(len(commands.asked) // 2)
    assert {rate_hz for _, rate_hz in commands.asked} <= {10.0}
    assert {message for message, _ in commands.asked} <= {32, 31}  # LOCAL_POSITION_NED, ATTITUDE_QUATERNION
    return counts


def test_a_rate_is_requested_until_enough_estimates_arrive() -> None:
    assert requests([0, 23, 24, 0, 5]) == [1, 2, 2, 2, 2]  # 80 % of 30 are enough
    assert requests([0, 0, 5]) == [1, 1, 2]  # an autopilot that is silent is not asked again
    assert requests([0, *[5] * 9])[-1] == ASKS
    assert requests([0, 5], heard=False) == [0, 0]


# -- perception sensors


class Instrument:
    def __init__(self, *messages: Any, address: str | None = None) -> None:
        self.address, self._messages = address, list(messages)
        self.began: list[Any] = []
        self.closed = False

    def begin(self, recorder: Any) -> None:
        self.began.append(recorder)

    def update(self, step: Any) -> list[Any]:
        return self._messages

    def report(self) -> dict[str, Any]:
        return {"scans": len(self._messages)}

    def close(self) -> None:
        self.closed = True


def test_perception_sensors_send_what_is_due_and_say_where_they_answer() -> None:
    lidar, sonar = Instrument("cloud"), Instrument(address="udp://127.0.0.1:9092")
    sent: list[Any] = []
    said: list[tuple[Any, ...]] = []
    node = PerceptionNode({"lidar": lidar, "sonar": sonar}, sent.append, lambda: ["no map"])
    recorder = SimpleNamespace(perception="perception", log=lambda *given: said.append(given))
    node.begin(cast(Any, SimpleNamespace(recorder=recorder)))
    assert said == [
        (0, 4, "perception", "no map"),
        (0, 6, "perception", "sonar answers its own protocol at udp://127.0.0.1:9092"),
    ]
    assert (lidar.began, sonar.began) == (["perception"], ["perception"])
    node.sense(cast(Any, None))
    assert sent == [["cloud"]]
    assert node.report() == {"perception": {"lidar": {"scans": 1}, "sonar": {"scans": 0}}}
    node.close()
    assert (lidar.closed, sonar.closed) == (True, True)
