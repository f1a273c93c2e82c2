"""A report at a terminal: answers first, at 80 columns and without colour."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.text import Text

from xitl_cli.logs.report.columns import grid_lines
from xitl_cli.logs.report.instants import evidence_text
from xitl_cli.logs.report.model import FileReport, Found, Report
from xitl_cli.logs.report.words import (
    FORMATS,
    NAMES,
    counted,
    sentence_text,
    value_text,
)
from xitl_cli.logs.sections import Fact, Grid, Section, Severity
from xitl_cli.logs.text import duration_text, printable

_STYLES = {Severity.CRITICAL: "bold red", Severity.WARNING: "yellow", Severity.NOTICE: "cyan", Severity.OK: "green"}
_INDENT = 10
_MOST_EVIDENCE = 3
_MOST_ROWS = 8
_GRID_INDENT = 4
_LONGEST_LABEL = 34
_LEAST_WIDTH = 20
_MOST_LACKS = 4


def show(console: Console, report: Report) -> None:
    """Every file in a line, findings worst first, then the facts of each section with short tables."""
    for file in report.files:
        _head(console, file, several=len(report.files) > 1)
    found = [each for each in report.found if each.finding.severity > Severity.OK]
    fine = [each for each in report.found if each.finding.severity == Severity.OK]
    several = len(report.files) > 1
    if report.found:
        _line(console, "")
        _line(console, Text(sentence_text(counted([each.finding.severity for each in report.found])), style="bold"))
    for each in found:
        _line(console, "")
        _finding(console, each, several)
    if fine:
        _line(console, "")
    for sentence in dict.fromkeys(each.finding.sentence for each in fine):
        of = [each.file.name for each in fine if each.finding.sentence == sentence]
        text = sentence_text(sentence) + (f" ({', '.join(of)})" if several else "")
        _hanging(console, NAMES[Severity.OK], _STYLES[Severity.OK], _plain(text))
    for file in report.files:
        for section in file.sections:
            show_section(console, section, file.name if several else "")
    for lack in report.overview.lacks:
        _hanging(console, "lacks", "dim", _plain(sentence_text(lack)))


def _head(console: Console, file: FileReport, several: bool) -> None:
    health = file.health
    parts = [file.vehicle]
    parts.append("" if file.duration_s is None else duration_text(file.duration_s))
    parts.append(FORMATS[file.format])
    line = _plain(file.name, style="bold")
    line.append_text(_plain(f"  {', '.join(part for part in parts if part)}"))
    line.append(", degraded" if health.degraded else ", whole", style="yellow" if health.degraded else "")
    _hanging(console, "", "", line, indent=0)
    for sentence in file.notes:
        _hanging(console, "damage" if health.degraded else "note", "yellow", _plain(sentence))
    if several and file.time_line.sentence:
        _hanging(console, "time", "dim", _plain(file.time_line.sentence))
    for failure in file.failures:
        _hanging(console, "failed", "bold red", _plain(failure.sentence))


def _finding(console: Console, found: Found, several: bool) -> None:
    finding = found.finding
    place = f"{found.section.title} ({found.file.name})" if several else found.section.title
    _hanging(
        console, NAMES[finding.severity].upper(), _STYLES[finding.severity], _plain(sentence_text(finding.sentence))
    )
    evidence = [evidence_text(each, found.file.time_line) for each in finding.evidence[:_MOST_EVIDENCE]]
    if len(finding.evidence) > _MOST_EVIDENCE:
        evidence.append(f"and {len(finding.evidence) - _MOST_EVIDENCE} more")
    _hanging(console, "", "", _plain(f"{place}: {'; '.join(evidence)}" if evidence else place, style="dim"))
    if finding.next_step:
        _hanging(console, "", "", _plain(f"→ {sentence_text(finding.next_step)}"))


def show_section(console: Console, section: Section, label: str = "") -> None:
    if not (section.facts or section.grids or section.lacks):
        return
    _line(console, "")
    title = _plain(section.title, style="bold")
    if label:
        title.append(f"  {label}", style="not bold dim")
    _line(console, title)
    if section.facts:
        _facts(console, section.facts)
    for grid in section.grids:
        if grid.rows:
            _grid(console, grid)
    for lack in section.lacks[:_MOST_LACKS]:
        _hanging(console, "lacks", "dim", _plain(sentence_text(lack)))
    if len(section.lacks) > _MOST_LACKS:
        _hanging(console, "", "", Text(f"and {len(section.lacks) - _MOST_LACKS} more", style="dim"))


def _facts(console: Console, facts: Sequence[Fact]) -> None:
    width = min(max(len(fact.label) for fact in facts), _LONGEST_LABEL)
    for fact in facts:
        unit = f" {fact.unit}" if fact.unit and fact.value is not None else ""
        text = _plain(value_text(fact.value, fact.label) + unit)
        _hanging(console, f"  {printable(sentence_text(fact.label))}", "", text, indent=width + 4)


def _grid(console: Console, grid: Grid) -> None:
    _line(console, f"  {printable(sentence_text(grid.title))}", "dim")
    for line in grid_lines(grid, console.width - _GRID_INDENT, _MOST_ROWS):
        _line(console, f"{'':{_GRID_INDENT}}{line}")


def _hanging(console: Console, word: str, style: str, text: Text, indent: int = _INDENT) -> None:
    """A word, and beside it the text in as many lines as it takes."""
    lines = text.wrap(console, max(console.width - indent, _LEAST_WIDTH))
    for number, line in enumerate(lines):
        line.rstrip()
        head = "" if number else word
        if head and len(head) >= indent:  # a label too long to stand beside its text
            _line(console, head, style)
            head = ""
        console.print(Text(f"{head:<{indent}}", style=style) + line, highlight=False, soft_wrap=True)


def _plain(text: str, style: str = "") -> Text:
    return Text(printable(text), style=style)


def _line(console: Console, text: str | Text, style: str = "") -> None:
    console.print(text, style=style, highlight=False, markup=False, soft_wrap=True)
