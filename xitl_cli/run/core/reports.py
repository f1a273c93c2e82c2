"""Reports of the nodes of a run: the current progress, and records with a `section` for summary.json."""

from __future__ import annotations

from dataclasses import asdict, field, fields
from enum import Enum
from typing import Any

from sim_core.dataclass import dataclass
from xitl_cli.record.topics import TaskTiming
from xitl_cli.run.core.statistics import Histogram


class Ending(Enum):
    """Reason for the end of a run."""

    FINISHED = "finished"
    DURATION = "duration reached"
    INTERRUPTED = "interrupted"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of the controlling node."""

    mode: str
    armed: bool = False
    target: int | None = None
    """Index of the waypoint that the vessel heads for; None without one."""
    reached: int = 0
    finished: bool = False
    """The node has nothing more to do."""
    completed: bool = False
    """The node did its task: it reached every waypoint, or played a script or recording to its end."""
    waypoints: tuple[tuple[float, float], ...] | None = None
    """Active mission as (north, east) in metres; None for the profile's mission."""
    waits_for: str = ""
    """Reason why the vessel's state is still frozen; empty once the vessel may move."""
    messages: tuple[str, ...] = ()
    guided_ne_m: tuple[float, float] | None = None
    """Target in GUIDED as (north, east) in metres; None without one."""
    desired_heading_deg: float | None = None
    """Heading that the autopilot steers for, from north, clockwise; None in modes without one."""


@dataclass(frozen=True, slots=True)
class ClockReport:
    """A node's clock against the host's at the end of a run. A value is None when nothing was measured."""

    node: str
    offset_us: float | None
    drift_ppm: float | None
    asymmetry_bound_us: float | None = None
    samples: int = 0
    residual_us: float | None = None
    """Spread of the exchanges about the estimate."""
    path_delay_us: float | None = None
    """Half of the shortest round trip."""
    drift_std_ppm: float | None = None
    """Standard deviation of the drift between windows of 10 s."""
    slope_s: float | None = None
    """Mean of the node's time base per sample."""
    slope_std_s: float | None = None
    """Standard deviation of the node's time base per sample."""
    steps: int = 0
    """Steps of the node's clock."""
    drift_error_ppm: float | None = None
    """Standard error of the drift, from the fit."""
    stood_s: float = 0.0
    """Time for which a simulated clock stopped with its process, less the time that it made up."""

    def section(self) -> dict[str, Any]:
        """Return a row of `clocks`."""
        return asdict(self)


def _reported(trouble: str = "") -> dict[str, Any]:
    """Return the metadata of a count that XITL_NODE_STATUS has under the same name. trouble: as in `counted`."""
    return {"reported": True, "trouble": trouble}


@dataclass(frozen=True, slots=True)
class NodeReport:
    """Report of a machine in the loop about itself. A value is None when the machine does not report it."""

    nodes: str
    machine: str
    version: str
    memory_mib: float | None
    refused: int
    link: str = "agent"
    """Name of the link to the machine."""
    kind: str = "virtual"
    """`real` or `virtual`."""
    kernel: str = ""
    python: str = ""
    flags: tuple[str, ...] = ()
    """How the process runs, in words such as `PREEMPT_RT`, `SCHED_FIFO` or `memory locked`."""
    processors: int | None = None
    temperature_c: float | None = None
    cpu_percent: float | None = None
    estimates: int = field(default=0, metadata=_reported())
    """Estimates that the node's control used."""
    efforts: int = field(default=0, metadata=_reported())
    """Efforts that the node's actuation allocated."""
    log_dropped: int = field(default=0, metadata=_reported("records of its log not written"))
    """Records for which the node's log had no space."""
    stations_missed: int = field(default=0, metadata=_reported("messages missed by ground stations"))
    """Messages that ground stations did not get, or sent in vain."""
    events_lost: int = field(default=0, metadata=_reported("event texts lost"))
    """Texts of events that were not read in time."""
    controller_failures: int = field(default=0, metadata=_reported("failures of the controller"))
    """Steps at which the user's controller raised or gave no usable answer."""

    def section(self) -> dict[str, Any]:
        """Return a row of `nodes`."""
        return {**asdict(self), "flags": list(self.flags)}


@dataclass(frozen=True, slots=True)
class ActuatorReport:
    """Age of the motor commands at the exchanges that used them."""

    age: Histogram = field(default_factory=Histogram)
    stale: int = 0
    """Exchanges without a new command."""
    longest_stale: int = 0
    """Longest sequence of such exchanges."""

    def section(self) -> dict[str, Any]:
        """Return `actuators`."""
        p50_ns, p99_ns = self.age.quantile_ns(0.5), self.age.quantile_ns(0.99)
        age_us = {
            "p50": None if p50_ns is None else p50_ns / 1e3,
            "p99": None if p99_ns is None else p99_ns / 1e3,
            "max": self.age.max_ns / 1e3 if self.age.count else None,
        }
        return {"age_us": age_us, "stale": self.stale, "longest_stale": self.longest_stale}


@dataclass(frozen=True, slots=True)
class FaultReport:
    """An injected fault: the interval in which it was active, and counts of its effects."""

    name: str
    kind: str
    from_s: float | None
    """None when the run ended before the fault began."""
    until_s: float | None
    """None when the fault was active until the end of the run."""
    did: dict[str, int] = field(default_factory=dict)

    def section(self) -> dict[str, Any]:
        """Return a row of `faults`."""
        return asdict(self)


def troubles(report: type) -> dict[str, str]:
    """Return the counters of a report that a sound run leaves at 0: the words after the number, by key of the summary.

    report: LinkReport, NodeReport or BridgeCounts.
    """
    return {counter.name: counter.metadata["trouble"] for counter in fields(report) if counter.metadata.get("trouble")}


def task_section(task: TaskTiming) -> dict[str, Any]:
    """Return a row of `tasks`."""
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
    """Return the upper edge of the bin that contains the quantile `share`, at most the maximum; None without cycles."""
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
