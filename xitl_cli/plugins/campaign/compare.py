"""Comparison of two campaigns on the same seeds, or of one campaign split by an axis: pairs, differences and tests."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign.execution import COMPLETED, RAN
from xitl_cli.plugins.campaign.results import ResultTable, is_number
from xitl_cli.plugins.campaign.statistics import PairedDifference, PairedRates, holm, paired_difference, paired_rates

Row = Mapping[str, Any]
PASSED = "passed"


@dataclass(frozen=True, slots=True)
class Side:
    """One of two compared sides."""

    name: str
    """Display name."""
    rows: tuple[Row, ...]


@dataclass(frozen=True, slots=True)
class FigureComparison:
    """Comparison of a figure."""

    figure: str
    difference: PairedDifference
    adjusted: float | None
    """P-value adjusted for the number of compared figures (Holm); None without a test."""


@dataclass(frozen=True, slots=True)
class VerdictComparison:
    """Comparison of a verdict."""

    verdict: str
    """Text of the verdict, or "passed" for all verdicts together."""
    rates: PairedRates
    adjusted: float
    alike: tuple[str, ...] = ()
    """Other verdicts, and "passed", that the same runs satisfy. They are the same test and count once."""


@dataclass(frozen=True, slots=True)
class CampaignComparison:
    """Comparison of two campaigns.

    Pairs of one seed are a cluster: they share gusts and noise, so they depend on each other.
    """

    a: str
    b: str
    paired_by: tuple[str, ...]
    pairs: int
    """Number of runs with the same seed and axes on both sides."""
    seeds: int
    """Number of seeds of the pairs."""
    unpaired: tuple[int, int]
    """Runs of each side without a partner."""
    incomplete: int
    """Pairs excluded from the figures, because a run did not complete or failed."""
    confidence: float
    figures: tuple[FigureComparison, ...]
    verdicts: tuple[VerdictComparison, ...]


def compare_tables(a: ResultTable, b: ResultTable, confidence: float = 0.95) -> CampaignComparison:
    """Pair by seed and by every axis with several values. Raises UserError if no pairs exist."""
    axes = []
    for key in dict.fromkeys([*a.axes, *b.axes]):
        values = [{_text(row.get(key)) for row in table.rows} for table in (a, b)]
        if key in a.axes and key in b.axes:
            axes.append(key)
        elif max(map(len, values)) > 1:
            table = a if key in a.axes else b
            raise UserError(f"{key} varies only in {table.folder}; compare campaigns with the same axes, or use --by")
    if not a.rows or not b.rows:
        raise UserError(f"{(b if a.rows else a).folder}: has no run yet; run the campaign first")
    # An axis that differs in all runs is the compared one.
    shared = [
        axis for axis in axes if {_text(row.get(axis)) for row in a.rows} & {_text(row.get(axis)) for row in b.rows}
    ]
    # The names are the shortest different ends of both folders' paths.
    parts = (a.folder.resolve().parts, b.folder.resolve().parts)
    names = (str(a.folder), str(b.folder))
    for depth in range(1, max(map(len, parts)) + 1):
        name_a, name_b = ("/".join(part[-depth:]) for part in parts)
        if name_a != name_b:
            names = (name_a, name_b)
            break
    figures = [figure for figure in a.figures if figure in b.figures]
    verdicts = [verdict for verdict in a.verdicts if verdict in b.verdicts]
    sides = (Side(names[0], tuple(a.rows)), Side(names[1], tuple(b.rows)))
    return compare_sides(*sides, shared, figures, verdicts, confidence)


def compare_by(table: ResultTable, axis: str, confidence: float = 0.95) -> list[CampaignComparison]:
    """Compare the first value of an axis with each other value in one campaign. Raises UserError."""
    if axis not in table.axes:
        raise UserError(f"--by {axis}: is not an axis of {table.folder}; its axes: {', '.join(table.axes) or 'none'}")
    by_value: dict[str, list[Row]] = {}
    for row in table.rows:
        by_value.setdefault(_text(row.get(axis)), []).append(row)
    if len(by_value) < 2:
        raise UserError(f"--by {axis}: has one value in {table.folder}; a comparison needs two")
    short = axis.rpartition(".")[2]
    first, *rest = [Side(f"{short} = {value.rpartition('/')[2]}", tuple(rows)) for value, rows in by_value.items()]
    others = [key for key in table.axes if key != axis]
    return _adjusted([compare_sides(first, side, others, table.figures, table.verdicts, confidence) for side in rest])


def compare_sides(
    a: Side, b: Side, paired_by: Sequence[str], figures: Sequence[str], verdicts: Sequence[str], confidence: float
) -> CampaignComparison:
    """Compare two sides. Raises UserError if no run has a partner, or a seed occurs twice."""
    keys = (*paired_by, "seed")
    ours, theirs = (_by_key(side, keys) for side in (a, b))
    both = [key for key in ours if key in theirs]
    if not both:
        raise UserError(
            f"{a.name} and {b.name}: no two runs have the same {' and '.join(['seed', *paired_by])}; "
            "use the same seeds for both campaigns"
        )
    pairs = [(ours[key], theirs[key]) for key in both]
    statuses = counted_statuses(verdicts)
    whole = [pair for pair in pairs if all(row.get("status") in statuses for row in pair)]
    compared = []
    for figure in figures:
        values = [(row_a.get(figure), row_b.get(figure)) for row_a, row_b in whole]
        known = [all(is_number(value) for value in pair) for pair in values]
        if any(known):
            at_a, at_b = np.array(
                [pair for pair, is_known in zip(values, known, strict=True) if is_known], np.float64
            ).T
            of_seeds = [seed_of(row_a) for (row_a, _), is_known in zip(whole, known, strict=True) if is_known]
            compared.append(FigureComparison(figure, paired_difference(at_a, at_b, confidence, of_seeds), None))
    comparison = CampaignComparison(
        a=a.name,
        b=b.name,
        paired_by=tuple(paired_by),
        pairs=len(pairs),
        seeds=len({seed_of(row_a) for row_a, _ in pairs}),
        unpaired=(len(ours) - len(both), len(theirs) - len(both)),
        incomplete=len(pairs) - len(whole),
        confidence=confidence,
        figures=tuple(compared),
        verdicts=_compare_verdicts(pairs, verdicts, confidence),
    )
    return _adjusted([comparison])[0]


def _compare_verdicts(
    pairs: Sequence[tuple[Row, Row]], verdicts: Sequence[str], confidence: float
) -> tuple[VerdictComparison, ...]:
    """Compare pass rates of each verdict and of all verdicts together.

    Verdicts with the same outcome in all pairs are one test.
    """
    alike: dict[tuple[tuple[Any, Any], ...], list[str]] = {}
    for verdict in (*verdicts, PASSED) if len(verdicts) != 1 else verdicts:
        # None for both if a run did not end by itself or a verdict is unknown.
        of_pairs: list[tuple[bool | None, bool | None]] = []
        for row_a, row_b in pairs:
            outcome = (row_a.get(verdict), row_b.get(verdict))
            counts = row_a.get("status") in RAN and row_b.get("status") in RAN and None not in outcome
            of_pairs.append((bool(outcome[0]), bool(outcome[1])) if counts else (None, None))
        if any(outcome != (None, None) for outcome in of_pairs):
            alike.setdefault(tuple(of_pairs), []).append(verdict)
    compared = []
    for outcomes, (verdict, *others) in alike.items():
        known = [number for number, outcome in enumerate(outcomes) if outcome != (None, None)]
        passed_a, passed_b = ([outcomes[number][side] for number in known] for side in (0, 1))
        of_seeds = [seed_of(pairs[number][0]) for number in known]
        rates = paired_rates(passed_a, passed_b, confidence, of_seeds)
        compared.append(VerdictComparison(verdict, rates, 1.0, tuple(others)))
    return tuple(compared)


def seed_of(row: Row) -> str:
    """Return the cluster of a run: its seed, as the same text for the same number."""
    return _text(row.get("seed"))


def _adjusted(comparisons: Sequence[CampaignComparison]) -> list[CampaignComparison]:
    """Adjust the p-values of all figures and verdicts of all comparisons together."""
    raw = [figure.difference.p_value for comparison in comparisons for figure in comparison.figures]
    raw += [verdict.rates.p_value for comparison in comparisons for verdict in comparison.verdicts]
    adjusted = iter(holm([value for value in raw if value is not None]))
    figures = [
        tuple(
            replace(figure, adjusted=None if figure.difference.p_value is None else next(adjusted))
            for figure in comparison.figures
        )
        for comparison in comparisons
    ]
    verdicts = [
        tuple(replace(verdict, adjusted=next(adjusted)) for verdict in comparison.verdicts)
        for comparison in comparisons
    ]
    return [
        replace(comparison, figures=of_figures, verdicts=of_verdicts)
        for comparison, of_figures, of_verdicts in zip(comparisons, figures, verdicts, strict=True)
    ]


def _by_key(side: Side, keys: Sequence[str]) -> dict[tuple[str, ...], Row]:
    rows: dict[tuple[str, ...], Row] = {}
    for row in side.rows:
        key = tuple(_text(row.get(name)) for name in keys)
        if key in rows:
            raise UserError(
                f"{side.name}: runs {rows[key]['number']} and {row['number']} have the same {' and '.join(keys)}; "
                "use --by with the axis in which they differ"
            )
        rows[key] = row
    return rows


def counted_statuses(verdicts: Iterable[str]) -> tuple[str, ...]:
    """Return the statuses of runs that count. If a verdict requires completion, figures of incomplete runs would be too
    good.
    """
    asked = any(text.split(".")[-1].startswith("completed") or ".completed" in text for text in verdicts)
    return (COMPLETED,) if asked else RAN


def _text(value: Any) -> str:
    if is_number(value):
        return f"{float(value):.12g}"
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True)
