"""summary.json: the profile of a run, its end, and the reports of its nodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from agent import __version__
from agent.mavlink.modes import MISSION_MODE
from sim_core.dataclass import dataclass
from xitl_cli.graph.wdri import profile_wdri
from xitl_cli.logs.signals.real_time import (
    LinkLosses,
    RealTimeFigures,
    TaskMissCount,
    not_real_time,
    worst,
    worst_link,
)
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.mcap_file import RecordedFile
from xitl_cli.record.topics import AutopilotEvent, LinkReport, PaceReport, TaskTiming
from xitl_cli.run.core.reports import ClockReport, Ending, FaultReport, task_section
from xitl_cli.run.run_graph import graph_section

FORMAT = 1
Sections = dict[str, Any]


@dataclass(frozen=True, slots=True)
class VesselOutcome:
    """Outcome of a run for one vessel."""

    awaited: bool
    """The run lasted until this vessel had finished."""
    completed: bool
    """The vessel's controlling node did its task."""
    held_s: float
    """Time for which the vessel was held."""
    lost: str | None = None
    """Reason why the vessel was lost in a fleet's run that continued; None if it was not lost."""


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """Outcome of a run."""

    ending: Ending
    error: str | None
    crash: Exception | None
    started_utc: str
    duration_s: float
    wall_s: float
    completed: bool
    """The controlling nodes of the awaited vessels did their task."""
    vessels: tuple[VesselOutcome, ...]
    """The vessels in their order."""
    why_numpy: str | None = None
    """Reason why the physics ran in numpy; None if it ran compiled."""
    timed: bool = False
    """The user gave the duration, so a run that reaches it has done what was asked."""
    files: tuple[RecordedFile, ...] = ()
    """Files of a split recording."""

    @property
    def held_s(self) -> float:
        """Longest time for which a vessel was held."""
        return max(vessel.held_s for vessel in self.vessels)


def merged(reports: Iterable[Mapping[str, Any]]) -> Sections:
    """Merge many reports: lists are joined in order, dicts are merged, and other values are replaced.

    Keys that no node reports keep their defaults.
    """
    sections: Sections = {
        "mission": None,
        "estimation": dict.fromkeys(("position_rms_m", "position_nees", "heading_rms_deg", "heading_nees")),
        "links": [],
        "tasks": [],
        "clocks": [],
        "nodes": [],
        "stale_exchanges": 0,
        "actuators": None,
        "autopilot": None,
        "takeovers": [],
        "autopilot_events": [],
        "faults": [],
        "model_range": None,
        "collisions": None,
        "debris": None,
        "operator": None,
        "perception": None,
        "pace": None,
        "graph": None,
        "odometry": None,
        "mapping": None,
        "obstacles": None,
        "companion": None,
        "warnings": [],
        "agents": [],
        "edges": [],
    }
    for report in reports:
        for key, value in report.items():
            known = sections.get(key)
            if isinstance(known, list):
                sections[key] = [*known, *value]
            elif isinstance(known, dict):
                sections[key] = {**known, **value}
            else:
                sections[key] = value
    return sections


def summary_of(profile: RunProfile, outcome: RunOutcome, sections: Sections) -> dict[str, Any]:
    """Return the content of summary.json; docs/recording.md explains the keys.

    sections: the merged reports of the nodes.
    """
    vessel = outcome.vessels[0]
    verdict = _verdict(profile, outcome, vessel, sections)
    sections = sections | {"warnings": [*sections["warnings"], *verdict.warnings]}
    return {
        **_head(profile, outcome, verdict.section(), {"wdri": profile_wdri(profile).wdri}),
        "driver": _driver(profile, vessel),
        **_vessel(profile, outcome, vessel, sections),
    }


OF_THE_GRAPH = ("agents", "edges")
"""Reports of the nodes that only `graph` uses."""
ONCE = ("pace", "debris", "operator")
"""Sections that a fleet has at the top only. The top also holds the host's and the world's part of `OF_THE_RUN`."""
OF_THE_RUN = ("tasks", "clocks", "warnings", *ONCE)


def fleet_summary(
    profiles: Sequence[RunProfile], outcome: RunOutcome, world: Sections, vessels: Sequence[Sections]
) -> dict[str, Any]:
    """Return the summary of a fleet: the run's keys at the top, and those of each vessel in `vessels`, by name.

    world: merged reports of the host and the nodes of the world. vessels: merged reports of each vessel.
    """
    parts, verdicts = {}, {}
    for profile, own, sections in zip(profiles, outcome.vessels, vessels, strict=True):
        judged = sections | {key: [*world[key], *sections[key]] for key in ("tasks", "clocks")}
        judged["pace"] = world["pace"]
        verdict = verdicts[profile.vessel] = _verdict(profile, outcome, own, judged)
        parts[profile.vessel] = {
            "technique": profile.technique,
            "system_id": profile.autopilot.system_id,
            "lost": own.lost,
            "verdict": verdict.section(),
            "wdri": profile_wdri(profile).wdri,
            "driver": _driver(profile, own),
            **{key: value for key, value in _vessel(profile, outcome, own, sections).items() if key not in ONCE},
        }
    failed = [name for name, sections in zip(verdicts, vessels, strict=True) if _controller_failures(sections)]
    verdict = _fleet_verdict(outcome, verdicts, failed)
    kinds = dict.fromkeys(profile.driver.kind for profile in profiles)
    driver = {"kind": ", ".join(kinds), "completed": outcome.completed, "moored_s": outcome.held_s}
    of_world = {key: value for key, value in world.items() if key in OF_THE_RUN or key not in merged([])}
    of_world["warnings"] = [*world["warnings"], *verdict.warnings]
    return {
        **_head(profiles[0], outcome, verdict.section(), {}),
        "driver": driver,
        **{key: _written(value) for key, value in of_world.items()},
        "vessels": parts,
    }


def _head(
    profile: RunProfile, outcome: RunOutcome, verdict: Mapping[str, Any], claimed: Mapping[str, Any]
) -> dict[str, Any]:
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
        "verdict": verdict,
        **claimed,
        "duration_s": outcome.duration_s,
        "physics": {"compiled": outcome.why_numpy is None, "why_numpy": outcome.why_numpy},
        "wall_s": outcome.wall_s,
        "real_time_factor": outcome.duration_s / outcome.wall_s if outcome.wall_s > 0 else None,
        **({"recording": [_file_section(file) for file in outcome.files]} if outcome.files else {}),
    }


def _file_section(file: RecordedFile) -> dict[str, Any]:
    spans = {"from_s": file.from_ns / 1e9, "until_s": file.until_ns / 1e9}
    return {"file": file.file, "size_bytes": file.size_bytes, **spans}


def _driver(profile: RunProfile, vessel: VesselOutcome) -> dict[str, Any]:
    return {"kind": profile.driver.kind, "completed": vessel.completed, "moored_s": vessel.held_s}


def _verdict(profile: RunProfile, outcome: RunOutcome, vessel: VesselOutcome, sections: Sections) -> Verdict:
    """Return the verdict on one vessel's part. The sections include the host's reports."""
    frozen = 0.0 < outcome.duration_s <= vessel.held_s
    ending = Ending.FINISHED if profile.vessel and vessel.completed else outcome.ending
    error = None if ending is Ending.FINISHED else outcome.error
    driver = profile.driver.kind
    stop = "" if vessel.completed else stop_text(sections["autopilot_events"], driver)
    why = why_text(ending, error, driver, vessel.completed, sections["mission"], frozen, stop)
    failures = _controller_failures(sections)
    timed = outcome.timed and not failures
    if failures:
        why += f"; {profile.autopilot.controller} failed at {failures} of its steps, and the outputs were neutral there"
    completed = vessel.completed and not failures
    if profile.clock.mode == "lockstep":
        return judge(ending, completed, timed, why, None)
    pace: PaceReport = sections["pace"]
    keys = ("tasks", "links", "clocks", "faults")
    figures = measured_figures(outcome.wall_s, pace, *(sections[key] for key in keys))
    return judge(ending, completed, timed, why, figures)


def _controller_failures(sections: Sections) -> int:
    """Count the steps at which the user's controller gave no answer. Such a run has failed, whatever its duration."""
    return sum(node.controller_failures for node in sections["nodes"])


def _fleet_verdict(outcome: RunOutcome, verdicts: Mapping[str, Verdict], failed: Sequence[str]) -> Verdict:
    """Return the verdict on the run.

    It is completed when all awaited vessels are, and in real time when all vessels were. The figures are the worst of
    the vessels.

    failed: names of the vessels with a failed controller.
    """
    awaited = [name for name, vessel in zip(verdicts, outcome.vessels, strict=True) if vessel.awaited]
    done = [name for name in awaited if verdicts[name].completed]
    named = [name for name in awaited if name not in done] if outcome.ending is Ending.FINISHED else failed
    told = [f"{name}: {verdicts[name].why}" for name in named]
    why = f"{len(done)} of {len(awaited)} vessels did their part" if awaited else "nothing was to be done"
    if outcome.ending is not Ending.FINISHED:
        why = f"{outcome.error if outcome.error else outcome.ending.value}; {why}"
    why += "".join(f"; {text}" for text in told[:3]) + (f"; and {len(told) - 3} more" if len(told) > 3 else "")
    every = [(name, verdict.figures) for name, verdict in verdicts.items() if verdict.figures is not None]
    completed = outcome.completed and not failed
    figures = worst_figures(every) if every else None
    return judge(outcome.ending, completed, outcome.timed and not failed, why, figures)


def _vessel(profile: RunProfile, outcome: RunOutcome, vessel: VesselOutcome, sections: Sections) -> dict[str, Any]:
    """Return the sections of one vessel, including those computed from several others."""
    written: dict[str, Any] = {}
    for key, value in sections.items():
        if key == "graph":
            edges = sections["edges"] if outcome.duration_s > 0 else []
            written[key] = graph_section(profile, sections["agents"], edges)
        elif key == "autopilot" and value is not None:
            written[key] = value.section(sections["tasks"])
        elif key not in OF_THE_GRAPH:
            written[key] = _written(value)
    return written


def _written(value: Any) -> Any:
    """Convert a value to plain JSON."""
    if isinstance(value, list):
        return [_written(one) for one in value]
    if isinstance(value, TaskTiming):
        return task_section(value)
    if isinstance(value, PaceReport):
        return asdict(value)
    return value.section() if hasattr(value, "section") else value


HOST, COMPANION = "PS1", "HC"


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on a run."""

    completed: bool
    """The driver did its task."""
    why: str
    """The reason, in words."""
    duration_asked: bool = False
    """The user gave the duration, and the run reached it."""
    real_time: bool | None = None
    """Whether the run kept real time; None in lockstep."""
    shortfalls: tuple[str, ...] = ()
    """Reasons why the run did not keep real time."""
    figures: RealTimeFigures | None = None
    """Measured figures behind `real_time`; None in lockstep."""

    @property
    def warnings(self) -> list[str]:
        """Texts for `warnings` of summary.json."""
        return [not_real_time(self.shortfalls)] if self.shortfalls else []

    def section(self) -> dict[str, Any]:
        """Return `verdict` of summary.json; docs/recording.md explains the keys."""
        figures = self.figures
        section: dict[str, Any] = {
            "completed": self.completed,
            "why": self.why,
            "duration_asked": self.duration_asked,
            "real_time": self.real_time,
            "shortfalls": list(self.shortfalls),
        }
        if figures is not None:
            control, link = figures.control, figures.link
            section |= {
                "physics_missed_share": None if figures.physics is None else figures.physics.share,
                "agent_missed_share": None if control is None else control.share,
                "agent_task": None if control is None else control.name,
                "lost_share": None if link is None else link.share,
                "link": None if link is None else link.name,
                **{key: getattr(figures, key) for key in ("stalls", "stalled_s", "longest_stall_s", "slipped_s")},
                "clock_steps": sum(steps for _, steps in figures.clock_steps),
            }
        return section


def measured_figures(
    length_s: float,
    pace: PaceReport,
    tasks: Sequence[TaskTiming],
    links: Sequence[LinkReport],
    clocks: Sequence[ClockReport],
    faults: Sequence[FaultReport],
) -> RealTimeFigures:
    """Return the figures that decide whether a run kept real time.

    A fault that loads an agent or moves its clock makes the agent late on purpose. The agent's cycles and clock are
    then not judged. The host's always are.
    """
    spared = any("agent" in fault.kind.split(", ") and fault.from_s is not None for fault in faults)
    # A companion skips clouds when it is busy. It has a separate count for them.
    agents = [task for task in tasks if task.node not in (HOST, COMPANION)]
    return RealTimeFigures(
        length_s=length_s,
        physics=worst([_misses(task) for task in tasks if task.node == HOST]),
        control=None if spared else worst([_misses(task) for task in agents]),
        link=worst_link(
            [
                LinkLosses(link.name, link.sent, max(link.lost - (link.impaired or 0), 0))
                for link in links
                if link.lost is not None and link.sent
            ]
        ),
        stood_s=sum(clock.stood_s for clock in clocks),
        clock_steps=() if spared else tuple((clock.node, clock.steps) for clock in clocks if clock.steps),
        **{key: value for key, value in asdict(pace).items() if key != "slips"},
    )


def worst_figures(vessels: Sequence[tuple[str, RealTimeFigures]]) -> RealTimeFigures:
    """Return the figures of a fleet: the worst of the vessels for figures per vessel. vessels: name and figures."""
    _, first = vessels[0]
    controls = [replace(own.control, name=f"{name}: {own.control.name}") for name, own in vessels if own.control]
    links = [replace(own.link, name=f"{name}: {own.link.name}") for name, own in vessels if own.link]
    return replace(
        first,
        control=worst(controls),
        link=worst_link(links),
        stood_s=max(own.stood_s for _, own in vessels),
        clock_steps=tuple((f"{clock} of {name}", steps) for name, own in vessels for clock, steps in own.clock_steps),
    )


def why_text(
    ending: Ending, error: str | None, driver: str, completed: bool, mission: Any, frozen: bool, stop: str = ""
) -> str:
    """Return how far a run got and why it ended.

    mission: `mission` of summary.json. frozen: the vessel was never released. stop: the text of `stop_text`.
    """
    total = mission["waypoints_total"] if mission else 0
    if driver in ("script", "replay"):
        done = f"the {driver} was {'' if completed else 'not '}played to its end"
    elif driver == "ros" and not (mission and mission["waypoints_reached"]):
        done = "nodes of ROS drove" if completed else "nodes of ROS could not drive"
    elif total:
        done = f"{mission['waypoints_reached']} of {total} waypoints"
    else:
        done = "no mission"
    if frozen and not completed:
        done += ", the vessel was never armed and stayed frozen"
    if stop:
        done = f"{stop}; {done}"
        if ending is Ending.DURATION:
            return done
    if ending is Ending.FINISHED:
        return done
    reason = error if ending is Ending.FAILED and error else ending.value
    return f"{reason}; {done}" if ending is Ending.FAILED or stop else f"{reason}, {done}"


SAILS_MISSIONS = ("mission", "ground-station")
"""Drivers that keep the vessel in AUTO. The other drivers change modes themselves, so only a failsafe stops their
vessel.
"""


def stop_text(events: Sequence[AutopilotEvent], driver: str) -> str:
    """Return the mode change, failsafe or fence that stopped the vessel, or an empty text. events: in their order.

    A vessel that is back in its former mode at the end was not stopped by the change.
    """
    stop: AutopilotEvent | None = None
    condition: AutopilotEvent | None = None
    for event in events:
        if event.event in ("failsafe", "fence limits speed"):
            condition = event
        elif event.event in ("failsafe over", "fence limit over"):
            condition = None
        elif stop is not None:
            back_in_mode = stop.event == event.event == "mode" and event.mode == stop.mode_before
            if back_in_mode or (stop.event != "mode" and event.event == "armed"):
                stop = None
        elif event.event in ("mode", "disarmed"):
            left_mission = event.mode_before == MISSION_MODE and driver in SAILS_MISSIONS
            if left_mission or event.reason:
                stop = event
    if stop is not None:
        reason = f" ({stop.reason.removesuffix(f', {stop.mode}')})" if stop.reason else ""
        by = stop.mode if stop.event == "mode" else "disarming"
        return f"stopped by {by}{reason} at {stop.at_s:.1f} s"
    if condition is None:
        return ""
    if condition.event == "fence limits speed":
        return f"avoidance has kept it at the fence since {condition.at_s:.1f} s"
    return f"failsafe active since {condition.at_s:.1f} s ({condition.reason})"


def judge(ending: Ending, completed: bool, timed: bool, why: str, figures: RealTimeFigures | None) -> Verdict:
    """Return the verdict. timed: the user gave the duration. figures: for a real-time run."""
    done = completed and ending not in (Ending.INTERRUPTED, Ending.FAILED)
    asked = timed and ending is Ending.DURATION
    if figures is None:
        return Verdict(done, why, asked)
    shortfalls = figures.shortfalls()
    return Verdict(done, why, asked, not shortfalls, shortfalls, figures)


def _misses(task: TaskTiming) -> TaskMissCount:
    return TaskMissCount(f"{task.node} {task.task}", task.cycles + task.skipped, task.missed)
