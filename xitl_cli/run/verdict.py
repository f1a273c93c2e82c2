"""The verdict on a run: whether it did its task, and whether a real-time run kept real time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from agent.mavlink.modes import MISSION_MODE
from xitl_cli.logs.signals.real_time import (
    LinkLosses,
    RealTimeFigures,
    TaskMissCount,
    not_real_time,
    worst,
    worst_link,
)
from xitl_cli.record.topics import AutopilotEvent, LinkReport, PaceReport, TaskTiming
from xitl_cli.run.core.reports import ClockReport, Ending, FaultReport

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
