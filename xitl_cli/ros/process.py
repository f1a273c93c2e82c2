"""The process between a run and ROS: publishes what the run sends down a pipe, and gives what nodes ask back.

`python -m xitl_cli.ros.process PIPE`: the number of a socket that it inherits. What comes down is converted and
published in a thread of its own, so that a command is handled as soon as it has come.
"""

from __future__ import annotations

import itertools
import signal
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from xitl_cli.errors import UserError
from xitl_cli.pipe import Pipe, PipeClosedError
from xitl_cli.ros.middleware import CLOCK, Middleware, open_middleware
from xitl_cli.ros.pipe_messages import RosAnswer, RosBatch, RosChannel, RosEnd, RosStart

SPIN_S = 0.05
COUNTS_S = 0.5
ANSWER_S = 5.0


class RosBridge:
    """Between the pipe and one middleware."""

    def __init__(self, pipe: Pipe, start: RosStart, middleware: Middleware) -> None:
        self._pipe = pipe
        self._middleware = middleware
        self._spec = start.profiles[0].ros
        self._channels: dict[int, str] = {}
        self._published: Counter[str] = Counter()
        self._received: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._requests = itertools.count(1)
        self._answers: dict[int, tuple[threading.Event, list[str | None]]] = {}
        self._over = threading.Event()
        self._told_s = 0.0
        self._clock = middleware.advertise("/clock", "rosgraph_msgs/msg/Clock", CLOCK)

    def run(self, messages: Iterable[Any]) -> None:
        """Until the run is over or gone. messages: that have come already."""
        reader = threading.Thread(target=self._read, args=(list(messages),), name="pipe", daemon=True)
        reader.start()
        try:
            while not self._over.is_set():
                self._middleware.spin(SPIN_S)
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
            answered, refusal = self._answers.pop(message.request, (None, []))
            refusal.append(message.refusal)
            if answered is not None:
                answered.set()
        elif isinstance(message, RosEnd):
            self._over.set()

    def _publish_batch(self, batch: RosBatch) -> None:
        seconds, nanoseconds = divmod(batch.now_ns, 1_000_000_000)
        self._clock(b"\0\1\0\0" + seconds.to_bytes(4, "little") + nanoseconds.to_bytes(4, "little"))
        self._published["/clock"] += 1

    def _tell(self, last: bool = False) -> None:
        for problem in self._middleware.problems():
            self._pipe.send({"problem": problem})
        now_s = time.monotonic()
        if last or now_s - self._told_s >= COUNTS_S:
            self._told_s = now_s
            counts = {"published": self._published, "received": self._received, "refused": self._refused}
            self._pipe.send({"counts": {name: dict(count) for name, count in counts.items()}})


def main(arguments: list[str], opened: Callable[..., Middleware] = open_middleware) -> None:
    """See the module."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the run's, which then ends this
    pipe = Pipe.of_process(socket.socket(fileno=int(arguments[0])))
    try:
        start, *rest = _first(pipe)
        try:
            middleware = opened(start.profiles[0].ros)
        except UserError as error:
            pipe.send({"failed": str(error)})
            return
        bridge = RosBridge(pipe, start, middleware)
        pipe.send({"opened": middleware.name})
        bridge.run(rest)
    except PipeClosedError:
        pass


def _first(pipe: Pipe) -> list[Any]:
    while True:
        if messages := pipe.receive(60.0):
            return messages


if __name__ == "__main__":
    main(sys.argv[1:])
