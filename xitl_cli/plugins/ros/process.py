"""The process between a run and ROS: publishes data from the run's pipe, and returns requests of nodes.

`python -m xitl_cli.plugins.ros.process PIPE`: PIPE is the number of an inherited socket. A separate thread converts and
publishes the received data, so that a command is handled immediately.
"""

from __future__ import annotations

import itertools
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from contextlib import closing
from dataclasses import replace
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
    """Publisher of one topic. send: publishes CDR. rate_hz: limit in simulation time; None for every message."""

    def __init__(self, name: str, send: Callable[[bytes], object], rate_hz: float | None) -> None:
        self.name, self.send = name, send
        self._rate_hz = rate_hz
        self._next_ns = -1

    def due(self, stamp_ns: int) -> bool:
        """Return True if a message of this instant is to be sent."""
        if self._rate_hz is None:
            return True
        if not self._rate_hz or stamp_ns < self._next_ns:
            return False
        period_ns = round(1e9 / self._rate_hz)
        self._next_ns = (stamp_ns // period_ns + 1) * period_ns
        return True


class RosBridge:
    """Bridge between the pipe and one middleware."""

    def __init__(self, pipe: Pipe, start: RosStart, middleware: Middleware) -> None:
        self._pipe = pipe
        self._middleware = middleware
        self._spec = start.profiles[0].ros
        self._channels: dict[int, str] = {}
        self._published: Counter[str] = Counter()
        self._requests = itertools.count(1)
        self._answers: dict[int, Future[str | None]] = {}
        self._over = threading.Event()
        self._reported_s = 0.0
        self._conversion = RosConversion(start.profiles)
        self._publishers: dict[tuple[RosTopic, str], Publisher] = {}
        for topic, vessel in self._conversion.topics():
            self._publisher(topic, vessel)
        self._clock: tuple[Publisher, bytes] | None = None
        for message in self._conversion.static():
            self._publish(message)
        self._inputs: RosInputs | None = None
        if start.operated:
            self._inputs = RosInputs(
                start.profiles,
                middleware,
                self.ask,
                self.post,
                lambda node, stamp_ns: pipe.send({"ready": {"node": node, "stamp_ns": stamp_ns}}),
                lambda problem: pipe.send({"problem": problem}),
                odom_in_map=self._conversion.odom_in_map,
            )

    def await_discovery(self) -> None:
        """Wait until existing nodes can discover the bridge, so that they receive all messages from the first on."""
        until_s = time.monotonic() + DISCOVERY_S
        while time.monotonic() < until_s:
            self._middleware.spin(SPIN_S)
        self._report()

    def run(self, messages: Iterable[Any]) -> None:
        """Run until the run ends or disconnects. messages: already received ones."""
        reader = threading.Thread(target=self._read, args=(list(messages),), name="pipe", daemon=True)
        reader.start()
        try:
            while not self._over.is_set():
                self._middleware.spin(SPIN_S)
                if self._inputs is not None:
                    self._inputs.flush()
                self._report()
            reader.join(ANSWER_S)
            self._report(last=True)
            while self._pipe.waiting_bytes:
                self._pipe.receive(SPIN_S)
        except PipeClosedError:
            pass
        finally:
            self._middleware.close()

    def ask(self, action: Mapping[str, Any]) -> str | None:
        """Request an action of the run. Return the refusal, None for none. Called from the middleware's handlers."""
        number, answer = next(self._requests), Future[str | None]()
        self._answers[number] = answer
        self._pipe.send({"action": dict(action), "request": number})
        try:
            return answer.result(ANSWER_S)
        except TimeoutError:
            self._answers.pop(number, None)
            return f"the run did not answer within {ANSWER_S:g} s"

    def post(self, action: Mapping[str, Any]) -> None:
        """Request an action without waiting. The run counts and reports a refusal."""
        self._pipe.send({"action": dict(action)})

    # In the thread of the pipe

    def _read(self, messages: list[Any]) -> None:
        try:
            while not self._over.is_set():
                for message in messages:
                    self._handle(message)
                messages = self._pipe.receive(SPIN_S)
        except PipeClosedError:
            self._over.set()

    def _handle(self, message: Any) -> None:
        if isinstance(message, RosBatch):
            for number, stamp_ns, payload in message.messages:
                if self._inputs is not None:
                    self._inputs.recorded(self._channels[number], payload)
                for converted in self._conversion.convert(self._channels[number], payload, stamp_ns):
                    self._publish(converted)
        elif isinstance(message, RosChannel):
            self._channels[message.number] = message.topic
        elif isinstance(message, RosAnswer):
            if message.request is not None:
                answer = self._answers.pop(message.request, None)
                if answer is not None:
                    answer.set_result(message.refusal)
            elif self._inputs is not None and message.refusal is not None:
                self._inputs.refused_by_run(message.refusal)
        elif isinstance(message, RosClockAgain):
            if self._clock is not None:
                publisher, cdr = self._clock
                publisher.send(cdr)
        elif isinstance(message, RosEnd):
            self._over.set()

    def _publish(self, message: RosMessage) -> None:
        publisher = self._publisher(message.topic, message.vessel)
        if publisher.due(message.stamp_ns):
            publisher.send(message.cdr)
            if message.topic.qos == "clock":
                self._clock = publisher, message.cdr
            self._published[publisher.name] += 1

    def _publisher(self, topic: RosTopic, vessel: str) -> Publisher:
        publisher = self._publishers.get((topic, vessel))
        if publisher is None:
            asked = self._spec.topics.get(topic.name, RosTopicSpec())
            name = topic.full_name(vessel, self._spec.namespace)
            if asked.publish:
                qos = qos_with(replace(QOS[topic.qos], depth=QOS[topic.qos].depth or self._spec.depth), asked)
                publisher = Publisher(name, self._middleware.advertise(name, topic.type, qos), asked.rate_hz)
            else:
                publisher = Publisher(name, lambda cdr: None, 0.0)
            self._publishers[topic, vessel] = publisher
        return publisher

    def _report(self, last: bool = False) -> None:
        for problem in self._middleware.problems():
            self._pipe.send({"problem": problem})
        now_s = time.monotonic()
        if last or now_s - self._reported_s >= COUNTS_S:
            self._reported_s = now_s
            losses = self._middleware.losses()
            counts = {"published": self._published, "not_read": losses.dropped, "refused_peers": losses.refused}
            if (inputs := self._inputs) is not None:
                counts |= {"received": inputs.received, "refused": inputs.refused, "superseded": inputs.superseded}
            self._pipe.send({"counts": {name: dict(count) for name, count in counts.items()}})


def main(arguments: list[str]) -> None:
    """Run the process; see the module."""
    with closing(Pipe.of_process(socket.socket(fileno=int(arguments[0])))) as pipe, until_closed():
        start, *rest = pipe.receive_first()
        try:
            middleware = open_middleware(start.profiles[0].ros)
            bridge = RosBridge(pipe, start, middleware)
        except UserError as error:
            pipe.send({"failed": str(error)})
            return
        bridge.await_discovery()
        pipe.send({"opened": middleware.name})
        bridge.run(rest)


if __name__ == "__main__":
    main(sys.argv[1:])
