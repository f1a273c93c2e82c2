"""Clocks against the sample number: seconds per sample, and their regularity.

The slope is that of the least-squares line through (sample number, clock), over the longest part without a step of the
clock. Its variation is the standard deviation of the slopes of ten equal parts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from xitl_cli.logs.clocks.fit import ClockRelation, robust_spread
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Plot, Section, Trace, Value
from xitl_cli.logs.model.table import Floats, Selection, Stamps, Table, by_instance
from xitl_cli.logs.signals.gaps import regularity
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.states import last_parameters

LEAST_ROWS = 50
PARTS = 10
EVEN = 0.35  # scatter of the steps, as share of the period, up to which a message is periodic
NEAR = 0.02  # of a rate: distance to a nominal rate
RATES_HZ = (1.0, 2.0, 4.0, 5.0, 8.0, 10.0, 20.0, 25.0, 50.0, 100.0, 200.0, 250.0, 400.0, 500.0, 800.0, 1000.0, 2000.0)
MOST_ROWS = 40
MOST_POINTS = 2000
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
                "See which of the two is not what it should be: the rate that was set, or the clock.",
            )
            for each in found
            if each.message == "/clocks" and each.off_ppm is not None and abs(each.off_ppm) > RATE_OFF * 1e6
        ),
        (Grid.limited("sample_clocks", title, columns, rows),),
        _plots(found),
    )


def _plots(found: list[SampleClock]) -> tuple[Plot, ...]:
    """Residuals of the lines, which the lines themselves do not show, and the lines."""
    traces = []
    for each in found[:6]:
        thin = slice(None, None, max(len(each.number) // MOST_POINTS, 1))
        line_s = each.per_sample_s * (each.number - each.number[0])
        left_s = (each.clock_ns - each.clock_ns[0]) * 1e-9 - line_s
        traces.append(
            Trace(each.name, each.number[thin].astype(np.float64), (left_s - np.median(left_s))[thin] * 1e3, "points")
        )
    lines = tuple(
        Trace(
            each.name,
            each.number[:: max(len(each.number) // MOST_POINTS, 1)].astype(np.float64),
            ((each.clock_ns - each.clock_ns[0]) * 1e-9)[:: max(len(each.number) // MOST_POINTS, 1)],
        )
        for each in found[:6]
    )
    return (
        Plot("sample_clocks", "Time base against the sample number", "s", lines, "xy", "sample"),
        Plot("sample_residuals", "Time base less its line", "ms", tuple(traces), "xy", "sample"),
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
