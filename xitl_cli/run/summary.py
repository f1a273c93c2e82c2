"""summary.json: what a run was, how it ended, and what its nodes report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from agent import __version__
from xitl_cli.graph.wdri import profile_wdri
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import PaceReport, TaskTiming
from xitl_cli.run.core.reports import Ending, task_section
from xitl_cli.run.run_graph import graph_section
from xitl_cli.run.verdict import Verdict, judge, measured_figures, why_text

FORMAT = 1
Sections = dict[str, Any]


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """How a run ended. completed: the controlling node did all it was for. held_s: how long the vessel was held.

    timed: its duration was asked for, so that reaching it is what was wanted.
    """

    ending: Ending
    error: str | None
    crash: Exception | None
    started_utc: str
    duration_s: float
    wall_s: float
    completed: bool
    held_s: float
    timed: bool = False


def merged(reports: Iterable[Mapping[str, Any]]) -> Sections:
    """One report of many: lists are joined in their order, dicts laid over each other, anything else is replaced.

    What no node reports is as in a run without such a node.
    """
    sections: Sections = {
        "mission": None,
        "estimation": {"position_rms_m": None, "position_nees": None, "heading_rms_deg": None},
        "links": [],
        "tasks": [],
        "clocks": [],
        "nodes": [],
        "stale_exchanges": 0,
        "actuators": None,
        "autopilot": None,
        "takeovers": [],
        "faults": [],
        "model_range": None,
        "collisions": None,
        "debris": None,
        "perception": None,
        "pace": None,
        "graph": None,
        "odometry": None,
        "mapping": None,
        "obstacles": None,
        "companion": None,
        "warnings": [],
        "traffic": {},
    }
    for report in reports:
        for key, value in report.items():
            known = sections[key]
            if isinstance(known, list):
                sections[key] = [*known, *value]
            elif isinstance(known, dict):
                sections[key] = {**known, **value}
            else:
                sections[key] = value
    return sections


def summary_of(profile: RunProfile, outcome: RunOutcome, vessels: Mapping[str, Sections]) -> dict[str, Any]:
    """The content of summary.json; docs/recording.md explains the keys.

    vessels: what the nodes of each report, merged, by its name. The first one's stand at the top, others' in `vessels`.
    """
    (_, first), *others = vessels.items()
    verdict = _verdict(profile, outcome, first)
    first = {**first, "warnings": [*first["warnings"], *verdict.warnings]}
    summary = {
        "format": FORMAT,
        "xitl": __version__,
        "profile": profile.name,
        "technique": profile.technique,
        "seed": profile.clock.seed,
        "clock": profile.clock.mode,
        "started_utc": outcome.started_utc,
        "ended": outcome.ending.value,
        "error": outcome.error,
        "verdict": verdict.section(),
        "wdri": profile_wdri(profile).wdri,
        "duration_s": outcome.duration_s,
        "wall_s": outcome.wall_s,
        "real_time_factor": outcome.duration_s / outcome.wall_s if outcome.wall_s > 0 else None,
        "driver": {"kind": profile.driver.kind, "completed": outcome.completed, "moored_s": outcome.held_s},
        **_vessel(profile, outcome, first),
    }
    if others:
        summary["vessels"] = {name: _vessel(profile, outcome, sections) for name, sections in others}
    return summary


def _verdict(profile: RunProfile, outcome: RunOutcome, sections: Sections) -> Verdict:
    """On the run; of several vessels the first one's nodes are judged."""
    frozen = 0.0 < outcome.duration_s <= outcome.held_s
    why = why_text(outcome.ending, outcome.error, profile.driver.kind, outcome.completed, sections["mission"], frozen)
    if profile.clock.mode == "lockstep":
        return judge(outcome.ending, outcome.completed, outcome.timed, why, None)
    pace: PaceReport = sections["pace"]
    keys = ("tasks", "links", "clocks", "faults")
    figures = measured_figures(outcome.wall_s, pace, *(sections[key] for key in keys))
    return judge(outcome.ending, outcome.completed, outcome.timed, why, figures)


def _vessel(profile: RunProfile, outcome: RunOutcome, sections: Sections) -> dict[str, Any]:
    """The sections of one vessel, with what is computed of several together."""
    written: dict[str, Any] = {}
    for key, value in sections.items():
        if key == "graph":
            written[key] = graph_section(
                profile,
                outcome.duration_s,
                outcome.held_s,
                sections["links"],
                sections["nodes"],
                sections["traffic"],
                sections["autopilot"],
            )
        elif key == "autopilot" and value is not None:
            written[key] = value.section(sections["tasks"])
        elif key != "traffic":
            written[key] = _written(value)
    return written


def _written(value: Any) -> Any:
    """As plain JSON."""
    if isinstance(value, list):
        return [_written(one) for one in value]
    if isinstance(value, TaskTiming):
        return task_section(value)
    if isinstance(value, PaceReport):
        return asdict(value)
    return value.section() if hasattr(value, "section") else value
