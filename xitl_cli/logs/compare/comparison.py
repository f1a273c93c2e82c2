"""Comparison of two logs, as `xitl logs compare` shows, writes and plots it.

Differences of one quantity of both logs over their common time: motion, outputs, RC inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import xitl_cli.logs.signals as signals
from xitl_cli.logs.compare.pairing import (
    Pairing,
    StartEvent,
    best_lag,
    common_samples,
    event_section,
    limited,
    pair_logs,
    precise_modes,
    time_integral,
    zero_ns,
)
from xitl_cli.logs.compare.trajectories import (
    Alignment,
    Trajectory,
    align_trajectory,
    common_poses,
    trajectory_section,
)
from xitl_cli.logs.model.analysis import LogAnalysis, analysis_failure
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Plot, Section, Trace, Value
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.signals import Series, SignalSource, StateSpan
from xitl_cli.logs.signals.series import column_series
from xitl_cli.logs.signals.states import pulses


@dataclass(frozen=True, slots=True)
class SignalDifference:
    """Difference of one quantity between two logs."""

    name: str
    unit: str
    sources: tuple[str, str]
    stamp_ns: Stamps
    """(N,) A's own samples within the common time, on A's time."""
    a: Floats
    """(N,) A's values."""
    b: Floats
    """(N,) B's values, interpolated linearly."""
    errors: Floats
    """(N,) b minus a; for angles along the shorter arc."""
    iae: float
    """Integral of |b - a| over time (unit times s), by the trapezoidal rule, without gaps."""
    rms: float
    mean: float
    most: float
    """Largest of |errors|, at most_ns."""
    most_ns: int
    covered_s: float
    """Time of the integral."""
    correlation: float | None
    """Highest correlation over shifts of B; None if one signal does not change."""
    lag_s: float | None
    """Delay of B at that shift (within 10 s); None if the correlation is too low."""

    @property
    def constant(self) -> bool:
        """Whether both signals are constant."""
        return not np.ptp(self.a) and not np.ptp(self.b)


def signal_difference(name: str, a: Series, b: Series, pairing: Pairing) -> SignalDifference | None:
    """Difference of two series; None without a common time of at least two samples."""
    matched = common_samples(a, b, pairing)
    if matched is None:
        return None
    stamps, in_a, in_b = matched
    errors = (in_b - in_a + 180.0) % 360.0 - 180.0 if a.turns else in_b - in_a
    worst = int(np.argmax(np.abs(errors)))
    covered_s, iae = time_integral(stamps, np.abs(errors))
    correlation, lag_s = best_lag(stamps, in_a, in_b, turns=a.turns)
    return SignalDifference(
        name,
        a.unit,
        (a.source, b.source),
        stamps,
        in_a,
        in_b,
        errors,
        iae,
        float(np.sqrt(np.mean(errors**2))),
        float(np.mean(errors)),
        float(abs(errors[worst])),
        int(stamps[worst]),
        covered_s,
        correlation,
        lag_s,
    )


_COLUMNS = ("quantity", "unit", "IAE", "RMS", "most", "mean", "B later (s)", "correlation")


def difference_or_reason(name: str, a: Series | None, b: Series | None, pairing: Pairing) -> SignalDifference | str:
    """The difference, or the sentence with the reason why there is none."""
    if a is None or b is None:
        without = "either log" if a is None and b is None else "A" if a is None else "B"
        return f"{_capital(name)} is not in {without}."
    if a.unit != b.unit:
        return f"{_capital(name)} is in {a.unit or 'commands'} in A and in {b.unit or 'commands'} in B."
    return signal_difference(name, a, b, pairing) or f"{_capital(name)} has no common time in both."


def difference_grid(key: str, differences: Sequence[SignalDifference]) -> tuple[Grid, ...]:
    """One row per difference; empty without differences."""
    rows: list[tuple[Value, ...]] = []
    for pair in differences:
        lag_s = None if pair.lag_s is None else round(pair.lag_s, 3) + 0.0
        correlation = None if pair.correlation is None else round(pair.correlation, 4)
        numbers = (float(f"{figure:.4g}") for figure in (pair.iae, pair.rms, pair.most, pair.mean))
        rows.append((pair.name, pair.unit, *numbers, lag_s, correlation))
    return (Grid(f"{key}.differences", "B less A", _COLUMNS, tuple(rows)),) if rows else ()


def difference_plot(key: str, pair: SignalDifference) -> Plot:
    return Plot(
        f"{key}.{pair.name.replace(' ', '_')}",
        _capital(pair.name),
        pair.unit or "command",
        (
            Trace(f"A ({pair.sources[0]})", pair.stamp_ns, _unbroken(pair.unit, pair.a)),
            Trace(f"B ({pair.sources[1]})", pair.stamp_ns, _unbroken(pair.unit, pair.b)),
        ),
    )


def _unbroken(unit: str, values: Floats) -> Floats:
    """Values without the line across the plot at the step from 360 to 0."""
    if unit != "deg" or np.ptp(values) < 180.0:
        return values
    drawn = values.astype(np.float64).copy()
    drawn[1:][np.abs(np.diff(values)) > 180.0] = np.nan
    return drawn


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def motion_section(a: Log, b: Log, pairing: Pairing, of_a: SignalSource, of_b: SignalSource) -> Section | None:
    """Speed over ground, yaw, altitude, roll, pitch, and the height of the estimators' origins if both log it."""
    differences, lacks = [], []
    for name, in_a, in_b in (
        ("speed over ground", signals.ground_speed(a, of_a), signals.ground_speed(b, of_b)),
        ("yaw", signals.yaw(a, of_a), signals.yaw(b, of_b)),
        ("altitude", _altitude(a, of_a), _altitude(b, of_b)),
        ("roll", signals.roll(a, of_a), signals.roll(b, of_b)),
        ("pitch", signals.pitch(a, of_a), signals.pitch(b, of_b)),
        ("EKF origin height", _origin_height(a), _origin_height(b)),
    ):
        both = difference_or_reason(name, in_a, in_b, pairing)
        if not isinstance(both, str):
            differences.append(both)
        elif name != "EKF origin height":
            lacks.append(both)
    if not differences and not lacks:
        return None
    plots = tuple(difference_plot("motion", pair) for pair in differences)
    return Section("motion", "Motion", grids=difference_grid("motion", differences), plots=plots, lacks=tuple(lacks))


def _altitude(log: Log, of: SignalSource) -> Series | None:
    place = signals.position_geodetic(log, of)
    if place is None:
        return None
    return Series(place.stamp_ns, place.values[:, 2], "m", f"{place.source} altitude", dropped=place.dropped)


def _origin_height(log: Log) -> Series | None:
    height = column_series(log, "XKF1", "OH", "m")
    return column_series(log, "NKF1", "OH", "m") if height is None else height


def channel_section(a: Log, b: Log, pairing: Pairing) -> Section | None:
    """Differences of channels. Channels that are constant in both are a fact, not a row. None if neither log has
    any."""
    differences: list[SignalDifference] = []
    facts: list[Fact] = []
    lacks: list[str] = []
    # Outputs in one unit if both logs have it: commands, else pulse widths.
    outputs_a, outputs_b = signals.outputs(a), signals.outputs(b)
    if len({output.unit for outputs in (outputs_a, outputs_b) for output in outputs.values()}) > 1:
        pulses_a, pulses_b = pulses(a), pulses(b)
        if pulses_a and pulses_b:
            outputs_a, outputs_b = pulses_a, pulses_b
    kinds = (("output", outputs_a, outputs_b), ("RC input", signals.rc_inputs(a), signals.rc_inputs(b)))
    for words, in_a, in_b in kinds:
        if not in_a and not in_b:
            continue
        if not in_a or not in_b:
            lacks.append(f"{'B' if in_a else 'A'} logs no {words}s.")
            continue
        still = []
        for channel in sorted(set(in_a) & set(in_b)):
            both = difference_or_reason(f"{words} {channel}", in_a[channel], in_b[channel], pairing)
            if isinstance(both, str):
                lacks.append(both)
            elif both.constant and both.most == 0.0:
                still.append(channel)
            else:
                differences.append(both)
        if still:
            key = f"same_{words.lower().replace(' ', '_')}s"
            facts.append(Fact(key, f"{words[:1].upper()}{words[1:]}s equal, never moved", _listed(still)))
        for name, alone in (("A", set(in_a) - set(in_b)), ("B", set(in_b) - set(in_a))):
            if alone:
                many = "s" if len(alone) > 1 else ""
                lacks.append(
                    f"{words[:1].upper()}{words[1:]}{many} {_listed(sorted(alone))} {'are' if many else 'is'} "
                    f"in {name} alone."
                )
    if not differences and not facts and not lacks:
        return None
    plots = tuple(difference_plot("channels", pair) for pair in differences)
    grids = difference_grid("channels", differences)
    return Section("channels", "Channels", tuple(facts), grids=grids, plots=plots, lacks=tuple(lacks))


def _listed(channels: list[int]) -> str:
    """Channel numbers as a list: 1 to 4, 17, 18."""
    parts: list[list[int]] = []
    for channel in channels:
        if parts and channel == parts[-1][-1] + 1:
            parts[-1].append(channel)
        else:
            parts.append([channel])
    return ", ".join(f"{part[0]} to {part[-1]}" if len(part) > 2 else ", ".join(map(str, part)) for part in parts)


def stray_truth_finding(name: str, log: Log) -> Finding | None:
    """Finding for a log with ArduPilot's own simulated vehicle (SIM) and other sensors: that vehicle is not the
    truth."""
    apart_m = signals.stray_truth_m(log)
    if apart_m is None:
        return None
    return Finding.warning(
        "trajectory.stray_truth",
        f"SIM of {name} is another vessel: its position is up to {apart_m:.0f} m from the receiver",
        (Evidence("SIM", "Lat, Lng"),),
        "Use the truth in the recording of the simulator that moved the vessel (/truth of an MCAP file).",
    )


_Row = tuple[str, str, Value, Value]


def overlay(analysis: LogAnalysis, a: Log, b: Log, pairing: Pairing) -> Section | None:
    """One section from an analysis of both logs; None if the analysis has no result. Facts of one log follow common
    facts."""
    name = analysis.name
    try:
        in_a, in_b = analysis.section(a), analysis.section(b)
    except Exception as error:  # noqa: BLE001  the rest of the comparison is worth having
        return Section(name, name, lacks=(analysis_failure(name, error).sentence,))
    if in_a is None or in_b is None:
        known = in_a or in_b
        if known is None:
            return None
        return Section(name, known.title, lacks=(f"{known.title} can be judged for {'A' if in_a else 'B'} only.",))
    words, rows = _rows(in_a.facts, in_b.facts)
    both = tuple((*row, _less(row[2], row[3])) for row in rows if row[2] is not None and row[3] is not None)
    alone = tuple(row for row in rows if (row[2] is None) != (row[3] is None))
    grids = []
    if both:
        grids.append(Grid(f"{name}.both", f"{in_a.title} of both", ("fact", "unit", "A", "B", "B less A"), both))
    if alone:
        grids.append(Grid(f"{name}.alone", f"{in_a.title}, known of one log only", ("fact", "unit", "A", "B"), alone))
    # Plots of both logs joined, then plots of only one log
    of_b = {plot.key: plot for plot in in_b.plots}
    drawn = []
    for plot in in_a.plots:
        lines, others = _named("A", plot), _named("B", of_b.pop(plot.key), pairing) if plot.key in of_b else ()
        shared = {trace.name[1:] for trace in lines} & {trace.name[1:] for trace in others}
        traces = (trace for trace in (*lines, *others) if not shared or trace.name[1:] in shared)
        drawn.append(replace(plot, traces=tuple(traces), marks=()))
    only_b = (replace(plot, traces=_named("B", plot, pairing), marks=()) for plot in in_b.plots if plot.key in of_b)
    plots = (*drawn, *only_b)
    lacks = tuple(f"A: {lack}" for lack in in_a.lacks) + tuple(f"B: {lack}" for lack in in_b.lacks)
    return Section(name, in_a.title, words, grids=tuple(grids), plots=plots, lacks=lacks)


def _rows(a: tuple[Fact, ...], b: tuple[Fact, ...]) -> tuple[tuple[Fact, ...], list[_Row]]:
    """Textual facts of both logs in one, and rows of the other facts: label, unit, A, B."""
    values_a, values_b = {fact.key: fact.value for fact in a}, {fact.key: fact.value for fact in b}
    words: list[Fact] = []
    rows: list[_Row] = []
    for fact in (*a, *(fact for fact in b if fact.key not in values_a)):
        in_a, in_b = values_a.get(fact.key), values_b.get(fact.key)
        if isinstance(in_a, str) or isinstance(in_b, str):
            texts = "; ".join(f"{log}: {value}" for log, value in (("A", in_a), ("B", in_b)) if value is not None)
            words.append(Fact(fact.key, fact.label, texts))
        else:
            rows.append((fact.label, fact.unit, in_a, in_b))
    return tuple(words), rows


def _less(a: Value, b: Value) -> float | int | None:
    numbers = not isinstance(a, bool) and not isinstance(b, bool)
    if numbers and isinstance(a, int | float) and isinstance(b, int | float):
        return b - a if isinstance(a, int) and isinstance(b, int) else float(f"{b - a:.6g}")
    return None


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


OVERLAID = ("scheduler", "time_bases")
"""Analyses of which a comparison shows both logs."""


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
    analyses: Sequence[LogAnalysis] = (),
) -> Comparison:
    """Compare B with A.

    from_s, until_s: limits after the zero. armed: only while both logs were armed. analyses: each adds a section with
    its facts of both logs, by default none (`OVERLAID` names those of `xitl logs compare`). These sections and the one
    on events cover the whole logs. Raises LogError if no method aligns the logs, or no data is left.
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
        *(overlay(analysis, a, b, pairing) for analysis in analyses),
    ]
    return Comparison(
        tuple(section for section in sections if section is not None),
        pairing,
        zero,
        0.0 if a.span_ns is None else (zero - a.span_ns[0]) * 1e-9,
        None if both is None else (both.a, align_trajectory(both.a, both.b, align)[0]),
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
