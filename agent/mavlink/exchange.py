"""Common interface of all MAVLink clients: an exchange that is polled for requests and handles received messages."""

from __future__ import annotations

import time
from typing import Any, Callable, Protocol

Messages = list[Any]
Target = tuple[int, int]  # system and component
HEADING_DEVIATION = "yaw_std"
"""Name of a NAMED_VALUE_FLOAT: standard deviation of the heading in rad, which no message of ArduPilot has."""


class Exchange(Protocol):
    """Repeats its requests until it is `done`. Times are in nanoseconds on one clock, which the caller chooses."""

    @property
    def done(self) -> bool:
        """Whether it has ended, successfully or not."""

    def poll(self, now_ns: int) -> Messages:
        """Return the requests that are due, including repetitions."""

    def handle(self, message: Any, now_ns: int) -> Messages:
        """Handle a message of the other end and return the replies. Unrelated messages are ignored."""


class Timer:
    """Time since `start`, on the caller's clock. A caller with several clocks has another class with this interface."""

    def __init__(self) -> None:
        self._start_ns: int | None = None

    @property
    def started(self) -> bool:
        """Whether the timer is running."""
        return self._start_ns is not None

    def start(self, now_ns: int) -> None:
        """Start the timer."""
        self._start_ns = now_ns

    def stop(self) -> None:
        """Stop the timer."""
        self._start_ns = None

    def is_over(self, now_ns: int, seconds: float) -> bool:
        """Whether `seconds` have passed since the start. False when the timer is stopped."""
        return self._start_ns is not None and now_ns - self._start_ns >= seconds * 1e9


class Request:
    """One request, sent every `answer_s` until `is_answer` is true for a message, at most `tries` times.

    make: builds the message of an attempt, counted from 0.
    answer: the answering message; None with `done` after a timeout.
    """

    def __init__(
        self,
        make: Callable[[int], Any],
        is_answer: Callable[[Any], bool],
        tries: int = 4,
        answer_s: float = 1.0,
        timer: Timer | None = None,
    ) -> None:
        self.answer: Any = None
        self.done = False
        self._make = make
        self._is_answer = is_answer
        self._tries = tries
        self._answer_s = answer_s
        self._timer = Timer() if timer is None else timer
        self._attempts = 0

    def poll(self, now_ns: int) -> Messages:
        if self.done or (self._attempts and not self._timer.is_over(now_ns, self._answer_s)):
            return []
        if self._attempts == self._tries:
            self.done = True
            return []
        self._timer.start(now_ns)
        self._attempts += 1
        return [self._make(self._attempts - 1)]

    def handle(self, message: Any, now_ns: int) -> Messages:
        if self._attempts and not self.done and self._is_answer(message):
            self.answer, self.done = message, True
        return []


def complete(exchange: Exchange, send: Callable[[Any], object], receive: Callable[[float], Messages]) -> None:
    """Run an exchange to its end on the monotonic clock. `receive(timeout_s)` waits for messages at most that long."""
    while not exchange.done:
        for request in exchange.poll(time.monotonic_ns()):
            send(request)
        for message in () if exchange.done else receive(0.05):
            for reply in exchange.handle(message, time.monotonic_ns()):
                send(reply)


def text_of(raw: bytes | str) -> str:
    """Text of a character field of a message, up to its first NUL."""
    return (raw if isinstance(raw, str) else raw.decode("utf-8", "replace")).partition("\0")[0]
