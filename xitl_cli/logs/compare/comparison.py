"""Comparison of two logs, as `xitl logs compare` shows, writes and plots it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import xitl_cli.logs.signals as signals
from xitl_cli.logs.analyses.catalogue import analysis_failure, load_analysis
from xitl_cli.logs.compare.pairing import Pairing, StartEvent, event_section, limited, pair_logs, precise_modes, zero_ns
from xitl_cli.logs.compare.profiles import channel_section, motion_section
from xitl_cli.logs.compare.trajectories import Alignment, Trajectory
from xitl_cli.logs.compare.trajectory_section import common_poses, moved_poses, trajectory_section
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Plot, Section, Trace, Value
from xitl_cli.logs.signals import SignalSource, StateSpan


def stray_truth_finding(name: str, log: Log) -> Finding | None:
    """Finding for a log with ArduPilot's own simulated vehicle (SIM) and other sensors: that vehicle is not the
    truth."""
    apart_m = signals.stray_truth_m(log)
    if apart_m is None:
        return None
    return Finding.warning(
        "trajectory.stray_truth",
        f"SIM of {name} is not about this vessel: it came to be {apart_m:.0f} m from the receiver",
        (Evidence("SIM", "Lat, Lng"),),
        "Take the truth from the recording of whoever simulated the vessel (/truth of an MCAP file).",
    )


_Row = tuple[str, str, Value, Value]


def overlay(name: str, a: Log, b: Log, pairing: Pairing) -> Section | None:
    """One section from an analysis of both logs; None if the analysis has no result. Facts of one log follow common
    facts."""
    try:
        in_a, in_b = load_analysis(name)(a), load_analysis(name)(b)
    except Exception as error:  # noqa: BLE001  the rest of the comparison is worth having
        return Section(name, name, lacks=(analysis_failure(name, error).sentence,))
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
    """Textual facts of both logs in one, and rows of the other facts: label, unit, A, B."""
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
    """Plots of both logs joined, then plots of only one log."""
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
    """Traces of a plot, on A's time."""
    moved = pairing is not None and plot.kind == "time"
    return tuple(
        replace(
            trace,
            name=f"{log} · {trace.name}",
            x=pairing.on_a(np.asarray(trace.x, dtype=np.int64)) if moved and pairing is not None else trace.x,
        )
        for trace in plot.traces
    )


_OVERLAID = ("scheduler", "time_bases")


@dataclass(frozen=True, slots=True)
class Comparison:
    """The comparison of two logs, on A's time.

    zero_ns: the stamp from which seconds count: the event that aligned the logs, or the common start. zero_s: the same
    in seconds since A's first row. trajectories: A's and B's poses at common stamps, with B aligned as requested; None
    if positions are missing. states: armed and modes of A.
    """

    sections: tuple[Section, ...]
    pairing: Pairing
    zero_ns: int
    zero_s: float
    trajectories: tuple[Trajectory, Trajectory] | None
    states: tuple[StateSpan, ...]

    @property
    def zero_sentence(self) -> str:
        return f"0 s is {self.zero_s:.3f} s after A's first row"


def compare(
    a: Log,
    b: Log,
    *,
    align: Alignment = "none",
    start: StartEvent = "auto",
    shift_s: float | None = None,
    of_a: SignalSource = "estimate",
    of_b: SignalSource = "estimate",
    from_s: float | None = None,
    until_s: float | None = None,
    armed: bool = False,
) -> Comparison:
    """Compare B with A.

    from_s, until_s: limits after the zero. armed: only while both logs were armed. Sections on events, the scheduler
    and time bases cover the whole logs. Raises LogError if no method aligns the logs, or no data is left.
    """
    laid = pair_logs(a, b, start, shift_s)
    pairing = limited(a, b, laid, from_s, until_s, armed)
    both = common_poses(a, b, pairing, of_a, of_b)
    zero = zero_ns(a, b, pairing)
    # The section with findings that doubt the source used as truth.
    section = _without_positions(a, b, of_a, of_b) if both is None else trajectory_section(both, align)
    sides = (("A", a, of_a), ("B", b, of_b))
    doubts = (stray_truth_finding(name, log) for name, log, of in sides if of == "truth")
    sections = [
        replace(section, findings=(*section.findings, *(doubt for doubt in doubts if doubt is not None))),
        motion_section(a, b, pairing, of_a, of_b),
        channel_section(a, b, pairing),
        event_section(a, b, pairing, zero),
        *(overlay(name, a, b, pairing) for name in _OVERLAID),
    ]
    return Comparison(
        tuple(section for section in sections if section is not None),
        pairing,
        zero,
        0.0 if a.span_ns is None else (zero - a.span_ns[0]) * 1e-9,
        None if both is None else (both.a, moved_poses(both, align)[0]),
        (*signals.armed(a), *precise_modes(a)),
    )


def _without_positions(a: Log, b: Log, of_a: SignalSource, of_b: SignalSource) -> Section:
    without = [name for name, log, of in (("A", a, of_a), ("B", b, of_b)) if signals.position_ned(log, of) is None]
    why = (
        f"{' and '.join(without)} {'hold' if len(without) > 1 else 'holds'} no position"
        if without
        else "their positions have no common time"
    )
    return Section("trajectory", "Trajectory", lacks=(f"The paths are not compared: {why}.",))
