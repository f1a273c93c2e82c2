"""Check of a run in real time: measured figures, tolerated limits, and the description of shortfalls."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RealTimeLimits:
    """Tolerated limits of a run in real time."""

    physics_missed_share: float = 0.05
    """A step that begins more than a period late is caught up, and its samples are some ms late. At 400 Hz there are
    eight to a control cycle. With one in twenty, most cycles have none."""
    cycles_missed_share: float = 0.02
    """In a missed cycle, the agent gives no command, and the old command stays in force. One in fifty is one per
    second."""
    lost_share: float = 0.01
    """An estimator bridges one lost sample in a hundred without effect."""
    longest_stall_s: float = 0.25
    """The embedded autopilot stops the motors after this time without sensors (FS_IMU_TIMEOUT), which changes the
    run."""
    stalled_share: float = 0.01
    """Share of the time in stalls of any length."""
    clock_steps: int = 0
    """Each step moves every later stamp of that clock."""


LIMITS = RealTimeLimits()


@dataclass(frozen=True, slots=True)
class TaskMissCount:
    """Deadlines of the task that missed the largest share."""

    name: str
    cycles: int
    missed: int

    @property
    def share(self) -> float:
        return self.missed / self.cycles if self.cycles else 0.0


@dataclass(frozen=True, slots=True)
class LinkLosses:
    """Lost frames of one direction of a link, without those of injected faults."""

    name: str
    sent: int
    lost: int

    @property
    def share(self) -> float:
        return self.lost / self.sent if self.sent else 0.0


@dataclass(frozen=True, slots=True)
class RealTimeFigures:
    """Measured figures of a run in real time of `length_s`. None: unknown, or caused on purpose by a fault."""

    length_s: float
    physics: TaskMissCount | None = None
    """Of the host."""
    control: TaskMissCount | None = None
    """The agents' task with the largest share of missed cycles."""
    link: LinkLosses | None = None
    stalls: int = 0
    stalled_s: float = 0.0
    longest_stall_s: float = 0.0
    slipped_s: float = 0.0
    stood_s: float = 0.0
    """Time in which a simulated autopilot did not run."""
    clock_steps: tuple[tuple[str, int], ...] = ()
    """(clock, number of steps)."""

    def shortfalls(self, limits: RealTimeLimits = LIMITS) -> tuple[str, ...]:
        """Violated limits, the most severe first; empty if the run was in real time."""
        shortfalls: list[str] = []
        length_s = max(self.length_s, 1e-9)
        if self.longest_stall_s > limits.longest_stall_s or self.stalled_s > limits.stalled_share * length_s:
            times = "once" if self.stalls == 1 else f"{self.stalls} times"
            longest = "" if self.stalls == 1 else f", the longest {_seconds(self.longest_stall_s)}"
            shortfalls.append(f"the host stalled {times}, {_seconds(self.stalled_s)} in all{longest}")
        if self.slipped_s > max(self.stalled_s, limits.stalled_share * length_s):
            shortfalls.append(f"the host fell behind by {_seconds(self.slipped_s)} that were not made up")
        if self.physics is not None and self.physics.share > limits.physics_missed_share:
            shortfalls.append(f"{_percent(self.physics.share)} of the physics deadlines missed")
        if self.control is not None and self.control.share > limits.cycles_missed_share:
            share, name = _percent(self.control.share), self.control.name
            shortfalls.append(
                f"{share} of the agent's cycles missed ({name}: {self.control.missed} of {self.control.cycles})"
            )
        if self.link is not None and self.link.share > limits.lost_share:
            shortfalls.append(f"{_percent(self.link.share)} of the frames lost ({self.link.name}: {self.link.lost})")
        if self.stood_s > limits.stalled_share * length_s:
            shortfalls.append(f"the simulated autopilot stood still for {_seconds(self.stood_s)}")
        for clock, steps in self.clock_steps:
            if steps > limits.clock_steps:
                shortfalls.append(f"the clock of {clock} stepped {'once' if steps == 1 else f'{steps} times'}")
        return tuple(shortfalls)


def not_real_time(shortfalls: tuple[str, ...]) -> str:
    """One sentence with all shortfalls."""
    return f"not a real-time run: {'; '.join(shortfalls)}"


def worst(all_of: list[TaskMissCount]) -> TaskMissCount | None:
    """Task with the largest share missed."""
    return max(all_of, key=lambda task: task.share, default=None)


def worst_link(all_of: list[LinkLosses]) -> LinkLosses | None:
    """Link with the largest share lost."""
    return max(all_of, key=lambda link: link.share, default=None)


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share >= 0.1 else f"{100.0 * share:.1f} %"


def _seconds(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds >= 1.0 else f"{seconds:.2f} s"
