"""Whether a run in real time kept real time: what was measured, what may be missed, and what is said of the rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RealTimeLimits:
    """What a run may miss and still stand for one in real time.

    physics_missed_share: a step that began more than a period late is made up for, and its samples come some ms late;
    at 400 Hz there are eight to a control cycle, so that with one in twenty most cycles have none. cycles_missed_share:
    such a cycle of the agent gave no command at all, and the old one stayed in force; one in fifty is one a second.
    lost_share: a sample in a hundred is what an estimator coasts over unnoticed. longest_stall_s: as long as the
    embedded autopilot goes without sensors before it lets go of the motors (FS_IMU_TIMEOUT): from there on the run
    itself is another one. stalled_share: of the time, in stalls of any length. clock_steps: each moves every stamp of
    that clock.
    """

    physics_missed_share: float = 0.05
    cycles_missed_share: float = 0.02
    lost_share: float = 0.01
    longest_stall_s: float = 0.25
    stalled_share: float = 0.01
    clock_steps: int = 0


LIMITS = RealTimeLimits()


@dataclass(frozen=True, slots=True)
class TaskMissCount:
    """Deadlines of the task that kept the fewest of them."""

    name: str
    cycles: int
    missed: int

    @property
    def share(self) -> float:
        return self.missed / self.cycles if self.cycles else 0.0


@dataclass(frozen=True, slots=True)
class LinkLosses:
    """Frames of one direction of a link that were lost, other than by an injected fault."""

    name: str
    sent: int
    lost: int

    @property
    def share(self) -> float:
        return self.lost / self.sent if self.sent else 0.0


@dataclass(frozen=True, slots=True)
class RealTimeFigures:
    """What was measured of a run in real time of `length_s`. None: not known, or caused on purpose by a fault.

    physics: of the host. control: of the agents' tasks the one with the largest share. clock_steps: (clock, how many).
    stood_s: for which a simulated autopilot did not run.
    """

    length_s: float
    physics: TaskMissCount | None = None
    control: TaskMissCount | None = None
    link: LinkLosses | None = None
    stalls: int = 0
    stalled_s: float = 0.0
    longest_stall_s: float = 0.0
    slipped_s: float = 0.0
    stood_s: float = 0.0
    clock_steps: tuple[tuple[str, int], ...] = ()

    def shortfalls(self, limits: RealTimeLimits = LIMITS) -> tuple[str, ...]:
        """In what it was no run in real time, the gravest first; empty when it was one."""
        return tuple(self._shortfalls(limits))

    def _shortfalls(self, limits: RealTimeLimits) -> Iterator[str]:
        length_s = max(self.length_s, 1e-9)
        if self.longest_stall_s > limits.longest_stall_s or self.stalled_s > limits.stalled_share * length_s:
            times = "once" if self.stalls == 1 else f"{self.stalls} times"
            longest = "" if self.stalls == 1 else f", the longest {_seconds(self.longest_stall_s)}"
            yield f"the host stalled {times}, {_seconds(self.stalled_s)} in all{longest}"
        if self.slipped_s > max(self.stalled_s, limits.stalled_share * length_s):
            yield f"the host fell behind by {_seconds(self.slipped_s)} that were not made up"
        if self.physics is not None and self.physics.share > limits.physics_missed_share:
            yield f"{_percent(self.physics.share)} of the physics deadlines missed"
        if self.control is not None and self.control.share > limits.cycles_missed_share:
            share, name = _percent(self.control.share), self.control.name
            yield f"{share} of the agent's cycles missed ({name}: {self.control.missed} of {self.control.cycles})"
        if self.link is not None and self.link.share > limits.lost_share:
            yield f"{_percent(self.link.share)} of the frames lost ({self.link.name}: {self.link.lost})"
        if self.stood_s > limits.stalled_share * length_s:
            yield f"the simulated autopilot stood still for {_seconds(self.stood_s)}"
        for clock, steps in self.clock_steps:
            if steps > limits.clock_steps:
                yield f"the clock of {clock} stepped {'once' if steps == 1 else f'{steps} times'}"


def not_real_time(shortfalls: tuple[str, ...]) -> str:
    """One sentence of them all."""
    return f"not a real-time run: {'; '.join(shortfalls)}"


def worst(all_of: list[TaskMissCount]) -> TaskMissCount | None:
    """The one with the largest share missed."""
    return max(all_of, key=lambda one: one.share, default=None)


def worst_link(all_of: list[LinkLosses]) -> LinkLosses | None:
    """The one with the largest share lost."""
    return max(all_of, key=lambda one: one.share, default=None)


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share >= 0.1 else f"{100.0 * share:.1f} %"


def _seconds(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds >= 1.0 else f"{seconds:.2f} s"
