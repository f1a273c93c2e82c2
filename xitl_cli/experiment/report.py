"""What an experiment says: the paper's values beside ours, a sentence on every difference, and its figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Told = float | int | str | None
"""A value of the paper or of ours: a number, words, or None for what is not printed or was not measured."""


@dataclass(frozen=True, slots=True)
class PaperRow:
    """quantity: what is compared. paper, ours: in `unit`. difference: a sentence on how ours differs, and why."""

    quantity: str
    paper: Told
    ours: Told
    unit: str
    difference: str


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """name: of its files. caption: what it shows, and of the paper which. draw: on an empty figure of `size_in`."""

    name: str
    caption: str
    draw: Callable[[Figure], None]
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
    """For people: four figures, large numbers whole, `–` for what is not there."""
    if value is None or isinstance(value, str):
        return value or "–"
    return f"{value:.4g} {unit}".rstrip() if abs(value) < 10_000 else f"{value:.0f} {unit}".rstrip()
