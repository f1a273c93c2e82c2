"""Results of an analysis, answers first, in one form for the terminal, for --json and for the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

MOST_GRID_ROWS = 500

Value = str | int | float | bool | None
"""None means unknown. A value is never NaN."""


class Severity(IntEnum):
    """ok: checked, no problem. notice: useful to know. warning: needs a look. critical: the run is not valid as it
    seems.
    """

    OK = 0
    NOTICE = 1
    WARNING = 2
    CRITICAL = 3


@dataclass(frozen=True, slots=True)
class Evidence:
    """Place in a log that shows a finding."""

    message: str
    """Message name as in the log."""
    field: str | None = None
    """Field name as in the log."""
    at_ns: int | None = None
    """On the log's own time."""
    until_ns: int | None = None
    """On the log's own time."""
    value: str | None = None


@dataclass(frozen=True, slots=True)
class Finding:
    """One result of an analysis."""

    key: str
    """Stable name for machines ("scheduler.long_loops")."""
    severity: Severity
    sentence: str
    """Statement for people, with its figure and unit."""
    evidence: tuple[Evidence, ...] = ()
    next_step: str = ""
    """Recommended action; "" only if the severity is OK."""

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
    """One figure of a section."""

    key: str
    """Stable name for machines, with the unit ("longest_loop_us")."""
    label: str
    """For people."""
    value: Value
    unit: str = ""
    """For people."""


@dataclass(frozen=True, slots=True)
class Grid:
    """A table of the report. Each row has one value for each column."""

    key: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Value, ...], ...]

    @classmethod
    def limited(cls, key: str, title: str, columns: tuple[str, ...], rows: Sequence[tuple[Value, ...]]) -> Grid:
        """Return a grid with at most 500 rows. The title reports omitted rows."""
        if len(rows) > MOST_GRID_ROWS:
            title = f"{title} (the first {MOST_GRID_ROWS} of {len(rows)})"
        return cls(key, title, columns, tuple(rows[:MOST_GRID_ROWS]))


@dataclass(frozen=True, slots=True)
class Trace:
    """One line of a plot. The code that draws it thins it."""

    name: str
    x: NDArray[np.int64] | NDArray[np.float64]
    """int64 ns on the log's own time in a time plot, else numbers."""
    y: NDArray[np.float64]
    style: Literal["line", "steps", "points"] = "line"
    """"steps" holds a value until the next."""


@dataclass(frozen=True, slots=True)
class Mark:
    """An instant or a time span that a plot marks with a line or a band."""

    at_ns: int
    text: str
    until_ns: int | None = None
    severity: Severity = Severity.NOTICE


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot of a section."""

    key: str
    title: str
    y_label: str
    traces: tuple[Trace, ...]
    kind: Literal["time", "xy", "loglog", "map", "figure"] = "time"
    """"time": x is the log's time, linked with all other time plots of the report. "map": x is east, y is north (m),
    with axes of equal scale. "figure": the plot is `figure`, without traces.
    """
    x_label: str = ""
    marks: tuple[Mark, ...] = ()
    figure: Mapping[str, Any] | None = None
    """`data` and `layout` of plotly, as JSON types; a colour such as "--trace1" is a colour of the page."""


@dataclass(frozen=True, slots=True)
class Section:
    """Result of one analysis."""

    key: str
    title: str
    facts: tuple[Fact, ...] = ()
    findings: tuple[Finding, ...] = ()
    grids: tuple[Grid, ...] = ()
    plots: tuple[Plot, ...] = ()
    lacks: tuple[str, ...] = ()
    """Checks that the log has no data for, each a sentence with the setting that logs the data."""

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
    """All findings, most severe first; findings of equal severity keep the order of the sections."""
    return sorted((finding for section in sections for finding in section.findings), key=lambda f: -f.severity)
