"""What a run knows of another autopilot, for the summary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from xitl_cli.record.records import Task
from xitl_cli.run.nodes.milestones import Milestones
from xitl_cli.run.nodes.scheduler import SchedulerRecord

HOST = "PS1"


@dataclass(frozen=True, slots=True)
class AutopilotReport:
    """firmware, vehicle: as it says itself, empty where it never did.

    milestones: see there. bridge: counts of XITL_BRIDGE_STATUS by name, empty where none came. program: what was
    started here, None for one that somebody else started. log: whether its DataFlash log was collected. scheduler: from
    that log; only of one that runs on a real clock (None: not known) it tells of processor time.
    utc_offset_s: its UTC less ours.
    """

    kind: str
    firmware: str = ""
    vehicle: str = ""
    milestones: Milestones = field(default_factory=Milestones)
    bridge: dict[str, int] = field(default_factory=dict)
    program: str | None = None
    log: bool = False
    scheduler: SchedulerRecord | None = None
    real_clock: bool | None = None
    utc_offset_s: float | None = None


def autopilot_section(report: AutopilotReport, tasks: Sequence[Task]) -> dict[str, Any]:
    """`autopilot` of summary.json; docs/recording.md explains the keys."""
    times, agent = report.milestones, [task for task in tasks if task.node != HOST]
    return {
        "kind": report.kind,
        "firmware": report.firmware or None,
        "vehicle": report.vehicle or None,
        "program": report.program,
        "time_to_heartbeat_s": times.heartbeat_s,
        "time_to_origin_s": times.origin_s,
        "time_to_ready_s": times.ready_s,
        "time_to_arm_s": times.armed_s,
        "time_to_motion_s": times.motion_s,
        "bridge": report.bridge or None,
        "log": report.log,
        "clock": None if report.real_clock is None else "real" if report.real_clock else "simulated",
        "utc_offset_s": report.utc_offset_s,
        "scheduler": None if report.scheduler is None else _scheduler(report.scheduler),
        "agent": {"cycles": sum(task.cycles for task in agent), "missed": sum(task.missed for task in agent)},
    }


def _scheduler(record: SchedulerRecord) -> dict[str, Any]:
    return {**asdict(record), "fields": list(record.fields)}
