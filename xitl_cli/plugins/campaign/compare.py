"""Comparison of two campaigns on the same seeds, or of one campaign split by an axis: pairs, differences and tests."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

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
            raise UserError(f"{key} varies in {table.folder} alone; compare campaigns with the same axes, or use --by")
    if not a.rows or not b.rows:
        raise UserError(f"{(b if a.rows else a).folder}: has no run yet; run the campaign first")
    shared = [axis for axis in axes if _shares(axis, a.rows, b.rows)]
    names = _names(a, b)
    sides = (Side(names[0], tuple(a.rows)), Side(names[1], tuple(b.rows)))
    return compare_sides(*sides, shared, _both(a.figures, b.figures), _both(a.verdicts, b.verdicts), confidence)


def compare_by(table: ResultTable, axis: str, confidence: float = 0.95) -> list[CampaignComparison]:
    """Compare the first value of an axis with each other value in one campaign. Raises UserError."""
    if axis not in table.axes:
        raise UserError(f"--by {axis}: is no axis of {table.folder}; those are {', '.join(table.axes) or 'none'}")
    first: dict[str, list[Row]] = {}
    for row in table.rows:
        first.setdefault(_text(row.get(axis)), []).append(row)
    if len(first) < 2:
        raise UserError(f"--by {axis}: has one value in {table.folder}; a comparison takes two")
    short = axis.rpartition(".")[2]
    sides = [Side(f"{short} = {value.rpartition('/')[2]}", tuple(rows)) for value, rows in first.items()]
    others = [key for key in table.axes if key != axis]
    found = [compare_sides(sides[0], side, others, table.figures, table.verdicts, confidence) for side in sides[1:]]
    return _adjusted(found)


def compare_sides(
    a: Side, b: Side, paired_by: Sequence[str], figures: Sequence[str], verdicts: Sequence[str], confidence: float
) -> CampaignComparison:
    """Compare two sides. Raises UserError if no run has a partner, or a seed occurs twice."""
    keys = (*paired_by, "seed")
    ours, theirs = (_by_key(side, keys) for side in (a, b))
    both = [key for key in ours if key in theirs]
    if not both:
        raise UserError(
            f"{a.name} and {b.name}: no run of one has the {' and '.join(['seed', *paired_by])} of a run of the other; "
            "give both campaigns the same seeds"
        )
    pairs = [(ours[key], theirs[key]) for key in both]
    statuses = counted_statuses(verdicts)
    whole = [pair for pair in pairs if all(row.get("status") in statuses for row in pair)]
    compared = []
    for figure in figures:
        values = [(one.get(figure), other.get(figure)) for one, other in whole]
        known = [all(is_number(value) for value in pair) for pair in values]
        if any(known):
            at_a, at_b = np.array(
                [pair for pair, is_known in zip(values, known, strict=True) if is_known], np.float64
            ).T
            of_seeds = [seed_of(one) for (one, _), is_known in zip(whole, known, strict=True) if is_known]
            compared.append(FigureComparison(figure, paired_difference(at_a, at_b, confidence, of_seeds), None))
    judged = _judged(pairs, verdicts, confidence)
    alone = (len(ours) - len(both), len(theirs) - len(both))
    incomplete = len(pairs) - len(whole)
    seeds = len({seed_of(one) for one, _ in pairs})
    told = CampaignComparison(
        a.name, b.name, tuple(paired_by), len(pairs), seeds, alone, incomplete, confidence, tuple(compared), judged
    )
    return _adjusted([told])[0]


def _judged(
    pairs: Sequence[tuple[Row, Row]], verdicts: Sequence[str], confidence: float
) -> tuple[VerdictComparison, ...]:
    """Compare pass rates of each verdict and of all verdicts together.

    Verdicts with the same outcome in all pairs are one test.
    """
    alike: dict[tuple[tuple[Any, Any], ...], list[str]] = {}
    for verdict in (*verdicts, PASSED) if len(verdicts) != 1 else verdicts:
        ran = _ran_and_known(pairs, verdict)
        if any(outcome != (None, None) for outcome in ran):
            alike.setdefault(ran, []).append(verdict)
    found = []
    for outcomes, (verdict, *others) in alike.items():
        known = [number for number, outcome in enumerate(outcomes) if outcome != (None, None)]
        passed_a, passed_b = ([outcomes[number][side] for number in known] for side in (0, 1))
        of_seeds = [seed_of(pairs[number][0]) for number in known]
        rates = paired_rates(passed_a, passed_b, confidence, of_seeds)
        found.append(VerdictComparison(verdict, rates, 1.0, tuple(others)))
    return tuple(found)


def _ran_and_known(pairs: Sequence[tuple[Row, Row]], verdict: str) -> tuple[tuple[bool | None, bool | None], ...]:
    """Return the outcomes of each pair; None for both if a run did not end by itself or a verdict is unknown."""
    found: list[tuple[bool | None, bool | None]] = []
    for one, other in pairs:
        outcome = (one.get(verdict), other.get(verdict))
        counts = _ran(one) and _ran(other) and None not in outcome
        found.append((bool(outcome[0]), bool(outcome[1])) if counts else (None, None))
    return tuple(found)


def seed_of(row: Row) -> str:
    """Return the cluster of a run: its seed, as the same text for the same number."""
    return _text(row.get("seed"))


def _adjusted(found: list[CampaignComparison]) -> list[CampaignComparison]:
    """Adjust the p-values of all figures and verdicts of all comparisons together."""
    raw = [one.difference.p_value for told in found for one in told.figures]
    raw += [one.rates.p_value for told in found for one in told.verdicts]
    adjusted = iter(holm([value for value in raw if value is not None]))
    figures = [
        tuple(replace(one, adjusted=None if one.difference.p_value is None else next(adjusted)) for one in told.figures)
        for told in found
    ]
    verdicts = [tuple(replace(one, adjusted=next(adjusted)) for one in told.verdicts) for told in found]
    return [
        replace(told, figures=ours, verdicts=judged)
        for told, ours, judged in zip(found, figures, verdicts, strict=True)
    ]


def _by_key(side: Side, keys: Sequence[str]) -> dict[tuple[str, ...], Row]:
    found: dict[tuple[str, ...], Row] = {}
    for row in side.rows:
        key = tuple(_text(row.get(name)) for name in keys)
        if key in found:
            raise UserError(
                f"{side.name}: runs {found[key]['number']} and {row['number']} have the same {' and '.join(keys)}; "
                "split it by the axis in which they differ, with --by"
            )
        found[key] = row
    return found


def _names(a: ResultTable, b: ResultTable) -> tuple[str, str]:
    """Return the shortest different ends of both folders' paths."""
    parts = (a.folder.resolve().parts, b.folder.resolve().parts)
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(one[-depth:]) for one in parts]
        if names[0] != names[1]:
            return names[0], names[1]
    return str(a.folder), str(b.folder)


def _shares(axis: str, a: Iterable[Row], b: Iterable[Row]) -> bool:
    """Return True if both sides share a value. An axis that differs throughout is the compared one."""
    return bool({_text(row.get(axis)) for row in a} & {_text(row.get(axis)) for row in b})


def _both(a: Sequence[str], b: Sequence[str]) -> list[str]:
    return [name for name in a if name in b]


def counted_statuses(verdicts: Iterable[str]) -> tuple[str, ...]:
    """Return the statuses of runs that count. If a verdict requires completion, figures of incomplete runs would be too
    good.
    """
    asked = any(text.split(".")[-1].startswith("completed") or ".completed" in text for text in verdicts)
    return (COMPLETED,) if asked else RAN


def _ran(row: Row) -> bool:
    return row.get("status") in RAN


def _text(value: Any) -> str:
    if is_number(value):
        return f"{float(value):.12g}"
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True)
