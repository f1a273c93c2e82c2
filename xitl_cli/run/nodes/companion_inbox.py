"""What arrives from a companion, and when it counts as arrived."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from agent.wire import dialect
from sim_core.geodesy import LocalFrame
from xitl_cli.record.records import Estimate
from xitl_cli.run.links.inbox import AgentInbox
from xitl_cli.run.nodes.companion_routing import KEPT_ELSEWHERE

LINK = "companion"
WARNING = 4  # MAV_SEVERITY
MOST_WARNINGS = 8
_TICK = dialect.MAVLINK_MSG_ID_XITL_TICK


@dataclass(slots=True)
class _Said:
    """Up to the answer to a tick."""

    tick: int = -1
    frames: list[bytes] = field(default_factory=list)
    messages: list[Any] = field(default_factory=list)


class CompanionInbox(AgentInbox):
    """As of an agent. Any word is a sign of life, and it answers a tick with the tick.

    While `holds`, what comes waits until `release`, with the answer that it came ahead of: when it came on the wall
    clock then makes no difference. answered_tick: the latest answer that has come. warnings: the first few sentences
    that it, or the run about it, said of what went wrong, each once.
    """

    def __init__(self, frame: LocalFrame, lockstep: bool) -> None:
        super().__init__(LINK, frame, 0, lockstep, _pass_over)
        self.holds = False
        self.warnings: list[str] = []
        self._handlers[_TICK] = lambda message: None
        self._frames: deque[_Said] = deque([_Said()])
        self._messages: deque[_Said] = deque([_Said()])

    def take(self, messages: list[Any]) -> None:
        if messages:
            self.command_ns = time.monotonic_ns()
            self.fresh = True
        if not self.holds:
            super().take(messages)
            return
        for message in messages:
            self._messages[-1].messages.append(message)
            if message.get_msgId() == _TICK:
                self._messages[-1].tick = message.tick
                self._messages.append(_Said())
                self.answered_tick = max(self.answered_tick, message.tick)

    def say(self, severity: int, source: str, text: str) -> None:
        if severity <= WARNING and text not in self.warnings and len(self.warnings) < MOST_WARNINGS:
            self.warnings.append(text)
        super().say(severity, source, text)

    def tap(self, direction: str, frame: bytes) -> None:
        if direction == "tx" or not self.holds:
            self._keep(direction, frame)
            return
        self._frames[-1].frames.append(frame)
        if _id_of(frame) == _TICK:
            self._frames.append(_Said())

    def release(self, tick: int) -> None:
        """Take in all that came up to the answer to `tick`."""
        while self._messages[0].tick >= 0 and self._messages[0].tick <= tick:
            self._take_in(self._frames.popleft(), self._messages.popleft())

    def release_all(self) -> None:
        """Hold nothing any more, and take in what is left."""
        self.holds = False
        for frames, said in zip(self._frames, self._messages, strict=True):
            self._take_in(frames, said)
        self._frames, self._messages = deque([_Said()]), deque([_Said()])

    def _take_in(self, frames: _Said, said: _Said) -> None:
        for frame in frames.frames:
            self._keep("rx", frame)
        super().take(said.messages)

    def _keep(self, direction: str, frame: bytes) -> None:
        number = _id_of(frame)
        if number in KEPT_ELSEWHERE:
            counts = self.traffic[direction]
            counts[number] = counts.get(number, 0) + 1
        else:
            super().tap(direction, frame)


def _id_of(frame: bytes) -> int:
    return frame[7] | frame[8] << 8 | frame[9] << 16


def _pass_over(stamp_ns: int | None, estimate: Estimate) -> None:
    """A companion has no estimate of the kind that an autopilot has."""
