"""Two agents and one vessel: who steers, when the other takes over, and how the motors get from one to the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign


@dataclass(frozen=True, slots=True)
class Switch:
    """The active agent was silent for `silent_ns`; `active` steers from now on."""

    active: int
    silent_ns: int


class Takeover:
    """Which of the agents steers; agent 0 does at the start.

    An agent speaks when a motor command of its comes. When the active one has been silent for `takeover_s` and another
    has not, that one takes over. It stays so until it is silent itself: the first one gets nothing back by returning.
    Instants are of any one clock.
    """

    def __init__(self, takeover_s: float, agents: int = 2, now_ns: int = 0) -> None:
        self.active = 0
        self._limit_ns = round(takeover_s * 1e9)
        self._heard_ns = [now_ns] * agents

    def heard(self, agent: int, now_ns: int) -> None:
        """A motor command came."""
        self._heard_ns[agent] = now_ns

    def decide(self, now_ns: int) -> Switch | None:
        """The switch that is due now, if any; `active` has then changed."""
        silent_ns = now_ns - self._heard_ns[self.active]
        if silent_ns < self._limit_ns:
            return None
        latest = max(range(len(self._heard_ns)), key=self._heard_ns.__getitem__)
        if latest == self.active or now_ns - self._heard_ns[latest] >= self._limit_ns:
            return None
        self.active = latest
        return Switch(latest, silent_ns)


class Ramp:
    """Motor commands on their way from one agent's to another's, at most `max_step` of each an exchange.

    Started by `start`, it ends at the first exchange at which all motors are where they should be; outside of that
    commands go through as they are. `largest` is the largest step that it has let through since it was started; the
    first exchange tells, since where a motor has further to go it takes the whole step.
    """

    def __init__(self, max_step: float) -> None:
        self.largest = 0.0
        self._max_step = max_step
        self._last: tuple[float, ...] = ()
        self._under_way = False

    def start(self) -> None:
        """Another agent steers from the next exchange on."""
        self._under_way = True
        self.largest = 0.0

    @property
    def under_way(self) -> bool:
        """Whether steps are limited now."""
        return self._under_way

    def next(self, wanted: Sequence[float]) -> tuple[float, ...]:
        """The commands of this exchange; call it once an exchange."""
        if self._under_way and self._last:
            limit = self._max_step
            pairs = list(zip(self._last, wanted, strict=True))
            reached = tuple(to if abs(to - at) <= limit else at + copysign(limit, to - at) for at, to in pairs)
            self.largest = max(self.largest, *(min(abs(to - at), limit) for at, to in pairs))
            self._under_way = reached != tuple(wanted)
            self._last = reached
        else:
            self._under_way = False
            self._last = tuple(wanted)
        return self._last
