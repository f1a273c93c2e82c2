"""Results of an experiment: the paper's values and ours, a sentence on every difference, and figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, field
from typing import TYPE_CHECKING, Any

from sim_core.dataclass import dataclass

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Told = float | int | str | None
"""A value of the paper or of xitl: a number, words, or None when it is not printed or not measured."""


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One row of the comparison."""

    quantity: str
    """Compared quantity."""
    paper: Told
    """Value of the paper, in `unit`."""
    ours: Told
    """Our value, in `unit`."""
    unit: str
    difference: str
    """Sentence on the difference and its reason."""


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """A figure of an experiment."""

    name: str
    """Name of its files."""
    caption: str
    """Content, and the figure of the paper that it corresponds to."""
    draw: Callable[[Figure], None]
    """Draws on an empty figure of `size_in`."""
    size_in: tuple[float, float] = (7.0, 4.6)


@dataclass(frozen=True, slots=True)
class ExperimentReport:
    """The results of one experiment of the paper.

    section: number in the paper. notes: sentences that name the replacements for parts of the paper's setup. runs:
    directories of the runs. completed: whether every run completed its task. details: additional values for programs.
    """

    section: str
    title: str
    notes: tuple[str, ...]
    rows: tuple[PaperRow, ...]
    figures: tuple[PaperFigure, ...] = ()
    runs: tuple[str, ...] = ()
    completed: bool = True
    details: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """The same as plain values for `--json`; figures by their names."""
        return {
            "section": self.section,
            "title": self.title,
            "completed": self.completed,
            "notes": list(self.notes),
            "table": [asdict(row) for row in self.rows],
            "figures": {figure.name: figure.caption for figure in self.figures},
            "directories": list(self.runs),
            **self.details,
        }


def told_text(value: Told, unit: str = "") -> str:
    """Return text for users: four digits, large numbers whole, `–` for a missing value."""
    if value is None or isinstance(value, str):
        return value or "–"
    return f"{value:.4g} {unit}".rstrip() if abs(value) < 10_000 else f"{value:.0f} {unit}".rstrip()
