"""Content of a page before conversion to HTML: of a report, of a plot of some signals, of a comparison."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.sections import Finding, Mark, Section, Severity
from xitl_cli.logs.model.text import duration_text
from xitl_cli.logs.report.causes import group_findings
from xitl_cli.logs.report.file_report import FileFinding
from xitl_cli.logs.report.model import Overview, Report
from xitl_cli.logs.report.signal_data import HeldLog
from xitl_cli.logs.report.wording import FORMAT_NAMES


@dataclass(frozen=True, slots=True)
class FileCard:
    """A file in the header of a page."""

    name: str
    facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = ()
    """Missing or doubtful data."""
    degraded: bool | None = None
    """None if unknown."""


@dataclass(frozen=True, slots=True)
class PagePart:
    """A section, the time line of its stamps, and the label of its file if there are several."""

    section: Section
    time_line: TimeLine
    label: str = ""


@dataclass(frozen=True, slots=True)
class PageFinding:
    """A finding, and the number of its part of the page."""

    finding: Finding
    part: int


@dataclass(frozen=True, slots=True)
class PageGroup:
    """A finding in the header of a page, and its consequences."""

    cause: PageFinding
    consequences: tuple[PageFinding, ...] = ()

    @property
    def worst(self) -> Severity:
        """Highest severity of the group."""
        return max(placed.finding.severity for placed in (self.cause, *self.consequences))


@dataclass(frozen=True, slots=True)
class PageMark:
    """A mark across all time plots, from `from_s` to `until_s` (equal: an instant) on the page's time line."""

    kind: Literal["mode", "armed", "finding"]
    from_s: float
    until_s: float
    text: str
    severity: Severity = Severity.NOTICE


@dataclass(frozen=True, slots=True)
class Replay:
    """A page that replays the logs in 3D, for display next to the map. Another package creates it."""

    html: str = ""
    """Empty if there is none; `note` then gives the reason."""
    note: str = ""
    late_s: float = 0.0
    """Offset of its seconds ahead of those of the report's page."""


@dataclass(frozen=True, slots=True)
class Page:
    """Content of a page."""

    title: str
    subtitle: str
    parts: tuple[PagePart, ...]
    cards: tuple[FileCard, ...] = ()
    notices: tuple[str, ...] = ()
    """Sentences about the whole page, such as a file that could not be opened."""
    marks: tuple[PageMark, ...] = ()
    overview: Overview | None = None
    groups: tuple[PageGroup, ...] | None = None
    """Findings of its header by cause. None: findings are not grouped, the most severe first."""
    signals: tuple[HeldLog, ...] = ()
    """Data of the signal picker."""
    replay: Replay | None = None

    @property
    def grouped(self) -> tuple[PageGroup, ...]:
        """Findings of all parts, grouped by cause if causes are known."""
        if self.groups is not None:
            return self.groups
        every = [
            PageGroup(PageFinding(finding, number))
            for number, part in enumerate(self.parts)
            for finding in part.section.findings
        ]
        return tuple(sorted(every, key=lambda group: -group.worst))


_MOST_MARKS = 400


def report_page(report: Report) -> Page:
    several = len(report.files) > 1
    parts = tuple(
        PagePart(placed.section, placed.file.time_line, placed.file.name if several else "")
        for placed in report.sections
    )
    notices = [refusal.sentence for refusal in report.refusals]
    notices += [f"{file.name}: {failure.sentence}" for file in report.files for failure in file.failures]
    overview = report.overview
    shown = overview.plots or overview.tracks or overview.modes or overview.armed or overview.lacks
    marks: list[PageMark] = []
    for file_finding in report.findings:
        finding, line = file_finding.finding, file_finding.file.time_line
        if finding.severity == Severity.OK:
            continue
        for evidence in finding.evidence:
            if evidence.at_ns is None or len(marks) >= _MOST_MARKS:
                continue
            from_s = line.second(evidence.at_ns)
            until_s = from_s if evidence.until_ns is None else max(from_s, line.second(evidence.until_ns))
            marks.append(PageMark("finding", from_s, until_s, finding.sentence, finding.severity))
    cards = []
    for file in report.files:
        size = f"{file.health.size_bytes / 1e6:.1f} MB, {file.health.records} records"
        facts = (
            ("vehicle", file.vehicle),
            ("duration", "" if file.duration_s is None else duration_text(file.duration_s)),
            ("format", f"{FORMAT_NAMES[file.format]}, {size}"),
            ("time line", file.time_line.sentence if several else ""),
        )
        known = tuple((label, value) for label, value in facts if value)
        cards.append(FileCard(file.name, known, file.notes, file.health.degraded))
    part_numbers = {(id(placed.file), id(placed.section)): number for number, placed in enumerate(report.sections)}

    def on_page(placed: FileFinding) -> PageFinding:
        return PageFinding(placed.finding, part_numbers[id(placed.file), id(placed.section)])

    groups = tuple(
        PageGroup(on_page(group.cause), tuple(map(on_page, group.consequences))) for group in group_findings(report)
    )
    return Page(
        " + ".join(file.name for file in report.files) or "no log",
        "",
        parts,
        tuple(cards),
        tuple(notices),
        (*page_marks(overview), *marks),
        overview if shown else None,
        groups,
        report.signals,
    )


def page_marks(overview: Overview) -> tuple[PageMark, ...]:
    """Modes and arming as marks across all time plots."""
    kinds: dict[Literal["mode", "armed"], tuple[Mark, ...]] = {"mode": overview.modes, "armed": overview.armed}
    return tuple(
        PageMark(kind, mark.at_ns * 1e-9, (mark.at_ns if mark.until_ns is None else mark.until_ns) * 1e-9, mark.text)
        for kind, marks in kinds.items()
        for mark in marks
    )
