"""summary.json: what a run was, how it ended and every count that was kept."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from agent import __version__
from xitl_cli.graph.wdri import profile_wdri
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import TaskTiming
from xitl_cli.run.loop import Ending
from xitl_cli.run.nodes.bridge import AutopilotReport, autopilot_section
from xitl_cli.run.nodes.score import EstimationScore, MissionScore
from xitl_cli.run.pace import PaceReport
from xitl_cli.run.pilot import (
    ActuatorReport,
    ClockReport,
    FaultReport,
    LinkReport,
    NodeReport,
    TakeoverReport,
    Traffic,
)
from xitl_cli.run.run_graph import graph_section
from xitl_cli.run.statistics import Histogram

FORMAT = 1


@dataclass(frozen=True, slots=True)
class Outcome:
    """All that a finished run knows about itself.

    completed: the driver did all it was there for. moored_s: how long the vessel lay moored. `estimation` is None where
    nothing estimates.
    """

    ending: Ending
    error: str | None
    crash: Exception | None
    started_utc: str
    duration_s: float
    wall_s: float
    mission: MissionScore
    completed: bool
    moored_s: float
    estimation: EstimationScore | None
    links: list[LinkReport]
    tasks: list[TaskTiming]
    clocks: list[ClockReport]
    nodes: list[NodeReport]
    stale_exchanges: int
    actuators: ActuatorReport | None = None
    takeovers: list[TakeoverReport] = field(default_factory=list)
    faults: list[FaultReport] = field(default_factory=list)
    traffic: Traffic = field(default_factory=dict)
    pace: PaceReport = field(default_factory=PaceReport)
    autopilot: AutopilotReport | None = None
    collisions: dict[str, Any] | None = None
    debris: dict[str, Any] | None = None
    perception: dict[str, Any] | None = None


def summary_of(profile: RunProfile, outcome: Outcome) -> dict[str, Any]:
    """The content of summary.json; docs/recording.md explains the keys."""
    mission, estimation = outcome.mission, outcome.estimation
    return {
        "format": FORMAT,
        "xitl": __version__,
        "profile": profile.name,
        "technique": profile.technique,
        "seed": profile.clock.seed,
        "clock": profile.clock.mode,
        "started_utc": outcome.started_utc,
        "ended": outcome.ending.value,
        "error": outcome.error,
        "wdri": profile_wdri(profile).wdri,
        "duration_s": outcome.duration_s,
        "wall_s": outcome.wall_s,
        "real_time_factor": outcome.duration_s / outcome.wall_s if outcome.wall_s > 0 else None,
        "driver": {"kind": profile.driver.kind, "completed": outcome.completed, "moored_s": outcome.moored_s},
        "mission": {
            "completed": mission.completed,
            "waypoints_reached": mission.reached,
            "waypoints_total": mission.total,
            "cross_track_rms_m": mission.cross_track_rms_m,
            "cross_track_max_m": mission.cross_track_max_m,
            "closest_m": mission.closest_m,
        },
        "estimation": {
            "position_rms_m": estimation.position_rms_m if estimation else None,
            "heading_rms_deg": estimation.heading_rms_deg if estimation else None,
        },
        "links": [_link(link) for link in outcome.links],
        "tasks": [_task(task) for task in outcome.tasks],
        "clocks": [asdict(clock) for clock in outcome.clocks],
        "nodes": [{**asdict(node), "flags": list(node.flags)} for node in outcome.nodes],
        "stale_exchanges": outcome.stale_exchanges,
        "actuators": None if outcome.actuators is None else _actuators(outcome.actuators),
        "autopilot": None if outcome.autopilot is None else autopilot_section(outcome.autopilot, outcome.tasks),
        "takeovers": [asdict(takeover) for takeover in outcome.takeovers],
        "faults": [asdict(fault) for fault in outcome.faults],
        "collisions": outcome.collisions,
        "debris": outcome.debris,
        "perception": outcome.perception,
        "pace": asdict(outcome.pace),
        "graph": graph_section(
            profile,
            outcome.duration_s,
            outcome.moored_s,
            outcome.links,
            outcome.nodes,
            outcome.traffic,
            outcome.autopilot,
        ),
    }


def _link(link: LinkReport) -> dict[str, Any]:
    return {
        "name": link.name,
        "sent": link.sent,
        "received": link.received,
        "lost": link.lost,
        "gaps": link.gaps,
        "late": link.late,
        "repeated": link.repeated,
        "unsent": link.unsent,
        "dropped": link.dropped,
        "refused": link.refused,
        "impaired": link.impaired,
        "host_end": link.host_end,
        "latency_us": _quantiles_us(link.latency),
    }


def _quantiles_us(latency: Histogram) -> dict[str, float | None]:
    p50, p99 = latency.quantile_ns(0.5), latency.quantile_ns(0.99)
    return {
        "p50": None if p50 is None else p50 / 1e3,
        "p99": None if p99 is None else p99 / 1e3,
        "max": latency.max_ns / 1e3 if latency.count else None,
    }


def _actuators(actuators: ActuatorReport) -> dict[str, Any]:
    return {
        "age_us": _quantiles_us(actuators.age),
        "stale": actuators.stale,
        "longest_stale": actuators.longest_stale,
    }


def _task(task: TaskTiming) -> dict[str, Any]:
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
