"""ROS output of a run: sends recorded payloads to the bridge process, and passes requests of nodes to the operator.

The run never waits for the process. Unsent data waits in a bounded queue, which drops the oldest entries.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, Protocol

from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from xitl_cli.errors import UserError
from xitl_cli.plugins.ros.middleware_choice import ros2_way
from xitl_cli.plugins.ros.outputs import check_topics
from xitl_cli.plugins.ros.pipe_messages import RosAnswer, RosBatch, RosChannel, RosClockAgain, RosEnd, RosStart
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.profile.schema.ros import RosLockstepSpec
from xitl_cli.run.core.live_output import LiveOutput, LiveRun
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.core.pace import LISTEN_S, OperatedLockstep
from xitl_cli.run.core.side_process import SideProcess
from xitl_cli.run.nodes.operator import OperatorNode

SOURCE = "ros"
OPENING_S = 60.0
HAND_OVER_HZ = 100.0
"""Rate of transfers to the process, in simulation time."""
HAND_OVER_S = 0.008
"""Interval by wall clock time: a run faster than real time would otherwise make many small batches."""
SILENT_S = 5.0
"""Time without progress of the process before a warning."""
END_S = 5.0
MOST_REFUSALS = 50  # reported refusals, each once
MOST_IN_PIPE_BYTES = 1 << 20
"""Limit of queued data in the pipe: data in the pipe can no longer be dropped."""
POLL_S = 0.002
CLOCK_AGAIN_S = 0.2
SETTLED_S = 1.0
"""Wait after the first message of a node, so that its other endpoints and the bridge discover each other."""


class LiveRosNode(RunNode):
    """The bridge of a run to ROS. If it dies or hangs, the run continues unchanged.

    profiles: one per vessel. tell: shows a text to the user. It is a mirror of the recording, see McapFile. If the run
    waits for nodes, it handles their requests only during standstills (`poll`), so that it does not depend on the wall
    clock.
    """

    def __init__(self, profiles: Sequence[RunProfile], tell: Callable[[str], object]) -> None:
        self._profiles = tuple(profiles)
        self._spec = profiles[0].ros
        self._tell = tell
        self._operator: OperatorNode | None = None
        self._bridge = SideProcess("xitl_cli.plugins.ros.process", self._on_loss, END_S)
        self._recorder: Any = None
        self._queue: deque[tuple[int, int, bytes]] = deque()
        self._queued_bytes = 0
        self._limit_bytes = round(self._spec.queue_mb * 1e6)
        self._topics: list[str] = []
        self._dropped: Counter[int] = Counter()
        self._now_ns = 0
        self.record_every = max(round(profiles[0].clock.physics_rate_hz / HAND_OVER_HZ), 1)
        self._progress = (0, 0.0)
        self._next_s = 0.0
        self._silent = False
        self._name = ""
        self._counts: dict[str, dict[str, int]] = {}
        self._problems: list[str] = []
        self._actions = self._refused = 0
        self._refusals: set[str] = set()
        self._holds = self._spec.lockstep is not None
        self.answers_ns: dict[str, int] = {}
        """The latest /clock that each node has answered, by its name."""

    def attach_operator(self, operator: OperatorNode) -> None:
        """Let the operator carry out requests of nodes, and poll this node during standstills too."""
        self._operator = operator
        operator.listen(self._listen)

    def _listen(self) -> None:
        if not self._holds or (self._operator is not None and self._operator.paused):
            self.poll()

    def prepare(self) -> None:
        """Start the process, and wait until it is in the graph. Raises UserError if this fails."""
        check_topics(self._spec)
        if self._spec.master is None:
            ros2_way(self._spec)
        self._bridge.start()
        self._bridge.send(RosStart(self._profiles, self._operator is not None))
        until_s = time.monotonic() + OPENING_S
        while not self._name:
            if time.monotonic() >= until_s:
                raise UserError(f"ros: the bridge was not ready within {OPENING_S:g} s; try again")
            for message in self._bridge.receive(0.1):
                if "failed" in message:
                    raise UserError(str(message["failed"]))
                if "opened" in message:
                    self._name = str(message["opened"])
                else:
                    self._handle(message)
        self._tell(f"ros: {self._name}")

    def mirror(self) -> LiveRosNode:
        return self

    def open_channel(
        self, topic: str, encoding: str, schema_name: str, schema_encoding: str, definition: bytes
    ) -> Callable[[bytes, int], object] | None:
        """Open a channel as in the recording; the result queues a payload of an instant."""
        if not self._wanted(topic):
            return None
        number = len(self._topics)
        self._topics.append(topic)
        self._bridge.send(RosChannel(number, topic))
        append = self._queue.append

        def queue(payload: bytes, stamp_ns: int) -> None:
            append((number, stamp_ns, payload))
            self._queued_bytes += len(payload)

        return queue

    @cached_property
    def _wanted(self) -> Callable[[str], bool]:
        from xitl_cli.plugins.ros.conversion import RosConversion

        return RosConversion(self._profiles).wants

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder

    def exchange(self, step: RunStep) -> None:
        self._now_ns = step.now_ns
        if self._operator is None:
            self.poll()

    def record(self, step: RunStep) -> None:
        if self._queue and (self._holds or time.monotonic() >= self._next_s):
            self._hand_over()

    def _hand_over(self) -> None:
        """Send the queue to the process, unless too much data is pending; then drop the excess."""
        self._next_s = time.monotonic() + HAND_OVER_S
        if not self._bridge.gone and self._bridge.waiting_bytes <= MOST_IN_PIPE_BYTES:
            batch = RosBatch(tuple(self._queue))
            self._queue.clear()
            self._queued_bytes = 0
            self._bridge.send(batch)
        self._drop(0 if self._bridge.gone else self._limit_bytes)

    def _drop(self, limit_bytes: int) -> None:
        """Drop the oldest entries, until the queue has `limit_bytes` at most."""
        while self._queued_bytes > limit_bytes:
            number, _, payload = self._queue.popleft()
            self._queued_bytes -= len(payload)
            self._dropped[number] += 1

    @property
    def lost(self) -> bool:
        """True if the process can no longer send requests or answers."""
        return self._bridge.gone

    def send_clock_again(self) -> None:
        """Send /clock again for a node that has missed it."""
        self._bridge.send(RosClockAgain())

    def poll(self, timeout_s: float = 0.0) -> None:
        """Handle requests of nodes, after at most `timeout_s`."""
        if self._queue and time.monotonic() >= self._next_s:
            self._hand_over()
        for message in self._bridge.receive(timeout_s):
            self._handle(message)
        # Check that the process still accepts data
        now_s, taken_bytes = time.monotonic(), self._bridge.taken_bytes
        if not self._bridge.waiting_bytes or taken_bytes != self._progress[0]:
            self._progress, self._silent = (taken_bytes, now_s), False
        elif now_s - self._progress[1] > SILENT_S and not self._silent:
            self._silent = True
            self._warn(
                f"ros: the bridge has accepted no data for {SILENT_S:g} s; the run continues and drops the oldest data"
            )

    def _handle(self, message: Mapping[str, Any]) -> None:
        if isinstance(action := message.get("action"), dict):
            self._actions += 1
            request = message.get("request")
            refusal: str | None = "this run accepts no actions"
            if self._operator is not None:
                refusal = self._operator.ask(action, SOURCE)
                self._refused += refusal is not None and request is None
            if request is not None:
                self._bridge.send(RosAnswer(int(request), refusal))
            elif refusal and refusal not in self._refusals and len(self._refusals) < MOST_REFUSALS:
                self._refusals.add(refusal)
                self._warn(f"ros: {refusal}")
                self._bridge.send(RosAnswer(None, refusal))
        elif isinstance(ready := message.get("ready"), dict):
            self.answers_ns[str(ready["node"])] = int(ready["stamp_ns"])
        elif isinstance(counts := message.get("counts"), dict):
            self._counts = counts
        elif "problem" in message:
            self._warn(str(message["problem"]))

    def _warn(self, text: str) -> None:
        self._problems.append(text)
        self._tell(f"warning: {text}")
        if self._recorder is not None:
            self._recorder.log(self._now_ns, WARNING, SOURCE, text)

    def _on_loss(self, why: str) -> None:
        if not self._name:
            raise UserError(f"ros: the bridge ended at its start{why}")
        self._warn(f"ros: the bridge has ended; the run continues without it{why}")

    def end(self) -> None:
        """Let the process publish the remaining data and report its counts."""
        if self._queue:
            self._hand_over()
        self._bridge.send(RosEnd())
        for message in self._bridge.receive_last():
            self._handle(message)
        self._drop(0)

    def close(self) -> None:
        self._bridge.close()

    def report(self) -> dict[str, Any]:
        """Return ros: middleware, messages by topic, requested actions, and failures here or in the bridge."""
        not_taken = self._counts.get("refused", {})
        return {
            "ros": {
                "way": self._name,
                "namespace": self._spec.namespace,
                "published": self._counts.get("published", {}),
                "dropped": {self._topics[number]: count for number, count in sorted(self._dropped.items())},
                "not_read": self._counts.get("not_read", {}),
                "refused_peers": self._counts.get("refused_peers", {}),
                "received": self._counts.get("received", {}),
                "superseded": self._counts.get("superseded", {}),
                "not_taken": not_taken,
                "actions": self._actions,
                "refused": self._refused + sum(not_taken.values()),
            },
            "warnings": list(self._problems),
        }


class RosOutput(LiveOutput):
    """ROS as a live output of a run; in lockstep it waits for the nodes in the profile."""

    def __init__(self, profiles: Sequence[RunProfile]) -> None:
        self._profiles = profiles

    def world_nodes(self, run: LiveRun) -> Sequence[RunNode]:
        lead = self._profiles[0]
        bridge = LiveRosNode(self._profiles, run.tell)
        if lead.ros.lockstep is None:
            return [bridge]
        return [bridge, RosLockstepNode(lead.ros.lockstep, lead.clock, bridge, run.tell, run.interrupted)]


class AnsweringNodes(Protocol):
    """Source of nodes' answers: see LiveRosNode."""

    answers_ns: dict[str, int]

    @property
    def lost(self) -> bool: ...
    def poll(self, timeout_s: float = 0.0) -> None: ...
    def send_clock_again(self) -> None: ...


class RosLockstepNode(RunNode):
    """Runs after the bridge, which has received everything recorded up to a standstill.

    Requests of nodes before their answer are carried out at the next exchange. tell: shows a text to the user.
    interrupted: returns True when the user asked to stop.
    """

    def __init__(
        self,
        keys: RosLockstepSpec,
        clock: ClockSpec,
        nodes: AnsweringNodes,
        tell: Callable[[str], object],
        interrupted: Callable[[], bool],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._keys = keys
        self.record_every = max(round(keys.step_s * clock.physics_rate_hz), 1)
        self._nodes = nodes
        self._tell = tell
        self._interrupted = interrupted
        self._now_s = now_s
        self._stood_s = 0.0
        self._standstills = 0
        self._unanswered: Counter[str] = Counter()
        self._given_up: dict[str, int] = {}
        self._warnings: list[str] = []
        self._recorder: Any = None
        self._pace: Any = None

    def begin(self, context: RunContext) -> None:
        self._recorder, self._pace = context.recorder, context.pace
        self._tell(f"ros: waits for {', '.join(self._keys.nodes)} to publish on ready")
        self._stand(0, self._keys.start_timeout_s)
        until_s = self._now_s() + SETTLED_S
        while self._now_s() < until_s and not self._interrupted() and not self._nodes.lost:
            self._nodes.poll(POLL_S)

    def record(self, step: RunStep) -> None:
        self._standstills += 1
        self._stand(step.now_ns, self._keys.timeout_s)

    def _stand(self, now_ns: int, timeout_s: float) -> None:
        """Wait until each node has answered, `timeout_s` at most. A missing node counts again after its next answer."""
        answers_ns = self._nodes.answers_ns
        self._given_up = {node: last for node, last in self._given_up.items() if answers_ns.get(node, -1) == last}
        self._unanswered.update(self._given_up.keys())
        began_s = now_s = listened_s = sent_s = self._now_s()
        while (missing := self._missing(now_ns)) and not self._interrupted() and not self._nodes.lost:
            if now_s - began_s >= timeout_s:
                self._give_up(now_ns, missing, timeout_s)
                break
            self._nodes.poll(POLL_S)
            now_s = self._now_s()
            if now_s - sent_s >= CLOCK_AGAIN_S:
                sent_s = now_s
                self._nodes.send_clock_again()
            if now_s - listened_s >= LISTEN_S and isinstance(self._pace, OperatedLockstep):
                listened_s = now_s
                self._pace.listen()
        self._stood_s += now_s - began_s

    def _missing(self, now_ns: int) -> list[str]:
        answers_ns = self._nodes.answers_ns
        waited_for = [node for node in self._keys.nodes if node not in self._given_up]
        return [node for node in waited_for if answers_ns.get(node, -1) < now_ns]

    def _give_up(self, now_ns: int, missing: list[str], timeout_s: float) -> None:
        answered = ", ".join(self._nodes.answers_ns) or "no node"
        text = (
            f"ros.lockstep: {', '.join(missing)} did not answer the /clock {now_ns * 1e-9:g} s on ready within "
            f"{timeout_s:g} s (heard so far: {answered})"
        )
        if self._keys.without_answer == "end":
            raise UserError(f"{text}; increase ros.lockstep.timeout_s, or set without_answer: go-on")
        first = not any(self._unanswered[node] for node in missing)
        self._unanswered.update(missing)
        self._given_up |= {node: self._nodes.answers_ns.get(node, -1) for node in missing}
        if first:
            self._warnings.append(
                f"{text}; the run continues, is not repeatable, and waits again after the next answer"
            )
            self._recorder.log(now_ns, WARNING, "ros", self._warnings[-1])
            self._tell(f"warning: {self._warnings[-1]}")

    def report(self) -> dict[str, Any]:
        """Return ros.lockstep: number of standstills, their wall clock time, missing answers."""
        lockstep = {
            "standstills": self._standstills,
            "stood_s": self._stood_s,
            "unanswered": dict(self._unanswered),
        }
        return {"ros": {"lockstep": lockstep}, "warnings": list(self._warnings)}
