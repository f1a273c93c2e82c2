"""The bridge between the pipe of a run and a middleware that the test plays."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from tests.patience import PATIENCE_S
from xitl_cli.errors import UserError
from xitl_cli.pipe import Pipe, PipeClosedError
from xitl_cli.plugins.ros import process
from xitl_cli.plugins.ros.definitions import deserialize, serialize
from xitl_cli.plugins.ros.middleware import MiddlewareLosses, QosProfile
from xitl_cli.plugins.ros.msg import Twist, Vector3
from xitl_cli.plugins.ros.pipe_messages import RosAnswer, RosBatch, RosChannel, RosClockAgain, RosEnd, RosStart
from xitl_cli.plugins.ros.process import Publisher, RosBridge
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.ros import RosSpec, RosTopicSpec
from xitl_cli.record.topics import TOPICS

MS = 1_000_000


class Graph:
    """A middleware without a network."""

    name = "graph"

    def __init__(self) -> None:
        self.sent: dict[str, list[bytes]] = {}
        self.qos: dict[str, QosProfile] = {}
        self.handlers: dict[str, Any] = {}
        self.services: dict[str, Any] = {}
        self.pending: list[str] = []
        self.spins: list[float] = []
        self.closed = 0

    def advertise(self, topic: str, type_name: str, qos: QosProfile) -> Any:
        self.qos[topic] = qos
        return self.sent.setdefault(topic, []).append

    def subscribe(self, topic: str, type_name: str, qos: QosProfile, handle: Any) -> None:
        self.handlers[topic] = handle

    def serve(self, service: str, type_name: str, answer: Any) -> None:
        self.services[service] = answer

    def spin(self, timeout_s: float) -> None:
        self.spins.append(timeout_s)

    def problems(self) -> list[str]:
        problems, self.pending = self.pending, []
        return problems

    def losses(self) -> MiddlewareLosses:
        return MiddlewareLosses(dropped={"/fix": 2}, refused={"/cmd_vel": 3})

    def close(self) -> None:
        self.closed += 1


class Ends:
    """A bridge, and the run's end of its pipe."""

    def __init__(self, spec: RosSpec, operated: bool = False) -> None:
        run, bridge = socket.socketpair()
        self.run, pipe = Pipe.of_run(run), Pipe.of_process(bridge)
        self.graph = Graph()
        profile = replace(load_profile("sitl").runnable(), ros=spec)
        self.bridge = RosBridge(pipe, RosStart((profile,), operated), self.graph)
        self._pipe = pipe

    def carry(self, *messages: Any) -> list[dict[str, Any]]:
        """Run the bridge until it has handled these messages; return what it sends."""
        for message in messages:
            self.run.send(message)
        self.run.send(RosEnd())
        self.bridge.run([])
        return self.run.receive(PATIENCE_S)

    def close(self) -> None:
        self.run.close()
        self._pipe.close()


@pytest.fixture
def ends() -> Iterator[Ends]:
    topics = {"wind": RosTopicSpec(rate_hz=10.0), "current": RosTopicSpec(publish=False), "fix": RosTopicSpec(depth=7)}
    made = Ends(RosSpec(topics=topics, namespace="boats", depth=50), operated=True)
    yield made
    made.close()


def environment(stamp_ns: int) -> bytes:
    return TOPICS["/environment"].message_type().encode(stamp_ns, [0.5, 0.0, 0.0], [3.0, -4.0, 0.0], 0.25)


@pytest.mark.parametrize(
    ("rate_hz", "due_ms"),
    [
        (None, [0, 0, 40, 99, 100, 101, 350, 399, 400]),
        (0.0, []),
        (10.0, [0, 100, 350, 400]),
        (20.0, [0, 99, 100, 350, 400]),
    ],
)
def test_a_limited_rate_sends_the_first_message_of_each_period(rate_hz: float | None, due_ms: list[int]) -> None:
    publisher = Publisher("/wind", print, rate_hz)
    stamps_ms = [0, 0, 40, 99, 100, 101, 350, 399, 400]
    assert [stamp for stamp in stamps_ms if publisher.due(stamp * MS)] == due_ms


def test_what_a_run_records_is_published_and_counted(ends: Ends) -> None:
    batch = tuple((4, stamp_ms * MS, environment(stamp_ms * MS)) for stamp_ms in (0, 50, 100))
    ticks = ((7, 20 * MS, b""), (7, 1_000_000_030, b""))
    last = ends.carry(RosChannel(4, "/environment"), RosChannel(7, "/actuators"), RosBatch(batch), RosBatch(ticks))[-1]
    winds = [deserialize(cdr, "geometry_msgs/msg/Vector3Stamped") for cdr in ends.graph.sent["/boats/wind"]]
    assert [(one.header.stamp.nanosec, one.vector.x, one.vector.y) for one in winds] == [
        (0, -4.0, 3.0),
        (100 * MS, -4.0, 3.0),
    ]
    clocks = [deserialize(cdr, "rosgraph_msgs/msg/Clock").clock for cdr in ends.graph.sent["/clock"]]
    assert [(one.sec, one.nanosec) for one in clocks] == [(0, 20 * MS), (1, 30)]
    assert "/boats/current" not in ends.graph.sent
    counts = last["counts"]
    published = {"/clock": 2, "/boats/wind": 2}
    once = ("/tf_static", "/boats/mission", "/boats/robot_description")
    assert counts["published"] == {**published, **dict.fromkeys(once, 1)}
    assert counts["not_read"] == {"/fix": 2}
    assert counts["refused_peers"] == {"/cmd_vel": 3}
    assert (counts["received"], counts["refused"], counts["superseded"]) == ({}, {}, {})
    assert ends.graph.closed == 1


def test_topics_have_the_qos_of_their_kind_and_the_depth_of_the_profile(ends: Ends) -> None:
    qos = ends.graph.qos
    assert qos["/boats/wind"] == QosProfile(depth=50)
    assert qos["/boats/fix"] == QosProfile(depth=7)
    assert qos["/boats/mission"] == qos["/tf_static"] == QosProfile(durability="transient_local", depth=1)
    assert qos["/clock"] == QosProfile(depth=100)


def test_the_newest_clock_is_sent_again_and_not_counted(ends: Ends) -> None:
    last = ends.carry(
        RosClockAgain(),  # before there is one
        RosChannel(1, "/actuators"),
        RosBatch(((1, 10 * MS, b""), (1, 20 * MS, b""))),
        RosClockAgain(),
    )[-1]
    first, second, again = ends.graph.sent["/clock"]
    assert first != second == again
    assert last["counts"]["published"]["/clock"] == 2


def test_a_request_waits_for_the_answer_of_the_run(ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "ANSWER_S", PATIENCE_S)
    refusals: list[str | None] = []
    asking = [threading.Thread(target=lambda: refusals.append(ends.bridge.ask({"action": "arm"}))) for _ in range(2)]
    running = threading.Thread(target=ends.bridge.run, args=([],))
    running.start()
    for number, (thread, refusal) in enumerate(zip(asking, ("not ready", None), strict=True), start=1):
        thread.start()
        sent: list[Any] = []
        while not (asked := [one for one in sent if "action" in one]):
            sent += ends.run.receive(PATIENCE_S)
        assert asked == [{"action": {"action": "arm"}, "request": number}]
        ends.run.send(RosAnswer(99, "of nobody"))
        ends.run.send(RosAnswer(number, refusal))
        thread.join(PATIENCE_S)
    assert refusals == ["not ready", None]
    ends.run.send(RosEnd())
    running.join(PATIENCE_S)
    assert not running.is_alive()


def test_a_run_that_does_not_answer_is_a_refusal(ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "ANSWER_S", 0.01)
    assert ends.bridge.ask({"action": "arm"}) == "the run did not answer within 0.01 s"


def test_a_streamed_command_is_posted_and_its_refusal_is_counted(ends: Ends) -> None:
    command = serialize(Twist(linear=Vector3(1.5, 0.0, 0.0), angular=Vector3(0.0, 0.0, 0.25)))
    ends.graph.handlers["/boats/cmd_vel"](command)
    sent = ends.carry(RosAnswer(None, "the vessel is not armed"))
    actions = [one for one in sent if "action" in one]
    assert actions == [{"action": {"action": "velocity", "speed_mps": 1.5, "turn_rate_radps": -0.25}}]
    assert sent[-1]["counts"]["received"] == {"/boats/cmd_vel": 1}


def test_messages_that_came_with_the_first_are_handled(ends: Ends) -> None:
    ends.bridge.run([RosChannel(2, "/actuators"), RosBatch(((2, 5 * MS, b""),)), RosEnd()])
    assert len(ends.graph.sent["/clock"]) == 1


def test_a_run_that_is_gone_ends_the_bridge(ends: Ends) -> None:
    ends.run.close()
    ends.bridge.run([])
    assert ends.graph.closed == 1


def test_nodes_have_time_to_discover_the_bridge(ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    ends.graph.pending = ["another node publishes /fix"]
    now_s = [100.0]

    def spin(timeout_s: float) -> None:
        now_s[0] += timeout_s

    monkeypatch.setattr(ends.graph, "spin", spin)
    monkeypatch.setattr(process.time, "monotonic", lambda: now_s[0])
    ends.bridge.await_discovery()
    assert now_s[0] == pytest.approx(100.0 + process.DISCOVERY_S, abs=process.SPIN_S)
    monkeypatch.undo()
    problem, counts = ends.run.receive(PATIENCE_S)
    assert problem == {"problem": "another node publishes /fix"}
    assert counts["counts"]["published"]["/tf_static"] == 1


def test_counts_are_reported_every_half_second(ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, reported = [100.0], []
    monkeypatch.setattr(process.time, "monotonic", lambda: now_s[0])
    for now_s[0] in (100.0, 100.25, 100.49, 100.5, 100.75, 101.0):
        ends.bridge._report()
        reported += [now_s[0] for one in ends.run.receive() if "counts" in one]
    assert reported == [100.0, 100.5, 101.0]


def test_the_process_opens_the_middleware_and_tells_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "DISCOVERY_S", 0.0)
    run, other = socket.socketpair()
    pipe, graph = Pipe.of_run(run), Graph()
    specs: list[RosSpec] = []

    def open_middleware(spec: RosSpec) -> Graph:
        specs.append(spec)
        return graph

    monkeypatch.setattr(process, "open_middleware", open_middleware)
    profile = replace(load_profile("sitl").runnable(), ros=RosSpec(domain=3))
    pipe.send(RosStart((profile,)))
    pipe.send(RosEnd())
    process.main([str(other.detach())])
    assert specs == [RosSpec(domain=3)]
    sent = pipe.receive(PATIENCE_S)
    assert {"opened": "graph"} in sent
    assert "received" not in sent[-1]["counts"], "this run accepts no commands"
    assert graph.handlers == {}
    pipe.close()


def test_a_middleware_that_cannot_be_opened_is_told_to_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def open_middleware(spec: RosSpec) -> Graph:
        raise UserError("ros: no such network")

    monkeypatch.setattr(process, "open_middleware", open_middleware)
    run, other = socket.socketpair()
    pipe = Pipe.of_run(run)
    pipe.send(RosStart((load_profile("sitl").runnable(),)))
    process.main([str(other.detach())])
    assert pipe.receive(PATIENCE_S) == [{"failed": "ros: no such network"}]
    with pytest.raises(PipeClosedError):
        pipe.receive(PATIENCE_S)
    pipe.close()
