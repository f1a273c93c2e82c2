"""A companion computer as a node: HS, HC and HA. It is there, keeps time and says how it is.

Perception, planning and payloads have their place here; so far there are none, and nothing pretends to be them. What
runs is a task at the rate of a planner that watches how long the host has been silent: enough to measure how well the
machine keeps deadlines and how its clock runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Callable

from agent.fcu.mavlink.texts import Texts
from agent.role import Role
from agent.timing.clock import Clock
from agent.timing.tasks import Executor
from agent.wire import dialect
from agent.wire.codec import Message

WATCH_HZ = 10.0
HEARTBEAT_NS = 1_000_000_000
SILENCE_S = 1.0
_NOTICE = 5  # MAV_SEVERITY


class CompanionRole(Role):
    """Heartbeats of an onboard controller, and sentences when the host falls silent or is back."""

    title = "companion"
    nodes = "HS,HC,HA"
    telemetry_hz = WATCH_HZ

    def __init__(self) -> None:
        self._texts = Texts()

    def reset(self, clock: Clock, lockstep: bool) -> None:
        self._beat_ns: int | None = None
        self._silent = False
        self._waiting: list[Message] = []

    def begin(self, executor: Executor, silent_s: Callable[[], float]) -> None:
        self._silent_s = silent_s
        executor.add("watch", WATCH_HZ, self._watch)

    def take(self, message: Message, now_ns: int) -> Sequence[Message]:
        return ()

    def _watch(self, now_ns: int) -> None:
        silent = self._silent_s() > SILENCE_S
        if silent != self._silent:
            self._silent = silent
            self.say(_NOTICE, "Host is silent" if silent else "Host is back")

    def say(self, severity: int, text: str) -> None:
        self._waiting.extend(self._texts.messages(severity, text))

    def telemetry(self, now_ns: int) -> Sequence[Message]:
        due, self._waiting = self._waiting, []
        if self._beat_ns is None or now_ns - self._beat_ns >= HEARTBEAT_NS:
            self._beat_ns = now_ns
            due.append(
                dialect.MAVLink_heartbeat_message(
                    dialect.MAV_TYPE_ONBOARD_CONTROLLER,
                    dialect.MAV_AUTOPILOT_INVALID,
                    0,
                    0,
                    dialect.MAV_STATE_ACTIVE,
                    3,
                )
            )
        return due
