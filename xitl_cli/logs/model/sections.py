"""What an analysis says: answers first. One form for the terminal, for --json and for the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

MOST_GRID_ROWS = 500

Value = str | int | float | bool | None
"""None: not known. Never NaN."""


class Severity(IntEnum):
    """ok: looked at, and fine. notice: worth knowing. warning: look into it. critical: the run is not what it seems."""

    OK = 0
    NOTICE = 1
    WARNING = 2
    CRITICAL = 3


@dataclass(frozen=True, slots=True)
class Evidence:
    """Where a finding can be seen: `message` and `field` as the log calls them, and when, on the log's own time."""

    message: str
    field: str | None = None
    at_ns: int | None = None
    until_ns: int | None = None
    value: str | None = None


@dataclass(frozen=True, slots=True)
class Finding:
    """key: stable name for machines ("scheduler.long_loops"). sentence: what was found, with its figure and unit.

    next_step: what the reader should do; "" only when the severity is OK.
    """

    key: str
    severity: Severity
    sentence: str
    evidence: tuple[Evidence, ...] = ()
    next_step: str = ""

    @classmethod
    def ok(cls, key: str, sentence: str, evidence: tuple[Evidence, ...] = ()) -> Finding:
        return cls(key, Severity.OK, sentence, evidence)

    @classmethod
    def notice(cls, key: str, sentence: str, evidence: tuple[Evidence, ...], next_step: str) -> Finding:
        return cls(key, Severity.NOTICE, sentence, evidence, next_step)

    @classmethod
    def warning(cls, key: str, sentence: str, evidence: tuple[Evidence, ...], next_step: str) -> Finding:
        return cls(key, Severity.WARNING, sentence, evidence, next_step)

    @classmethod
    def critical(cls, key: str, sentence: str, evidence: tuple[Evidence, ...], next_step: str) -> Finding:
        return cls(key, Severity.CRITICAL, sentence, evidence, next_step)


@dataclass(frozen=True, slots=True)
class Fact:
    """key: stable name for machines, with its unit ("longest_loop_us"). label, unit: for people."""

    key: str
    label: str
    value: Value
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Grid:
    """A table of the report: a row of values for each of its columns."""

    key: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Value, ...], ...]

    @classmethod
    def limited(cls, key: str, title: str, columns: tuple[str, ...], rows: Sequence[tuple[Value, ...]]) -> Grid:
        """With at most 500 rows; the title says so when there were more."""
        if len(rows) > MOST_GRID_ROWS:
            title = f"{title} (the first {MOST_GRID_ROWS} of {len(rows)})"
        return cls(key, title, columns, tuple(rows[:MOST_GRID_ROWS]))


@dataclass(frozen=True, slots=True)
class Trace:
    """One line of a plot. x: int64 ns on the log's own time in a plot over time, else numbers. Who draws it thins it.

    style: line, steps (holds until the next), or points.
    """

    name: str
    x: NDArray[np.int64] | NDArray[np.float64]
    y: NDArray[np.float64]
    style: Literal["line", "steps", "points"] = "line"


@dataclass(frozen=True, slots=True)
class Mark:
    """An instant, or a span of time, worth a line or a band across a plot."""

    at_ns: int
    text: str
    until_ns: int | None = None
    severity: Severity = Severity.NOTICE


@dataclass(frozen=True, slots=True)
class Plot:
    """kind time: x is the log's time, linked with all others of the report. loglog, xy: axes of their own.

    map: x is east, y is north (m), axes of equal scale. figure: what `figure` says, and no traces.
    """

    key: str
    title: str
    y_label: str
    traces: tuple[Trace, ...]
    kind: Literal["time", "xy", "loglog", "map", "figure"] = "time"
    x_label: str = ""
    marks: tuple[Mark, ...] = ()
    figure: Mapping[str, Any] | None = None
    """`data` and `layout` as plotly has them, as JSON knows them; a colour such as "--trace1" is one of the page's."""


@dataclass(frozen=True, slots=True)
class Section:
    """lacks: what could not be judged since the log does not hold it, each a sentence with what to set to log it."""

    key: str
    title: str
    facts: tuple[Fact, ...] = ()
    findings: tuple[Finding, ...] = ()
    grids: tuple[Grid, ...] = ()
    plots: tuple[Plot, ...] = ()
    lacks: tuple[str, ...] = ()

    @classmethod
    def joined(cls, key: str, title: str, parts: Iterable[Section | None]) -> Section:
        """All facts, findings, grids, plots and lacks of these parts, in their order."""
        known = [part for part in parts if part is not None]
        return cls(
            key,
            title,
            tuple(fact for part in known for fact in part.facts),
            tuple(finding for part in known for finding in part.findings),
            tuple(grid for part in known for grid in part.grids),
            tuple(plot for part in known for plot in part.plots),
            tuple(lack for part in known for lack in part.lacks),
        )

    @property
    def worst(self) -> Severity:
        return max((finding.severity for finding in self.findings), default=Severity.OK)


def by_severity(sections: Sequence[Section]) -> list[Finding]:
    """All findings, the worst first, otherwise in the order of the sections."""
    return sorted((finding for section in sections for finding in section.findings), key=lambda f: -f.severity)
