"""Scores of `xitl logs analyze` on runs with known causes, and their tables in Markdown."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

NONE, OTHER = "none", "other"


@dataclass(frozen=True, slots=True)
class Named:
    """A cause that the analysis named: the first finding of a group with at least a warning."""

    key: str
    at_s: float | None
    """Its first evidence; None without an instant."""
    right: bool
    """Whether it names the injected cause."""
    effect: bool = False
    """Whether it is a permitted effect of the cause."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One analysed run."""

    case: str
    group: str
    """NONE for a clean run."""
    seed: int
    onset_s: float | None
    """None for a clean run, and for a cause that holds from the start of the run."""
    named: tuple[Named, ...]
    """The most severe first, then the earliest, as the terminal shows them."""
    shown: bool
    """Whether the files can show the cause."""
    contradictions: tuple[str, ...]
    """OK findings that the injected cause contradicts, and pairs of findings that exclude each other."""

    @property
    def clean(self) -> bool:
        return self.group == NONE

    @property
    def detected(self) -> bool:
        return any(named.right for named in self.named)

    @property
    def answer(self) -> Named | None:
        """The cause at the top of the report."""
        return self.named[0] if self.named else None

    @property
    def onset_error_s(self) -> float | None:
        """Distance of the first evidence from the onset. None without an onset, or if the cause was not found."""
        found = next((named.at_s for named in self.named if named.right and named.at_s is not None), None)
        return None if self.onset_s is None or found is None else abs(found - self.onset_s)

    @property
    def wrong(self) -> tuple[str, ...]:
        return tuple(named.key for named in self.named if not named.right and not named.effect)


@dataclass(frozen=True, slots=True)
class Scores:
    """Figures of a set of runs. A share is None if nothing is counted."""

    runs: int
    recall: float | None
    """Share of the runs with a fault that the files can show, whose cause was named."""
    precision: float | None
    """Share of the named causes that are right, over all runs."""
    accuracy: float | None
    """Share of the same runs whose first named cause is right."""
    onset_median_s: float | None
    onset_p95_s: float | None
    contradictions: int


def scores(outcomes: Iterable[Outcome]) -> Scores:
    outcomes = list(outcomes)
    faulty = [outcome for outcome in outcomes if outcome.shown]
    named = [named for outcome in outcomes for named in outcome.named if not named.effect]
    errors = [error for outcome in faulty if (error := outcome.onset_error_s) is not None]
    return Scores(
        len(outcomes),
        _share(outcome.detected for outcome in faulty),
        _share(cause.right for cause in named),
        _share(outcome.answer is not None and outcome.answer.right for outcome in faulty),
        statistics.median(errors) if errors else None,
        float(np.percentile(errors, 95)) if errors else None,
        sum(len(outcome.contradictions) for outcome in outcomes),
    )


def _share(counted: Iterable[bool]) -> float | None:
    values = list(counted)
    return sum(values) / len(values) if values else None


def score_table(outcomes: Sequence[Outcome]) -> str:
    """A row for each group, then for all."""
    heads = ("cause", "runs", "recall", "precision", "cause accuracy", "onset error: median", "95 %", "contradictions")
    rows = [(group, scores(of)) for group, of in _by_group(outcomes).items()]
    rows.append(("all", scores(outcomes)))
    cells = [
        (
            group,
            str(each.runs),
            *(_decimal(value) for value in (each.recall, each.precision, each.accuracy)),
            *(_decimal(value, " s") for value in (each.onset_median_s, each.onset_p95_s)),
            str(each.contradictions),
        )
        for group, each in rows
    ]
    return _markdown(heads, cells)


def confusion_table(outcomes: Sequence[Outcome], group_of: Mapping[str, str]) -> str:
    """Runs by their cause (rows) and by the first named cause (columns).

    group_of: group of each kind of finding. A right answer counts for its own group, because some findings name the
    causes of several groups.
    """
    groups = _by_group(outcomes)
    columns = [*dict.fromkeys([*(group for group in groups if group != NONE), *group_of.values()]), OTHER, NONE]
    cells = []
    for group, of in groups.items():
        counts = dict.fromkeys(columns, 0)
        for outcome in of:
            counts[_answered(outcome, group_of)] += 1
        cells.append((group, *(str(count) if count else "" for count in counts.values())))
    return _markdown(("cause \\ named", *columns), cells)


def _answered(outcome: Outcome, group_of: Mapping[str, str]) -> str:
    answer = outcome.answer
    if answer is None:
        return NONE
    if answer.right:
        return outcome.group
    parts = answer.key.split(".")
    kinds = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
    return next((group_of[kind] for kind in kinds if kind in group_of), OTHER)


def _by_group(outcomes: Iterable[Outcome]) -> dict[str, list[Outcome]]:
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault(outcome.group, []).append(outcome)
    return groups


def _decimal(value: float | None, unit: str = "") -> str:
    return "–" if value is None else f"{value:.2f}{unit}"


def _markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (heads, ["---"] * len(heads), *rows))
