"""A report on a terminal: findings first, at 80 columns and without colour."""

from __future__ import annotations

import textwrap

from rich.console import Console
from rich.text import Text

from xitl_cli.logs.model.sections import Grid, Section, Severity
from xitl_cli.logs.model.text import duration_text, plural, printable
from xitl_cli.logs.report import wording
from xitl_cli.logs.report.causes import FindingGroup, group_findings
from xitl_cli.logs.report.file_report import FileFinding
from xitl_cli.logs.report.model import Report

_APART = 2
_WIDE = 24
_LEAST_BELOW = 20


def grid_lines(grid: Grid, width: int, most_rows: int) -> list[str]:
    """Header, rows, and the number of omitted rows. Lines are at most `width` long if words allow it.

    If not all columns fit, wide text goes below its row, and so do columns from the right.
    """
    shown = [
        [printable(wording.value_text(value, name)) for name, value in zip(grid.columns, row, strict=False)]
        for row in grid.rows[:most_rows]
    ]
    shown = [row + [""] * (len(grid.columns) - len(row)) for row in shown]
    heads = [printable(name) for name in grid.columns]
    widths = [
        max([*map(len, head.split()), *(len(row[index]) for row in shown)], default=0)
        for index, head in enumerate(heads)
    ]
    right = [wording.is_numeric(grid, index) for index in range(len(heads))]
    beside, below = list(range(len(heads))), []
    if _total(widths, beside) > width:
        below = [index for index in beside[1:] if not right[index] and widths[index] > _WIDE]
        beside = [index for index in beside if index not in below]
    narrow: list[int] = []
    while len(beside) > 1 and _total(widths, beside) > width:
        narrow.insert(0, beside.pop())
    for index in beside:  # a heading in one line, if it fits
        widths[index] += max(0, min(len(heads[index]) - widths[index], width - _total(widths, beside)))
    wrapped = [textwrap.wrap(heads[index], widths[index] or 1) or [""] for index in beside]
    rows = max(map(len, wrapped))
    at_the_foot = [[""] * (rows - len(words)) + words for words in wrapped]
    lines = [_table_line([words[row] for words in at_the_foot], widths, right, beside) for row in range(rows)]
    for row in shown:
        lines.append(_table_line([row[index] for index in beside], widths, right, beside))
        under = [", ".join(f"{heads[index]} {row[index]}" for index in narrow if row[index])]
        for text in (*under, *(f"{heads[index]}: {row[index]}" for index in below if row[index])):
            lines += textwrap.wrap(
                text, max(width, _LEAST_BELOW), initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False
            )
    left_out = len(grid.rows) - len(shown)
    return [*lines, f"({plural(left_out, 'more row')} in --report and --json)"] if left_out > 0 else lines


def _total(widths: list[int], columns: list[int]) -> int:
    return sum(widths[index] for index in columns) + _APART * (len(columns) - 1)


def _table_line(cells: list[str], widths: list[int], right: list[bool], columns: list[int]) -> str:
    padded = (
        cell.rjust(widths[index]) if right[index] else cell.ljust(widths[index])
        for cell, index in zip(cells, columns, strict=True)
    )
    return (" " * _APART).join(padded).rstrip()


_STYLES = {Severity.CRITICAL: "bold red", Severity.WARNING: "yellow", Severity.NOTICE: "cyan", Severity.OK: "green"}
_INDENT = 10
_MOST_EVIDENCE = 3
_MOST_ROWS = 8
_GRID_INDENT = 4
_LONGEST_LABEL = 34
_LEAST_WIDTH = 20
_MOST_LACKS = 4


def show(console: Console, report: Report, *, sections: bool = True) -> None:
    """Print every file on a line, findings with the most severe first, then, if `sections`, their facts and short
    tables."""
    several = len(report.files) > 1
    for file in report.files:
        health = file.health
        duration = "" if file.duration_s is None else duration_text(file.duration_s)
        parts = (file.vehicle, duration, wording.FORMAT_NAMES[file.format])
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
    groups = group_findings(report)
    fine = [placed for placed in report.findings if placed.finding.severity == Severity.OK]
    if report.findings:
        verdict = wording.verdict([group.worst for group in groups], len(report.findings))
        _line(console, "")
        _line(console, Text(wording.sentence_text(verdict), style="bold"))
    for group in groups:
        if group.worst > Severity.OK:
            _line(console, "")
            _group(console, group, several)
    if fine:
        _line(console, "")
    for sentence in dict.fromkeys(placed.finding.sentence for placed in fine):
        names = [placed.file.name for placed in fine if placed.finding.sentence == sentence]
        text = wording.sentence_text(sentence) + (f" ({', '.join(names)})" if several else "")
        _hanging(console, wording.SEVERITY_NAMES[Severity.OK], _STYLES[Severity.OK], _plain(text))
    if not sections:
        return
    for file in report.files:
        for section in file.sections:
            show_section(console, section, file.name if several else "")
    for lack in report.overview.lacks:
        _hanging(console, "lacks", "dim", _plain(wording.sentence_text(lack)))


def _group(console: Console, group: FindingGroup, several: bool) -> None:
    """Print a cause as a finding, and below it its consequences without their next steps."""
    finding = group.cause.finding
    _hanging(
        console,
        wording.SEVERITY_NAMES[finding.severity].upper(),
        _STYLES[finding.severity],
        _plain(wording.sentence_text(finding.sentence)),
    )
    _hanging(console, "", "", _plain(_place(group.cause, several), style="dim"))
    if finding.next_step:
        _hanging(console, "", "", _plain(f"→ {wording.sentence_text(finding.next_step)}"))
    if not group.consequences:
        return
    _hanging(console, "", "", _plain("What follows from it:"))
    for each in group.consequences:
        name = wording.SEVERITY_NAMES[each.finding.severity]
        _hanging(
            console,
            f"{'':{_INDENT}}{name.upper()}",
            _STYLES[each.finding.severity],
            _plain(wording.sentence_text(each.finding.sentence)),
            indent=2 * _INDENT,
        )
        _hanging(console, "", "", _plain(_place(each, several), style="dim"), indent=2 * _INDENT)


def _place(found: FileFinding, several: bool) -> str:
    """Section, file and evidence of a finding."""
    finding = found.finding
    place = f"{found.section.title} ({found.file.name})" if several else found.section.title
    evidence = [wording.evidence_text(each, found.file.time_line) for each in finding.evidence[:_MOST_EVIDENCE]]
    if len(finding.evidence) > _MOST_EVIDENCE:
        evidence.append(f"and {len(finding.evidence) - _MOST_EVIDENCE} more")
    return f"{place}: {'; '.join(evidence)}" if evidence else place


def show_section(console: Console, section: Section, label: str = "") -> None:
    if not (section.facts or section.grids or section.lacks):
        return
    _line(console, "")
    title = _plain(section.title, style="bold")
    if label:
        title.append(f"  {label}", style="not bold dim")
    _line(console, title)
    if section.facts:
        width = min(max(len(fact.label) for fact in section.facts), _LONGEST_LABEL)
        for fact in section.facts:
            unit = f" {fact.unit}" if fact.unit and fact.value is not None else ""
            text = _plain(wording.value_text(fact.value, fact.label) + unit)
            _hanging(console, f"  {printable(wording.sentence_text(fact.label))}", "", text, indent=width + 4)
    for grid in section.grids:
        if grid.rows:
            _line(console, f"  {printable(wording.sentence_text(grid.title))}", "dim")
            for line in grid_lines(grid, console.width - _GRID_INDENT, _MOST_ROWS):
                _line(console, f"{'':{_GRID_INDENT}}{line}")
    for lack in section.lacks[:_MOST_LACKS]:
        _hanging(console, "lacks", "dim", _plain(wording.sentence_text(lack)))
    if len(section.lacks) > _MOST_LACKS:
        _hanging(console, "", "", Text(f"and {len(section.lacks) - _MOST_LACKS} more", style="dim"))


def _hanging(console: Console, word: str, style: str, text: Text, indent: int = _INDENT) -> None:
    """Print a word, and next to it the text in as many lines as needed."""
    lines = text.wrap(console, max(console.width - indent, _LEAST_WIDTH))
    for number, line in enumerate(lines):
        line.rstrip()
        head = "" if number else word
        if head and len(head) >= indent:  # the label is too long for the column next to the text
            _line(console, head, style)
            head = ""
        console.print(Text(f"{head:<{indent}}", style=style) + line, highlight=False, soft_wrap=True)


def _plain(text: str, style: str = "") -> Text:
    return Text(printable(text), style=style)


def _line(console: Console, text: str | Text, style: str = "") -> None:
    console.print(text, style=style, highlight=False, markup=False, emoji=False, soft_wrap=True)
