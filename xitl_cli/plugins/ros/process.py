"""The process between a run and ROS: publishes what the run sends down a pipe, and gives what nodes ask back.

`python -m xitl_cli.plugins.ros.process PIPE`: the number of a socket that it inherits. What comes down is converted and
published in a thread of its own, so that a command is handled as soon as it has come.
"""

from __future__ import annotations

import itertools
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from xitl_cli.errors import UserError
from xitl_cli.pipe import Pipe, PipeClosedError, until_closed
from xitl_cli.plugins.ros.conversion import RosConversion, RosMessage
from xitl_cli.plugins.ros.inputs import RosInputs
from xitl_cli.plugins.ros.middleware import QOS, Middleware, qos_with
from xitl_cli.plugins.ros.middleware_choice import open_middleware
from xitl_cli.plugins.ros.outputs import RosTopic
from xitl_cli.plugins.ros.pipe_messages import RosAnswer, RosBatch, RosChannel, RosClockAgain, RosEnd, RosStart
from xitl_cli.profile.schema.ros import RosTopicSpec

SPIN_S = 0.05
DISCOVERY_S = 0.5
COUNTS_S = 0.5
ANSWER_S = 5.0


class Publisher:
    """Of one topic: `send` takes CDR. rate_hz: at most, in simulation time; None: every message."""

    def __init__(self, name: str, send: Callable[[bytes], object], rate_hz: float | None) -> None:
        self.name, self.send = name, send
        self._rate_hz = rate_hz
        self._next_ns = -1

    def due(self, stamp_ns: int) -> bool:
        """Whether a message of this instant is to be sent."""
        if self._rate_hz is None:
            return True
        if not self._rate_hz or stamp_ns < self._next_ns:
            return False
        period_ns = round(1e9 / self._rate_hz)
        self._next_ns = (stamp_ns // period_ns + 1) * period_ns
        return True


def _discard(cdr: bytes) -> None:
    """Of a topic that the profile does not want."""


class RosBridge:
    """Between the pipe and one middleware."""

    def __init__(self, pipe: Pipe, start: RosStart, middleware: Middleware) -> None:
        self._pipe = pipe
        self._middleware = middleware
        self._spec = start.profiles[0].ros
        self._channels: dict[int, str] = {}
        self._published: Counter[str] = Counter()
        self._requests = itertools.count(1)
        self._answers: dict[int, tuple[threading.Event, list[str | None]]] = {}
        self._over = threading.Event()
        self._told_s = 0.0
        self._conversion = RosConversion(start.profiles)
        self._publishers: dict[tuple[RosTopic, str], Publisher] = {}
        for topic, vessel in self._conversion.topics():
            self._publisher(topic, vessel)
        self._clock: tuple[Publisher, bytes] | None = None
        for message in self._conversion.static():
            self._publish(message)
        self._inputs: RosInputs | None = None
        if start.operated:
            tell = partial(self._send_up, "problem")
            self._inputs = RosInputs(
                start.profiles,
                middleware,
                self.ask,
                self.hope,
                self._on_ready,
                tell,
                odom_in_map=self._conversion.odom_in_map,
            )

    def meet_others(self) -> None:
        """Give nodes that are there already the time to find it, so that they have all from the first message on."""
        until_s = time.monotonic() + DISCOVERY_S
        while time.monotonic() < until_s:
            self._middleware.spin(SPIN_S)
        self._tell()

    def run(self, messages: Iterable[Any]) -> None:
        """Until the run is over or gone. messages: that have come already."""
        reader = threading.Thread(target=self._read, args=(list(messages),), name="pipe", daemon=True)
        reader.start()
        try:
            while not self._over.is_set():
                self._middleware.spin(SPIN_S)
                if self._inputs is not None:
                    self._inputs.flush()
                self._tell()
            reader.join(ANSWER_S)
            self._tell(last=True)
            while self._pipe.waiting_bytes:
                self._pipe.receive(SPIN_S)
        except PipeClosedError:
            pass
        finally:
            self._middleware.close()

    def ask(self, action: Mapping[str, Any]) -> str | None:
        """Have the run carry out an action; the refusal, None for none. From a handler of the middleware."""
        number, answered = next(self._requests), threading.Event()
        refusal: list[str | None] = []
        self._answers[number] = answered, refusal
        self._pipe.send({"action": dict(action), "request": number})
        if not answered.wait(ANSWER_S):
            self._answers.pop(number, None)
            return f"the run did not look within {ANSWER_S:g} s"
        return refusal[0]

    def hope(self, action: Mapping[str, Any]) -> None:
        """The same without waiting: the run counts a refusal and says it."""
        self._pipe.send({"action": dict(action)})

    def _on_ready(self, node: str, stamp_ns: int) -> None:
        self._send_up("ready", {"node": node, "stamp_ns": stamp_ns})

    def _send_up(self, key: str, value: Any) -> None:
        self._pipe.send({key: value})

    # In the thread of the pipe

    def _read(self, messages: list[Any]) -> None:
        try:
            while not self._over.is_set():
                for message in messages:
                    self._take_in(message)
                messages = self._pipe.receive(SPIN_S)
        except PipeClosedError:
            self._over.set()

    def _take_in(self, message: Any) -> None:
        if isinstance(message, RosBatch):
            self._publish_batch(message)
        elif isinstance(message, RosChannel):
            self._channels[message.number] = message.topic
        elif isinstance(message, RosAnswer):
            self._on_answer(message)
        elif isinstance(message, RosClockAgain):
            if self._clock is not None:
                publisher, cdr = self._clock
                publisher.send(cdr)
        elif isinstance(message, RosEnd):
            self._over.set()

    def _on_answer(self, answer: RosAnswer) -> None:
        if answer.request is None:
            if self._inputs is not None and answer.refusal is not None:
                self._inputs.refused_by_run(answer.refusal)
            return
        answered, refusal = self._answers.pop(answer.request, (None, []))
        refusal.append(answer.refusal)
        if answered is not None:
            answered.set()

    def _publish_batch(self, batch: RosBatch) -> None:
        for number, stamp_ns, payload in batch.messages:
            if self._inputs is not None:
                self._inputs.recorded(self._channels[number], payload)
            for message in self._conversion.convert(self._channels[number], payload, stamp_ns):
                self._publish(message)

    def _publish(self, message: RosMessage) -> None:
        publisher = self._publisher(message.topic, message.vessel)
        if publisher.due(message.stamp_ns):
            publisher.send(message.cdr)
            if message.topic.qos == "clock":
                self._clock = publisher, message.cdr
            self._published[publisher.name] += 1

    def _publisher(self, topic: RosTopic, vessel: str) -> Publisher:
        found = self._publishers.get((topic, vessel))
        if found is None:
            asked = self._spec.topics.get(topic.name, RosTopicSpec())
            name = topic.full_name(vessel, self._spec.namespace)
            send: Callable[[bytes], object] = _discard
            if asked.publish:
                qos = qos_with(replace(QOS[topic.qos], depth=QOS[topic.qos].depth or self._spec.depth), asked)
                send = self._middleware.advertise(name, topic.type, qos)
            found = self._publishers[topic, vessel] = Publisher(name, send, asked.rate_hz if asked.publish else 0.0)
        return found

    def _tell(self, last: bool = False) -> None:
        for problem in self._middleware.problems():
            self._pipe.send({"problem": problem})
        now_s = time.monotonic()
        if last or now_s - self._told_s >= COUNTS_S:
            self._told_s = now_s
            losses = self._middleware.losses()
            counts = {"published": self._published, "not_read": losses.dropped, "refused_peers": losses.refused}
            if (inputs := self._inputs) is not None:
                counts |= {"received": inputs.received, "refused": inputs.refused, "superseded": inputs.superseded}
            self._pipe.send({"counts": {name: dict(count) for name, count in counts.items()}})


def main(arguments: list[str]) -> None:
    """See the module."""
    pipe = Pipe.of_process(socket.socket(fileno=int(arguments[0])))
    with until_closed():
        start, *rest = pipe.receive_first()
        try:
            middleware = open_middleware(start.profiles[0].ros)
            bridge = RosBridge(pipe, start, middleware)
        except UserError as error:
            pipe.send({"failed": str(error)})
            return
        bridge.meet_others()
        pipe.send({"opened": middleware.name})
        bridge.run(rest)


if __name__ == "__main__":
    main(sys.argv[1:])
