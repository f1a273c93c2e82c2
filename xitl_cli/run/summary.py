"""summary.json: what a run was, how it ended and every count that was kept."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from agent import __version__
from xitl_cli.graph.of_profile import wdri_of
from xitl_cli.profile.schema import RunProfile
from xitl_cli.recording.records import Task
from xitl_cli.run.histogram import Histogram
from xitl_cli.run.loop import Ending
from xitl_cli.run.pilot import ClockReport, LinkReport, NodeReport
from xitl_cli.run.score import EstimationScore, MissionScore

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
    tasks: list[Task]
    clocks: list[ClockReport]
    nodes: list[NodeReport]
    stale_exchanges: int


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
        "wdri": wdri_of(profile).wdri,
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
        "nodes": [asdict(node) for node in outcome.nodes],
        "stale_exchanges": outcome.stale_exchanges,
    }


def _link(link: LinkReport) -> dict[str, Any]:
    return {
        "name": link.name,
        "sent": link.sent,
        "received": link.received,
        "lost": link.lost,
        "unsent": link.unsent,
        "dropped": link.dropped,
        "latency_us": _quantiles_us(link.latency),
    }


def _quantiles_us(latency: Histogram) -> dict[str, float | None]:
    p50, p99 = latency.quantile_ns(0.5), latency.quantile_ns(0.99)
    return {
        "p50": None if p50 is None else p50 / 1e3,
        "p99": None if p99 is None else p99 / 1e3,
        "max": latency.max_ns / 1e3 if latency.count else None,
    }


def _task(task: Task) -> dict[str, Any]:
    return {
        "node": task.node,
        "task": task.task,
        "rate_hz": task.rate_hz,
        "cycles": task.cycles,
        "missed": task.missed,
        "start_jitter_max_us": task.start_jitter_max_s * 1e6,
        "run_mean_us": task.run_mean_s * 1e6,
        "run_max_us": task.run_max_s * 1e6,
    }
