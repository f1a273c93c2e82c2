"""What an analysis says of each log, side by side: facts of equal name as a table, plots of equal name in one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from xitl_cli.logs.analyses.catalogue import analysis
from xitl_cli.logs.analyses.failure import failure
from xitl_cli.logs.compare.common_time import Pairing
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Fact, Grid, Plot, Section, Trace, Value

_Row = tuple[str, str, Value, Value]


def overlay(name: str, a: Log, b: Log, pairing: Pairing) -> Section | None:
    """None where the analysis has nothing to say about either. Facts of one alone come after those of both."""
    try:
        in_a, in_b = analysis(name)(a), analysis(name)(b)
    except Exception as error:  # noqa: BLE001  the rest of the comparison is worth having
        return Section(name, name, lacks=(failure(name, error).sentence,))
    if in_a is None or in_b is None:
        said = in_a or in_b
        if said is None:
            return None
        return Section(name, said.title, lacks=(f"{said.title} can be judged of {'A' if in_a else 'B'} alone.",))
    words, rows = _rows(in_a.facts, in_b.facts)
    both = tuple((*row, _less(row[2], row[3])) for row in rows if row[2] is not None and row[3] is not None)
    alone = tuple(row for row in rows if (row[2] is None) != (row[3] is None))
    grids = []
    if both:
        grids.append(Grid(f"{name}.both", f"{in_a.title} of both", ("fact", "unit", "A", "B", "B less A"), both))
    if alone:
        grids.append(Grid(f"{name}.alone", f"{in_a.title}, told by one alone", ("fact", "unit", "A", "B"), alone))
    plots = _plots(in_a.plots, in_b.plots, pairing)
    lacks = tuple(f"A: {each}" for each in in_a.lacks) + tuple(f"B: {each}" for each in in_b.lacks)
    return Section(name, in_a.title, words, grids=tuple(grids), plots=plots, lacks=lacks)


def _rows(a: tuple[Fact, ...], b: tuple[Fact, ...]) -> tuple[tuple[Fact, ...], list[_Row]]:
    """Facts in words, of both in one, and rows of the others: label, unit, A, B."""
    facts_b = {fact.key: fact for fact in b}
    words: list[Fact] = []
    rows: list[_Row] = []
    for fact, in_a, in_b in (
        *((each, each.value, facts_b[each.key].value if each.key in facts_b else None) for each in a),
        *((each, None, each.value) for each in b if each.key not in {one.key for one in a}),
    ):
        if isinstance(in_a, str) or isinstance(in_b, str):
            told = "; ".join(f"{log}: {value}" for log, value in (("A", in_a), ("B", in_b)) if value is not None)
            words.append(Fact(fact.key, fact.label, told))
        else:
            rows.append((fact.label, fact.unit, in_a, in_b))
    return tuple(words), rows


def _less(a: Value, b: Value) -> float | int | None:
    numbers = not isinstance(a, bool) and not isinstance(b, bool)
    if numbers and isinstance(a, int | float) and isinstance(b, int | float):
        return b - a if isinstance(a, int) and isinstance(b, int) else float(f"{b - a:.6g}")
    return None


def _plots(a: tuple[Plot, ...], b: tuple[Plot, ...], pairing: Pairing) -> tuple[Plot, ...]:
    """Of both in one; then those of one alone."""
    of_b = {plot.key: plot for plot in b}
    drawn = []
    for plot in a:
        lines, others = _named("A", plot), _named("B", of_b.pop(plot.key), pairing) if plot.key in of_b else ()
        shared = {trace.name[1:] for trace in lines} & {trace.name[1:] for trace in others}
        traces = (each for each in (*lines, *others) if not shared or each.name[1:] in shared)
        drawn.append(replace(plot, traces=tuple(traces), marks=()))
    alone = (replace(plot, traces=_named("B", plot, pairing), marks=()) for plot in b if plot.key in of_b)
    return (*drawn, *alone)


def _named(log: str, plot: Plot, pairing: Pairing | None = None) -> tuple[Trace, ...]:
    """Its lines, on A's time."""
    moved = pairing is not None and plot.kind == "time"
    return tuple(
        replace(
            trace,
            name=f"{log} · {trace.name}",
            x=pairing.on_a(np.asarray(trace.x, dtype=np.int64)) if moved and pairing is not None else trace.x,
        )
        for trace in plot.traces
    )
