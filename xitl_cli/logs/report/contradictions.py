"""Removal of OK findings that another finding of the run contradicts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from xitl_cli.logs.model.sections import Finding, Section, Severity
from xitl_cli.logs.report.causes import is_kind
from xitl_cli.logs.report.file_report import FileReport

CONTRADICTED = {
    "control.followed": (
        "control", "actuation.thrust_loss", "actuation.reversed", "actuation.stuck", "actuation.unanswered",
        "actuation.gnss_drift", "sensors.field_step", "sensors.gyro_bias",
    ),
    "attitude.upright": ("attitude.overturned", "attitude.leaning", "attitude.impact", "attitude.contact"),
    "links.whole": ("links.loss",),
    "links.sequence_whole": ("links.sequence_loss",),
    "scheduler.on_time": ("scheduler.long_loops", "scheduler.deadlines_missed", "scheduler.late_tasks"),
    "tasks.in_time": ("tasks.overruns",),
}  # fmt: skip
"""OK findings, and the kinds of findings that contradict them.

If a faulty sensor misled the estimate, good tracking by the estimate is not good tracking on the water.
"""


def without_contradictions(files: Iterable[FileReport]) -> tuple[FileReport, ...]:
    """The files without OK findings that another finding of this run contradicts."""
    files = tuple(files)
    bad = {
        finding.key
        for file in files
        for section in file.sections
        for finding in section.findings
        if finding.severity >= Severity.WARNING
    }
    return tuple(replace(file, sections=tuple(_sound(section, bad) for section in file.sections)) for file in files)


def _sound(section: Section, bad: set[str]) -> Section:
    return replace(section, findings=tuple(each for each in section.findings if not is_contradicted(each, bad)))


def is_contradicted(finding: Finding, bad: Iterable[str]) -> bool:
    """Whether an OK finding is contradicted by a finding with one of these keys."""
    kinds = CONTRADICTED.get(finding.key, ()) if finding.severity == Severity.OK else ()
    return any(is_kind(key, kinds) for key in bad)
