"""ROS beside a run: what waits is bounded, what is lost is said, and what nodes ask is answered."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from xitl_cli.pipe import Pipe
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.ros import RosSpec
from xitl_cli.ros.pipe_messages import RosAnswer, RosBatch, RosChannel, RosEnd
from xitl_cli.run import live_ros
from xitl_cli.run.core.node import RunStep
from xitl_cli.run.live_ros import LiveRosNode


class Beside:
    """A node with its pipe, and the other end of that."""

    def __init__(self, queue_mb: float = 16.0) -> None:
        profile = replace(load_profile("sitl").runnable(), ros=RosSpec(queue_mb=queue_mb))
        self.told: list[str] = []
        self.node = LiveRosNode([profile], self.told.append)
        ours, theirs = socket.socketpair()
        self.node._pipe = Pipe.of_run(ours)
        self.node._holds = True  # whatever the clock on the wall says
        self.bridge = Pipe.of_process(theirs)

    def exchange(self, now_ns: int = 0) -> None:
        step = cast(RunStep, SimpleNamespace(number=8, now_ns=now_ns))
        self.node.exchange(step)
        self.node.record(step)

    def report(self) -> dict[str, Any]:
        return self.node.report()


@pytest.fixture
def beside() -> Iterator[Beside]:
    made = Beside()
    yield made
    made.bridge.close()
    made.node.close()


def channel(node: LiveRosNode, topic: str) -> Any:
    return node.open_channel(topic, "cdr", "", "ros2msg", b"")


def test_what_is_recorded_goes_down_at_each_exchange(beside: Beside) -> None:
    write = channel(beside.node, "/truth/odometry")
    write(b"one", 5)
    write(b"two", 7)
    beside.exchange(20)
    beside.exchange(40)
    assert beside.bridge.receive(5.0) == [
        RosChannel(0, "/truth/odometry"),
        RosBatch(20, ((0, 5, b"one"), (0, 7, b"two"))),
    ]
    assert channel(beside.node, "/sizes") is None


def test_what_a_bridge_does_not_take_is_dropped_oldest_first_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_ros, "MOST_IN_PIPE_BYTES", 0)
    slow = Beside(queue_mb=0.05)
    cloud, small = channel(slow.node, "/truth/odometry"), channel(slow.node, "/environment")
    cloud(bytes(4_000_000), 0)
    slow.exchange()  # more than a socket takes at once
    for number in range(8):
        small(b"word", number)
        cloud(bytes(10_000), number)
        slow.exchange(number)
    assert slow.report()["ros"]["dropped"] == {"/truth/odometry": 4, "/environment": 4}
    batches: list[RosBatch] = []
    while len(batches) < 2:
        batches += [one for one in slow.bridge.receive(5.0) if isinstance(one, RosBatch)]
        slow.node._pipe.flush()  # type: ignore[union-attr]
        if not slow.node._pipe.waiting_bytes and len(batches) < 2:  # type: ignore[union-attr]
            slow.exchange(9)
    assert [stamp for number, stamp, _ in batches[1].messages if number == 0] == [4, 5, 6, 7]
    slow.bridge.close()
    slow.node.close()


def test_a_bridge_that_is_gone_is_said_once_and_the_run_goes_on(beside: Beside) -> None:
    write = channel(beside.node, "/environment")
    beside.bridge.close()
    for number in range(3):
        write(b"word", number)
        beside.exchange(number)
    assert beside.told == ["warning: ros: the bridge has ended; the run goes on without it"]
    assert beside.report()["warnings"] == ["ros: the bridge has ended; the run goes on without it"]


def test_a_bridge_that_takes_nothing_is_said_once(beside: Beside, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now_s=0.0)
    monkeypatch.setattr(live_ros, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    channel(beside.node, "/truth/odometry")(bytes(4_000_000), 0)
    for clock.now_s in (0.0, 1.0, 7.0, 8.0):
        beside.exchange()
    monkeypatch.undo()
    assert len(beside.told) == 1
    assert "takes nothing since 5 s" in beside.told[0]


def test_an_action_is_asked_for_and_its_refusal_goes_back(beside: Beside) -> None:
    asked: list[tuple[object, str]] = []

    def ask(action: object, source: str) -> str | None:
        asked.append((action, source))
        return "arm: is refused" if action == {"action": "arm"} else None

    beside.node._operator = cast(Any, SimpleNamespace(ask=ask))
    beside.bridge.send({"action": {"action": "arm"}, "request": 4})
    beside.bridge.send({"action": {"action": "pause"}, "request": 5})
    beside.bridge.send({"action": {"action": "resume"}})
    while len(asked) < 3:
        beside.node.poll()
    assert asked == [({"action": name}, "ros") for name in ("arm", "pause", "resume")]
    assert beside.bridge.receive(5.0) == [RosAnswer(4, "arm: is refused"), RosAnswer(5, None)]
    assert (beside.report()["ros"]["actions"], beside.report()["ros"]["refused"]) == (3, 0)  # the bridge counts it


def test_the_counts_of_the_bridge_are_the_summary_s(beside: Beside) -> None:
    beside.bridge.send({"counts": {"published": {"/clock": 3}, "received": {"/cmd_vel": 2}, "refused": {}}})
    beside.bridge.close_sending()
    beside.node.end()
    ros = beside.report()["ros"]
    assert (ros["published"], ros["received"]) == ({"/clock": 3}, {"/cmd_vel": 2})


def test_the_end_of_a_run_is_told(beside: Beside) -> None:
    beside.bridge.close_sending()
    beside.node.end()
    assert beside.bridge.receive(5.0) == [RosEnd()]


def test_a_process_s_last_word_is_why_it_ended(tmp_path: Any) -> None:
    beside = Beside()
    node = beside.node
    node._words = (tmp_path / "words").open("w+b")
    node._words.write(b"Traceback\nOSError: no domain\n")
    assert node._last_word() == "OSError: no domain"
    beside.bridge.close()
    node.close()
