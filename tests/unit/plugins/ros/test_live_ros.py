"""ROS beside a run: what waits is bounded, what is lost is said, and what nodes ask is answered."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.doubles.side_process import SideProcessDouble
from xitl_cli.errors import UserError
from xitl_cli.pipe import Pipe
from xitl_cli.plugins.ros import live_ros
from xitl_cli.plugins.ros.live_ros import LiveRosNode
from xitl_cli.plugins.ros.pipe_messages import RosAnswer, RosBatch, RosChannel, RosEnd, RosStart
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.ros import RosSpec
from xitl_cli.run.core.node import RunStep


def open_bridge(pipe: Pipe) -> None:
    pipe.send({"opened": "double"})


class Beside:
    """A node, and the bridge's end of the pipe."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        at_start: Callable[[Pipe], object] = open_bridge,
        *,
        queue_mb: float = 16.0,
        words: str = "",
    ) -> None:
        monkeypatch.setattr(live_ros, "HAND_OVER_S", 0.0)
        self._double = SideProcessDouble(monkeypatch, at_start, words)
        spec = RosSpec(queue_mb=queue_mb, master="ros1://")  # needs no middleware here
        self.told: list[str] = []
        self.node = LiveRosNode([replace(load_profile("sitl").runnable(), ros=spec)], self.told.append)

    @property
    def bridge(self) -> Pipe:
        return self._double.pipe

    def exchange(self, now_ns: int = 0) -> None:
        step = cast(RunStep, SimpleNamespace(number=8, now_ns=now_ns))
        self.node.exchange(step)
        self.node.record(step)

    def report(self) -> dict[str, Any]:
        return self.node.report()

    def close(self) -> None:
        self._double.close()
        self.node.close()


@pytest.fixture
def beside(monkeypatch: pytest.MonkeyPatch) -> Iterator[Beside]:
    made = Beside(monkeypatch)
    made.node.prepare()
    assert [type(one) for one in made.bridge.receive(5.0)] == [RosStart]
    assert made.told.pop() == "ros: double"
    yield made
    made.close()


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
        RosBatch(((0, 5, b"one"), (0, 7, b"two"))),
    ]
    assert channel(beside.node, "/sizes") is None


def test_what_a_bridge_does_not_take_is_dropped_oldest_first_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_ros, "MOST_IN_PIPE_BYTES", 0)
    slow = Beside(monkeypatch, queue_mb=0.05)
    slow.node.prepare()
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
        slow.exchange(9)
        batches += [one for one in slow.bridge.receive(5.0) if isinstance(one, RosBatch)]
    assert [stamp for number, stamp, _ in batches[1].messages if number == 0] == [4, 5, 6, 7]
    slow.close()


def test_a_bridge_that_is_gone_is_said_once_and_the_run_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    beside = Beside(monkeypatch, words="Traceback\nOSError: no domain\n")
    beside.node.prepare()
    write = channel(beside.node, "/environment")
    beside.bridge.close()
    for number in range(3):
        write(b"word", number)
        beside.exchange(number)
    said = "ros: the bridge has ended; the run continues without it (OSError: no domain)"
    assert beside.told[1:] == [f"warning: {said}"]
    assert beside.report()["warnings"] == [said]
    assert beside.report()["ros"]["dropped"] == {"/environment": 2}
    beside.close()


@pytest.mark.parametrize(
    ("at_start", "error"),
    [
        (lambda pipe: pipe.send({"failed": "no such network"}), "no such network"),
        (Pipe.close, "ros: the bridge ended at its start (OSError: no domain)"),
    ],
)
def test_a_bridge_that_cannot_be_is_an_error(
    monkeypatch: pytest.MonkeyPatch, at_start: Callable[[Pipe], object], error: str
) -> None:
    beside = Beside(monkeypatch, at_start, words="OSError: no domain\n")
    with pytest.raises(UserError) as raised:
        beside.node.prepare()
    assert str(raised.value) == error
    beside.close()


def test_a_bridge_that_takes_nothing_is_said_once(beside: Beside, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now_s=0.0)
    monkeypatch.setattr(live_ros, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    channel(beside.node, "/truth/odometry")(bytes(4_000_000), 0)
    for clock.now_s in (0.0, 1.0, 7.0, 8.0):
        beside.exchange()
    monkeypatch.undo()
    assert len(beside.told) == 1
    assert "accepted no data for 5 s" in beside.told[0]


def test_an_action_is_asked_for_and_its_refusal_goes_back(beside: Beside) -> None:
    asked: list[tuple[object, str]] = []

    def ask(action: object, source: str) -> str | None:
        asked.append((action, source))
        return "arm: is refused" if action == {"action": "arm"} else None

    beside.node.attach_operator(cast(Any, SimpleNamespace(ask=ask, listen=lambda poll: None, paused=False)))
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


def test_what_is_still_queued_when_a_bridge_does_not_end_is_dropped(
    beside: Beside, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_ros, "MOST_IN_PIPE_BYTES", 0)
    write = channel(beside.node, "/truth/odometry")
    write(bytes(4_000_000), 0)
    beside.exchange()
    write(b"word", 1)
    beside.bridge.close()
    beside.node.end()
    assert beside.report()["ros"]["dropped"] == {"/truth/odometry": 1}


def test_the_end_of_a_run_is_told(beside: Beside) -> None:
    beside.bridge.close_sending()
    beside.node.end()
    assert beside.bridge.receive(5.0) == [RosEnd()]
