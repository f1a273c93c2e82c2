"""What nodes report of a run: progress while it goes on, and records whose `section` is their part of summary.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import Enum
from typing import Any

from xitl_cli.record.topics import TaskTiming
from xitl_cli.run.core.statistics import Histogram


class Ending(Enum):
    """Why a run ended."""

    FINISHED = "finished"
    DURATION = "duration reached"
    INTERRUPTED = "interrupted"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the controlling node is.

    target: index of the waypoint it heads for, None when it heads for none. finished: there is nothing more to do.
    completed: what it was there for is done: every waypoint reached, a script or recording played to its end.
    waypoints: the mission under way as (north, east), None for the profile's. waits_for: why the vessel's
    state is still frozen; empty once it may move. guided_ne_m: the place (north, east) it goes to in GUIDED.
    """

    mode: str
    armed: bool = False
    target: int | None = None
    reached: int = 0
    finished: bool = False
    completed: bool = False
    waypoints: tuple[tuple[float, float], ...] | None = None
    waits_for: str = ""
    messages: tuple[str, ...] = ()
    guided_ne_m: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class LinkReport:
    """One direction of a link over a whole run; counts the other end keeps are None until it has told them.

    name: `sensors` (to the agent) or `actuators` (from it); those of another link than `agent` have its name before
    them: `standby sensors`.
    lost: sent and never received. gaps: what the receiver misses, see `SequenceMonitor`. late: out of order. repeated:
    came twice. unsent: not taken by the transport of the sender. dropped: damaged or unknown ones. refused: without a
    good signature, or of others than the other end. impaired: kept back for good by an injected fault, part of the lost
    ones. host_end: what the host's transport has counted beside that, by name, told with the direction that it hears.
    """

    name: str
    sent: int | None
    received: int | None
    lost: int | None
    unsent: int | None
    dropped: int
    latency: Histogram = field(default_factory=Histogram)
    gaps: int | None = None
    late: int | None = None
    repeated: int | None = None
    refused: int | None = None
    impaired: int | None = None
    host_end: dict[str, int] = field(default_factory=dict)

    def section(self) -> dict[str, Any]:
        """A row of `links`."""
        return {
            "name": self.name,
            "sent": self.sent,
            "received": self.received,
            "lost": self.lost,
            "gaps": self.gaps,
            "late": self.late,
            "repeated": self.repeated,
            "unsent": self.unsent,
            "dropped": self.dropped,
            "refused": self.refused,
            "impaired": self.impaired,
            "host_end": self.host_end,
            "latency_us": _quantiles_us(self.latency),
        }


@dataclass(frozen=True, slots=True)
class ClockReport:
    """A node's clock against the host's at the end of a run; None where nothing was measured.

    drift_error_ppm: standard error of the drift, from the fit. drift_std_ppm: how the drift itself varies from one 10 s
    to the next. slope_s, slope_std_s: mean and standard deviation of
    the node's time base a sample. residual_us: spread of the exchanges about the estimate. path_delay_us: shortest
    way there and back, halved. steps: of the node's clock. stood_s: for which a simulated clock stood still with its
    process, but for what it makes up for.
    """

    node: str
    offset_us: float | None
    drift_ppm: float | None
    asymmetry_bound_us: float | None = None
    samples: int = 0
    residual_us: float | None = None
    path_delay_us: float | None = None
    drift_std_ppm: float | None = None
    slope_s: float | None = None
    slope_std_s: float | None = None
    steps: int = 0
    drift_error_ppm: float | None = None
    stood_s: float = 0.0

    def section(self) -> dict[str, Any]:
        """A row of `clocks`."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class NodeReport:
    """What a machine in the loop says of itself. link: the one it is on. None where it does not tell.

    kind: `real` or `virtual`. flags: how it runs, in words. estimates: those that its control used, efforts: those that
    its actuation allocated. log_dropped: records that its log had no room for. stations_missed: what ground stations
    did not get, or said in vain. events_lost: sentences that nobody took in time. controller_failures: steps at
    which the user's controller raised or gave no usable answer.
    """

    nodes: str
    machine: str
    version: str
    memory_mib: float | None
    refused: int
    link: str = "agent"
    kind: str = "virtual"
    kernel: str = ""
    python: str = ""
    flags: tuple[str, ...] = ()
    processors: int | None = None
    temperature_c: float | None = None
    cpu_percent: float | None = None
    estimates: int = 0
    efforts: int = 0
    log_dropped: int = 0
    stations_missed: int = 0
    events_lost: int = 0
    controller_failures: int = 0

    def section(self) -> dict[str, Any]:
        """A row of `nodes`."""
        return {**asdict(self), "flags": list(self.flags)}


@dataclass(frozen=True, slots=True)
class ActuatorReport:
    """How old the motor commands were at the exchanges that used them.

    stale: exchanges at which no new one had come; longest_stale: the most of them in a row.
    """

    age: Histogram = field(default_factory=Histogram)
    stale: int = 0
    longest_stale: int = 0

    def section(self) -> dict[str, Any]:
        """`actuators`."""
        return {"age_us": _quantiles_us(self.age), "stale": self.stale, "longest_stale": self.longest_stale}


@dataclass(frozen=True, slots=True)
class TakeoverReport:
    """One agent stepped in for another at `at_s`; see TakeoverEvent."""

    at_s: float
    from_node: str
    to_node: str
    silent_s: float
    step: float

    def section(self) -> dict[str, Any]:
        """A row of `takeovers`."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class FaultReport:
    """An injected fault: when it was in force, and counts of what it did.

    from_s None: the run ended before it began; until_s None: it was in force to the end.
    """

    name: str
    kind: str
    from_s: float | None
    until_s: float | None
    did: dict[str, int] = field(default_factory=dict)

    def section(self) -> dict[str, Any]:
        """A row of `faults`."""
        return asdict(self)


Traffic = dict[str, dict[str, dict[int, int]]]
"""Frames that crossed each link: by link (`agent`), by direction (`tx` to the agent, `rx` from it), by message id."""


def task_section(task: TaskTiming) -> dict[str, Any]:
    """A row of `tasks`."""
    return {
        "node": task.node,
        "task": task.task,
        "rate_hz": task.rate_hz,
        "cycles": task.cycles,
        "missed": task.missed,
        "skipped": task.skipped,
        "start_jitter_mean_us": task.start_jitter_mean_s * 1e6,
        "start_jitter_p50_us": _bin_quantile_us(task.start_histogram, 0.5, task.start_jitter_max_s),
        "start_jitter_p99_us": _bin_quantile_us(task.start_histogram, 0.99, task.start_jitter_max_s),
        "start_jitter_max_us": task.start_jitter_max_s * 1e6,
        "worst_start_s": _seconds(task.worst_start_ns),
        "run_mean_us": task.run_mean_s * 1e6,
        "run_p50_us": _bin_quantile_us(task.run_histogram, 0.5, task.run_max_s),
        "run_p99_us": _bin_quantile_us(task.run_histogram, 0.99, task.run_max_s),
        "run_max_us": task.run_max_s * 1e6,
        "worst_run_s": _seconds(task.worst_run_ns),
        "start_histogram": list(task.start_histogram),
        "run_histogram": list(task.run_histogram),
    }


def _bin_quantile_us(histogram: tuple[int, ...], share: float, max_s: float) -> float | None:
    """Upper edge of the bin in which `share` of the cycles is reached, not above the maximum; None without cycles."""
    left = share * sum(histogram)
    if not left:
        return None
    for number, count in enumerate(histogram[:-1]):
        left -= count
        if left <= 0:
            return min(float(2 ** (number + 1)), max_s * 1e6)
    return max_s * 1e6


def _seconds(stamp_ns: int | None) -> float | None:
    return None if stamp_ns is None else stamp_ns / 1e9


def _quantiles_us(latency: Histogram) -> dict[str, float | None]:
    p50, p99 = latency.quantile_ns(0.5), latency.quantile_ns(0.99)
    return {
        "p50": None if p50 is None else p50 / 1e3,
        "p99": None if p99 is None else p99 / 1e3,
        "max": latency.max_ns / 1e3 if latency.count else None,
    }
