"""Clocks against each other: rate, its variation, Allan deviation of the time error, gaps and steps.

Clocks against the sample number: seconds per sample, and their regularity.

The slope is that of the least-squares line through (sample number, clock), over the longest part without a step of the
clock. Its variation is the standard deviation of the slopes of ten equal parts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.fit import ClockRelation, ClockStep, clock_relations, robust_spread
from xitl_cli.logs.clocks.readings import ClockReadings
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Floats, Selection, Stamps, Table, by_instance
from xitl_cli.logs.signals import allan
from xitl_cli.logs.signals.deadlines import simulated_clock_reason
from xitl_cli.logs.signals.gaps import regularity
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.states import last_parameters

LEAST_ROWS = 50
PARTS = 10
EVEN = 0.35  # scatter of the steps, as share of the period, up to which a message is periodic
NEAR = 0.02  # of a rate: distance to a nominal rate
RATES_HZ = (1.0, 2.0, 4.0, 5.0, 8.0, 10.0, 20.0, 25.0, 50.0, 100.0, 200.0, 250.0, 400.0, 500.0, 800.0, 1000.0, 2000.0)
MOST_ROWS = 40
MOST_SAMPLES_DRAWN = 2000
RATE_OFF = 0.01
_SENSORS = ("IMU", "GPS", "MAG", "BARO", "ATT", "RCOU", "XKF1", "NKF1", "POS", "GPA")


@dataclass(frozen=True, slots=True)
class SampleClock:
    """One clock against the sample number."""

    name: str
    message: str
    field: str
    number: Stamps
    """(N,) from 0."""
    clock_ns: Stamps
    """(N,) from 0."""
    at_ns: Stamps
    per_sample_s: float
    """Slope."""
    variation_s: float | None
    """Standard deviation of the slope over ten parts."""
    scatter_s: float
    rate_hz: float | None
    """Nominal rate; None if none is near."""
    gaps: int
    longest_gap_s: float

    @property
    def off_ppm(self) -> float | None:
        """Deviation of the period from the nominal rate."""
        return None if self.rate_hz is None else 1e6 * (self.per_sample_s * self.rate_hz - 1.0)


def sample_clock_section(log: Log, relations: Sequence[ClockRelation], clock: LogClock) -> Section:
    found = sample_clocks(log, relations)
    if not found:
        return Section("time_bases", "Clocks against the sample number")
    rows: list[tuple[Value, ...]] = [
        (
            each.name,
            f"{each.message}.{each.field}",
            len(each.number),
            rounded(each.per_sample_s * 1e3, 6),
            rounded(None if each.variation_s is None else each.variation_s * 1e6, 3),
            rounded(each.scatter_s * 1e6, 1),
            None if each.rate_hz is None else rounded(each.rate_hz, 1),
            rounded(each.off_ppm, 1),
            each.gaps,
            rounded(each.longest_gap_s),
        )
        for each in found
    ]
    columns = (
        "clock", "from", "samples", "ms a sample", "parts vary by (us)", "steps scatter by (us)", "meant (Hz)",
        "off (ppm)", "gaps", "longest gap (s)",
    )  # fmt: skip
    best = found[0]
    facts = (
        Fact("sample_clock", "Clock against the sample number, first", best.name),
        Fact("seconds_per_sample", "Seconds a sample", round(best.per_sample_s, 9), "s"),
    )
    title = "Clocks against the sample number"
    # Findings on the rate of numbered samples. Without a number, a lost row looks like a slow clock.
    return Section(
        "time_bases",
        title,
        facts,
        tuple(
            Finding.notice(
                "time_bases.sample_rate",
                f"{each.name} takes {each.per_sample_s * 1e3:.4f} ms a sample where {each.rate_hz:g} Hz is meant "
                f"({(each.off_ppm or 0.0) * 1e-4:+.1f} %)",
                (Evidence(each.message, each.field),),
                "Find which of the two is wrong: the rate that was set, or the clock.",
            )
            for each in found
            if each.message == "/clocks" and each.off_ppm is not None and abs(each.off_ppm) > RATE_OFF * 1e6
        ),
        (Grid.limited("sample_clocks", title, columns, rows),),
        _plots(found),
    )


def _plots(clocks: list[SampleClock]) -> tuple[Plot, ...]:
    """Residuals of the lines, which the lines themselves do not show, and the lines."""
    traces = []
    for clock in clocks[:6]:
        thin = slice(None, None, max(len(clock.number) // MOST_SAMPLES_DRAWN, 1))
        line_s = clock.per_sample_s * (clock.number - clock.number[0])
        left_s = (clock.clock_ns - clock.clock_ns[0]) * 1e-9 - line_s
        traces.append(
            Trace(clock.name, clock.number[thin].astype(np.float64), (left_s - np.median(left_s))[thin] * 1e3, "points")
        )
    lines = tuple(
        Trace(
            clock.name,
            clock.number[:: max(len(clock.number) // MOST_SAMPLES_DRAWN, 1)].astype(np.float64),
            ((clock.clock_ns - clock.clock_ns[0]) * 1e-9)[:: max(len(clock.number) // MOST_SAMPLES_DRAWN, 1)],
        )
        for clock in clocks[:6]
    )
    return (
        Plot("sample_clocks", "Time base against the sample number", "s", lines, "xy", "sample"),
        Plot("sample_residuals", "Time base minus its line", "ms", tuple(traces), "xy", "sample"),
    )


def sample_clocks(log: Log, relations: Sequence[ClockRelation] = ()) -> list[SampleClock]:
    """Every clock that is read at numbered samples, then messages with an even rate; 40 at most."""
    found: list[SampleClock] = []
    for clock in (*_numbered(log, relations), *_periodic(log, relations)):
        found.append(clock)
        if len(found) == MOST_ROWS:
            break
    return found


def _stepped(relations: Sequence[ClockRelation], key: str) -> list[int]:
    """Instants at which the clocks of a pair stepped, on the log's own time."""
    return [
        step.at_ns
        for relation in relations
        if relation.readings.key.startswith(key)
        for step in relation.steps
        if step.size_s != 0.0
    ]


def _unbroken(at_ns: Stamps, stepped: Sequence[int]) -> slice:
    """Rows of the longest part between steps."""
    cuts = [0, *sorted({int(np.searchsorted(at_ns, one)) for one in stepped}), len(at_ns)]
    begin, end = max(pairwise(cuts), key=lambda part: part[1] - part[0])
    return slice(begin, end)


def _numbered(log: Log, relations: Sequence[ClockRelation]) -> Iterator[SampleClock]:
    """Clocks of /clocks: `sample` against the node's clock; for PS1, the step against the host's clock."""
    table = log.tables.get("/clocks")
    if table is None or not {"node", "sample", "node_ns", "host_ns"} <= set(table.columns):
        return
    nodes = np.asarray(table.values("node"))
    for node in sorted(set(nodes.tolist())):
        mine = Selection(table, nodes == node)
        column = "host_ns" if node == "PS1" else "node_ns"
        numbers = np.asarray(mine.values("sample", raw=True)).astype(np.int64)
        clock_ns = np.asarray(mine.values(column, raw=True)).astype(np.int64)
        begun = mine.stamp_ns > 0  # a burst of exchanges settles the clocks before the run
        whole = _unbroken(mine.stamp_ns[begun], _stepped(relations, f"clocks.{node}"))
        made = _made(
            f"{node}, {'step' if node == 'PS1' else 'exchange'}",
            "/clocks",
            f"sample, {column}",
            numbers[begun][whole],
            clock_ns[begun][whole],
            mine.stamp_ns[begun][whole],
            None,
        )
        if made is not None:
            yield made


def _periodic(log: Log, relations: Sequence[ClockRelation]) -> Iterator[SampleClock]:
    if log.format != "dataflash":
        return
    loop_hz = last_parameters(log).get("SCHED_LOOP_RATE")
    stepped = _stepped(relations, "samples.")
    names = [*(name for name in _SENSORS if name in log.tables), *(name for name in log.tables if name not in _SENSORS)]
    for name in names:
        table = log.tables[name]
        if len(table) < LEAST_ROWS or name.startswith(("ISB", "FILE", "PARM", "FMT", "MULT", "UNIT", "MSG")):
            continue
        for instance, mine in by_instance(table).items():
            label = name if table.instance is None else f"{name} {instance}"
            whole = Selection(mine, _unbroken(mine.stamp_ns, stepped)) if stepped else mine
            numbers = None
            if "SampleUS" in table.columns:
                sampled_ns = np.asarray(whole.values("SampleUS", raw=True)).astype(np.int64) * 1000
                made = _even(f"{label}, sensor's clock", whole, "SampleUS", sampled_ns, loop_hz)
                if made is not None:
                    numbers = made.number
                    yield made
            made = _even(f"{label}, autopilot's clock", whole, "TimeUS", whole.stamp_ns, loop_hz, numbers)
            if made is not None:
                yield made


def _even(
    label: str, table: Table, field: str, clock_ns: Stamps, loop_hz: float | None, numbers: Stamps | None = None
) -> SampleClock | None:
    """Clock of a message; None unless it is even, or if another clock numbers its samples."""
    steps = np.diff(clock_ns).astype(np.float64)
    if len(steps) < LEAST_ROWS or (steps < 0.0).any():
        return None
    if numbers is None:
        usual = float(np.median(steps))
        if not usual > 0.0 or (steps == 0.0).any() or robust_spread(steps) > EVEN * usual:
            return None
        # Number of rows missing at each step. A late row does not count, because its neighbour compensates
        # for it.
        before = np.concatenate(([usual], steps[:-1])) + steps - usual
        after = np.concatenate((steps[1:], [usual])) + steps - usual
        lost: Floats = np.maximum(np.round(np.minimum(np.minimum(before, after), steps) / usual) - 1.0, 0.0)
        numbers = np.concatenate(([0], np.cumsum(1 + lost))).astype(np.int64)
    return _made(label, table.name, field, numbers, clock_ns, table.stamp_ns, loop_hz)


def _made(
    label: str, message: str, field: str, numbers: Stamps, clock_ns: Stamps, at_ns: Stamps, loop_hz: float | None
) -> SampleClock | None:
    if len(numbers) < LEAST_ROWS or numbers[-1] <= numbers[0] or clock_ns[-1] <= clock_ns[0]:
        return None
    x = (numbers - numbers[0]).astype(np.float64)
    y = (clock_ns - clock_ns[0]).astype(np.float64) * 1e-9
    per_sample_s = _slope(x, y)
    if not per_sample_s > 0.0:
        return None
    parts = [_slope(*part) for part in zip(np.array_split(x, PARTS), np.array_split(y, PARTS), strict=True)]
    gaps = regularity(clock_ns)
    with np.errstate(divide="ignore", invalid="ignore"):
        each = np.diff(y) / np.diff(x)
    return SampleClock(
        label,
        message,
        field,
        numbers,
        clock_ns,
        at_ns,
        per_sample_s,
        float(np.std(parts, ddof=1)),
        float(np.std(each[np.isfinite(each)])),
        _meant(per_sample_s, loop_hz),
        0 if gaps is None else gaps.gaps,
        0.0 if gaps is None else gaps.longest_gap_s,
    )


def _slope(x: Floats, y: Floats) -> float:
    away = x - x.mean()
    square = float(np.sum(away * away))
    return float(np.sum(away * y)) / square if square > 0.0 else 0.0


def _meant(per_sample_s: float, loop_hz: float | None) -> float | None:
    """Nominal rate near this period: a whole fraction of the loop's rate, else a round number."""
    rate_hz = 1.0 / per_sample_s
    if loop_hz and loop_hz > 0.0 and rate_hz <= loop_hz * (1.0 + NEAR):
        divided = loop_hz / max(round(loop_hz / rate_hz), 1)
        if abs(divided / rate_hz - 1.0) < NEAR:
            return float(divided)
    return min(
        (each for each in RATES_HZ if abs(each / rate_hz - 1.0) < NEAR),
        key=lambda each: abs(each - rate_hz),
        default=None,
    )


RTC_STEP_S = 0.25  # a UTC message with a shorter delay than any before moves it ahead by up to a period of the receiver


def pair_title(readings: ClockReadings) -> str:
    return f"{readings.second} against {readings.first}"


def pair_key(readings: ClockReadings) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in readings.key).strip("_").lower()


def pair_rate(relation: ClockRelation) -> tuple[float, float | None]:
    """Rate over the pieces with enough readings, and the standard error of the longest piece.

    Each piece is weighted by the cube of its length, because the variance of a slope falls with it.
    """
    pieces = [piece for piece in relation.pieces if piece.slope_error_ppm is not None] or [relation.longest]
    weights = np.array([max((piece.until_ns - piece.from_ns) * 1e-9, 1e-9) ** 3 for piece in pieces])
    rates = np.array([piece.slope_ppm for piece in pieces])
    return float(np.sum(rates * weights) / np.sum(weights)), max(
        pieces, key=lambda piece: piece.until_ns - piece.from_ns
    ).slope_error_ppm


def rate_variation(relation: ClockRelation) -> float | None:
    return float(np.std(relation.window_ppm, ddof=1)) if len(relation.window_ppm) > 1 else None


def real_steps(relation: ClockRelation) -> list[ClockStep]:
    least_s = RTC_STEP_S if relation.readings.key == "rtc" else 0.0
    return [step for step in relation.steps if abs(step.size_s) > least_s]


MOST_POINTS = 4000


def clock_plots(relations: Sequence[ClockRelation], clock: LogClock) -> tuple[Plot, ...]:
    plots: list[Plot] = []
    curves: list[Trace] = []
    for relation in relations:
        readings = relation.readings
        if not relation.residual_s.any():
            continue
        thin = slice(None, None, max(len(readings) // MOST_POINTS, 1))
        marks = tuple(
            Mark(step.at_ns, f"step {step.size_s:+.3f} s" if step.size_s else "rate changes") for step in relation.steps
        )
        plots.append(
            Plot(
                f"residual_{pair_key(readings)}",
                f"{pair_title(readings)}: residual of the offset",
                "ms",
                (Trace("residual", readings.at_ns[thin], relation.residual_s[thin] * 1e3, "points"),),
                marks=marks,
            )
        )
        if len(relation.window_ppm) > 1:
            rows = np.clip(np.searchsorted(readings.first_ns, relation.window_ns), 0, len(readings) - 1)
            plots.append(
                Plot(
                    f"rate_{pair_key(readings)}",
                    f"{pair_title(readings)}: drift in windows of {relation.window_s:.0f} s",
                    "ppm",
                    (Trace("drift", readings.at_ns[rows], relation.window_ppm, "points"),),
                    marks=marks,
                )
            )
        curve = allan_of(relation)
        if curve is not None:
            curves.append(Trace(pair_title(readings), curve.tau_s, curve.deviation))
    if curves:
        plots.append(
            Plot(
                "clock_allan",
                "Allan deviation of the clocks",
                "ADEV (1)",
                tuple(curves),
                "loglog",
                "averaging time (s)",
            )
        )
    return tuple(plots)


def allan_of(relation: ClockRelation) -> allan.AllanCurve | None:
    """Allan deviation of the time error without its drift, over the longest piece; None if that is too short or too
    uneven.

    The deviation of the mean rate over tau is that of the differences of the time error, each over one period.
    """
    piece = relation.longest
    readings = relation.readings
    inside = (readings.first_ns >= piece.from_ns) & (readings.first_ns <= piece.until_ns)
    time_s = (readings.first_ns[inside] - piece.from_ns).astype(np.float64) * 1e-9
    error_s = relation.residual_s[inside]
    if len(time_s) < 40 or not error_s.any():
        return None
    period_s = float(np.median(np.diff(time_s)))
    if not period_s > 0.0:
        return None
    even_s: Floats = np.arange(0.0, time_s[-1], max(period_s, time_s[-1] / 200_000))
    if len(even_s) > 2 * len(time_s):
        return None
    even = np.interp(even_s, time_s, error_s)
    step_s = float(even_s[1] - even_s[0])
    curve = allan.overlapping(np.diff(even) / step_s, step_s)
    known = curve.deviation > 0.0
    if not known.any():
        return None
    return allan.AllanCurve(curve.tau_s[known], curve.deviation[known], curve.relative_error[known])


CRYSTAL_PPM, WRONG_PPM = 100.0, 1000.0  # two crystals of 50 ppm; impossible for a crystal
BEND_PPM = 10.0
LEAST_PIECE_S = 5.0  # on either side of a change of rate
ONE_TROUBLE_S = 5.0  # steps in such a short time have one cause
STEP_WARNING_S = 0.1
SAME_STEP_S, SAME_SIZE = 2.0, 0.2
GAP_PERIODS, GAP_S = 10.0, 5.0
SCALED_PPM = 20_000.0  # the clocks do not measure the same time
SURE = 3.0  # standard errors
MOST_NAMED = 5


def clock_pair_section(log: Log, relations: Sequence[ClockRelation], clock: LogClock) -> Section:
    made_up = bool(simulated_clock_reason(log))
    bends: list[Finding] = []
    for relation in relations:
        for index, step in enumerate(relation.steps):
            before, after = relation.pieces[index], relation.pieces[index + 1]
            change_ppm = after.slope_ppm - before.slope_ppm
            short_ns = min(before.until_ns - before.from_ns, after.until_ns - after.from_ns)
            if short_ns * 1e-9 < LEAST_PIECE_S or abs(change_ppm) < BEND_PPM:
                continue
            if before.slope_error_ppm is None or after.slope_error_ppm is None:
                continue
            error_ppm = float(np.hypot(before.slope_error_ppm, after.slope_error_ppm))
            if abs(change_ppm) < SURE * error_ppm:
                continue
            bends.append(
                Finding.notice(
                    "time_bases.rate_change",
                    f"About {clock.text(step.at_ns)} the rate of {pair_title(relation.readings)} changed from "
                    f"{before.slope_ppm:+.1f} to {after.slope_ppm:+.1f} ppm (standard error {error_ppm:.1f})",
                    (Evidence(relation.readings.message, relation.readings.fields, step.at_ns),),
                    "Temperature changes a crystal by a few ppm only. Look for the source that disciplines that clock.",
                )
            )
    findings = [
        *_steps(relations, clock),
        *(finding for relation in relations for finding in _rates(relation, made_up)),
        *bends,
        *(finding for relation in relations for finding in _gaps(relation, clock)),
    ]
    facts = tuple(fact for relation in relations for fact in _facts(relation))
    return Section(
        "time_bases",
        "Clocks against each other",
        facts,
        tuple(findings),
        (_grid(relations),) if relations else (),
        clock_plots(relations, clock),
    )


def _facts(relation: ClockRelation) -> tuple[Fact, ...]:
    key, title = pair_key(relation.readings), pair_title(relation.readings)
    rate_ppm, error_ppm = pair_rate(relation)
    steps = Fact(f"{key}_steps", f"Steps of {title}", len(real_steps(relation)))
    if error_ppm is None or SURE * error_ppm > WRONG_PPM:  # too short, or too uneven, to determine a rate
        return (steps,)
    return (
        Fact(f"{key}_ppm", f"Drift of {title}", rounded(rate_ppm, 2), "ppm"),
        Fact(f"{key}_error_ppm", f"Standard error of the drift of {title}", rounded(error_ppm, 2), "ppm"),
        steps,
    )


def _grid(relations: Sequence[ClockRelation]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for relation in relations:
        readings = relation.readings
        rate_ppm, error_ppm = pair_rate(relation)
        first_ns = readings.first_ns
        longest_ns = int(np.max(np.diff(first_ns)))
        rows.append(
            (
                pair_title(readings),
                f"{readings.message}: {readings.fields}",
                len(readings),
                rounded(float(first_ns[-1] - first_ns[0]) * 1e-9, 1),
                rounded(rate_ppm, 2),
                rounded(error_ppm, 2),
                rounded(rate_variation(relation), 2),
                rounded(relation.longest.residual_s * 1e3, 4),
                len(real_steps(relation)),
                rounded(longest_ns * 1e-9),
            )
        )
    columns = (
        "clocks", "from", "readings", "over (s)", "drift (ppm)", "standard error (ppm)", "windows vary by (ppm)",
        "readings scatter by (ms)", "steps", "longest gap (s)",
    )  # fmt: skip
    return Grid.limited("clock_pairs", "Clocks against each other", columns, rows)


def _steps(relations: Sequence[ClockRelation], clock: LogClock) -> Iterator[Finding]:
    """One finding per step, with every pair that shows it. Steps close together share one finding."""
    groups: list[list[tuple[ClockRelation, ClockStep]]] = []
    every = sorted(
        ((relation, step) for relation in relations for step in real_steps(relation)), key=lambda each: each[1].at_ns
    )
    for relation, step in every:
        for group in groups:
            _, known = group[0]
            near = abs(step.at_ns - known.at_ns) * 1e-9 < SAME_STEP_S + abs(known.size_s)
            alike = abs(abs(step.size_s) - abs(known.size_s)) < SAME_SIZE * abs(known.size_s)
            follows = relation is group[-1][0] and (step.at_ns - group[-1][1].at_ns) * 1e-9 < ONE_TROUBLE_S
            if (near and alike and relation not in [one for one, _ in group]) or follows:
                group.append((relation, step))
                break
        else:
            groups.append([(relation, step)])
    yield from (_step(group, clock) for group in groups)


def _step(group: list[tuple[ClockRelation, ClockStep]], clock: LogClock) -> Finding:
    best = min((relation for relation, _ in group), key=lambda each: each.longest.residual_s)
    steps = [step for relation, step in group if relation is best]
    pair = f"{best.readings.second} stepped {{}} against {best.readings.first}"
    if len(steps) == 1:
        what = f"At {clock.text(steps[0].at_ns)} {pair.format(_way(steps[0].size_s))}"
    else:
        span = f"From {clock.text(steps[0].at_ns)} to {clock.text(steps[-1].at_ns)}"
        # Change from the line before the first of these steps to the line after the last.
        before, after = (best.pieces[best.steps.index(one) + more] for one, more in ((steps[0], 0), (steps[-1], 1)))
        at_ns = np.array([steps[-1].first_ns], dtype=np.int64)
        whole_s = float(after.offset_at(at_ns)[0] - before.offset_at(at_ns)[0]) * 1e-9
        what = f"{span} {pair.format(f'{len(steps)} times, in all {_way(whole_s)}')}"
    largest_s = max(abs(step.size_s) for step in steps)
    return Finding(
        "time_bases.step",
        Severity.WARNING if largest_s >= STEP_WARNING_S else Severity.NOTICE,
        what,
        tuple(
            Evidence(each.readings.message, each.readings.fields, one.at_ns, value=f"{one.size_s:+.4f} s")
            for each, one in sorted(group, key=lambda each: each[0] is not best)[:MOST_NAMED]
        ),
        "Find the cause that set or stopped that clock. Intervals across this time are wrong.",
    )


def _way(size_s: float) -> str:
    size = f"{abs(size_s):.3f} s" if abs(size_s) >= 0.1 else f"{1e3 * abs(size_s):.1f} ms"
    return f"{size} {'ahead' if size_s > 0.0 else 'back'}"


def _rates(relation: ClockRelation, made_up: bool) -> Iterator[Finding]:
    readings = relation.readings
    if readings.key.startswith("samples.") and made_up:
        return
    rate_ppm, error_ppm = pair_rate(relation)
    sure = error_ppm is not None and abs(rate_ppm) - CRYSTAL_PPM > SURE * error_ppm
    if not sure or abs(rate_ppm) <= CRYSTAL_PPM:
        return
    if abs(rate_ppm) > SCALED_PPM:
        times = 1.0 + relation.longest.slope_ppm * 1e-6
        fast, slow, ratio = (
            (readings.second, readings.first, times) if times >= 1.0 else (readings.first, readings.second, 1.0 / times)
        )
        yield Finding.notice(
            "time_bases.scaled",
            f"{fast} went {ratio:.2f} times as fast as {slow}: one of them is a simulation's",
            (Evidence(readings.message, readings.fields, value=f"{ratio:.2f}"),),
            "Rates and delays in this log have two kinds of seconds. Use one clock for comparisons.",
        )
        return
    severity = Severity.NOTICE if made_up or abs(rate_ppm) < WRONG_PPM else Severity.WARNING
    per_hour_ms = abs(rate_ppm) * 3.6
    yield Finding(
        "time_bases.drift",
        severity,
        f"{pair_title(readings)} runs {abs(rate_ppm):.0f} ppm {'fast' if rate_ppm > 0.0 else 'slow'} "
        f"(standard error {error_ppm:.1f}), {per_hour_ms:.0f} ms an hour",
        (Evidence(readings.message, readings.fields, value=f"{rate_ppm:+.1f} ppm"),),
        "Crystals differ by tens of ppm at most: check whether one of the clocks is simulated, disciplined or "
        "stopped. Map stamps through this relation before comparing them.",
    )


def even_findings(relations: Sequence[ClockRelation]) -> tuple[Finding, ...]:
    """An OK finding about the pairs with a well-known rate, for logs without other findings."""
    # Relations with a rate that is known more precisely than its limit.
    judged = [
        relation
        for relation in relations
        if relation.longest.slope_error_ppm is not None and SURE * relation.longest.slope_error_ppm < CRYSTAL_PPM
    ]
    if not judged:
        return ()
    pairs = pair_title(judged[0].readings) if len(judged) == 1 else f"{len(judged)} pairs of clocks"
    said = f"No step and no drift of more than {CRYSTAL_PPM:.0f} ppm: {pairs}"
    return (Finding.ok("time_bases.even", said),)


def _gaps(relation: ClockRelation, clock: LogClock) -> Iterator[Finding]:
    """Gaps of clocks that are read on purpose. Other readings arrive with their messages."""
    readings = relation.readings
    if not readings.key.startswith(("clocks.", "timesync.")):
        return
    between_s = np.diff(readings.first_ns).astype(np.float64) * 1e-9
    usual_s = float(np.median(between_s))
    long = np.flatnonzero(between_s > max(GAP_PERIODS * usual_s, GAP_S if usual_s > 0.5 else 1.0))
    if not len(long):
        return
    worst = int(long[np.argmax(between_s[long])])
    at_ns = int(readings.at_ns[worst])
    yield Finding.notice(
        "time_bases.gap",
        f"{readings.second} was not read for {between_s[worst]:.1f} s after {clock.text(at_ns)}, else every "
        f"{usual_s:.2f} s; {len(long)} such gaps",
        (Evidence(readings.message, readings.fields, at_ns, int(readings.at_ns[worst + 1])),),
        "Look at the links at that time: no exchange succeeded.",
    )


_LACKS = {
    "dataflash": "The log has only the autopilot's clock. A GPS fix (GPA) or UTC in PM.R is needed to judge it.",
    "mcap": "The recording has no second clock: no /clocks (runs in real time), telemetry, or stamps in headers.",
    "tlog": "No message has the autopilot's time (time_boot_ms), so the clocks cannot be compared.",
}


def analyse(log: Log) -> Section | None:
    clock = LogClock(log)
    found = clock_relations(log)
    pairs = clock_pair_section(log, found, clock)
    samples = sample_clock_section(log, found, clock)
    if not found and not samples.grids:
        return None
    findings = (*pairs.findings, *samples.findings)
    if not findings:
        findings = even_findings(found)
    return Section(
        "time_bases",
        "Time bases",
        (*pairs.facts, *samples.facts),
        findings,
        (*pairs.grids, *samples.grids),
        (*pairs.plots, *samples.plots),
        () if found else (_LACKS.get(log.format, _LACKS["mcap"]),),
    )
