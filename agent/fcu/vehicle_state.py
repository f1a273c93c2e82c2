"""Plain data of the embedded autopilot, without MAVLink: actuators, vehicle state, events."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from agent.navigation.measurements import StateEstimate

CRITICAL, ERROR, WARNING, NOTICE, INFO = 2, 3, 4, 5, 6  # MAV_SEVERITY
_MOST_WAITING = 64


class Actuators(NamedTuple):
    """Commands in [-1, 1]: first the throttles, full astern to full ahead, such as port and starboard.

    Then the steering.
    """

    command: tuple[float, ...] = (0.0, 0.0)
    armed: bool = False
    failsafe: bool = False


@dataclass
class VehicleState:
    """Shared state of the parts of the autopilot. Only `Autopilot` changes it."""

    mode: int
    """ArduRover's number."""
    estimate: StateEstimate
    """Estimate of this control cycle."""
    armed: bool = False
    now_ns: int = 0
    """Start of this control cycle on the agent's clock."""
    speed_error_mps: float = 0.0
    """Desired minus measured speed over ground."""


class Event(NamedTuple):
    """A sentence for the user of the ground station, with a MAV_SEVERITY."""

    severity: int
    text: str


class EventQueue:
    """Events that wait to be drained. Beyond the limit, the oldest are lost and counted."""

    def __init__(self) -> None:
        self.lost = 0
        self._waiting: deque[Event] = deque(maxlen=_MOST_WAITING)

    def add(self, severity: int, text: str) -> None:
        """Queue an event."""
        if len(self._waiting) == _MOST_WAITING:
            self.lost += 1
        self._waiting.append(Event(severity, text))

    def refuse(self, reason: str) -> str:
        """Queue the reason of a refused command, and return it."""
        self.add(WARNING, reason)
        return reason

    def drain(self) -> list[Event]:
        """Return all events since the last call, oldest first."""
        events = list(self._waiting)
        self._waiting.clear()
        return events
