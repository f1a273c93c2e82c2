"""Alignment of several logs of one run on one time line.

If both logs have clock records, these align the logs, and a shared signal checks the result. Otherwise, correlation of
a shared signal aligns them. The reference is the host's recording, or the first log.

Delay between the same signal in two logs, over an unknown offset of hours.

The normalised cross-correlation of two records is computed at every shift by FFT. Each shift uses the mean and scatter
of the overlapping part. A peak counts if it exceeds the highest value that chance reaches over as many independent
shifts. Records of a limited bandwidth have fewer independent samples than samples (Bartlett, J. R. Stat. Soc. Suppl. 8,
1946). The highest of n normal values is about sqrt(2 ln n).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.clocks.fit import ClockRelation, clock_relations, robust_line, robust_spread
from xitl_cli.logs.clocks.readings import HOST, SIMULATION, UTC
from xitl_cli.logs.clocks.time_line import NOT_ALIGNED, LogPlacement, placement_from
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Floats, Stamps, rising, whole_ns
from xitl_cli.logs.signals import armed, ground_speed, outputs, yaw, yaw_rate
from xitl_cli.logs.signals.series import Series
from xitl_cli.logs.signals.states import LOCKSTEP, first_text

COARSE_HZ = 5.0
FINE_HZ = 50.0
MOST_SAMPLES = 1 << 20
LEAST_OVERLAP_S = 20.0
LEAST_SHARE = 0.2  # of the shorter record
MARGIN = 1.5  # times the value that chance reaches
LEAST_PEAK = 0.4
RIVAL = 0.85  # a second peak of this relative height makes the first ambiguous
RIVAL_AWAY_S = 3.0
REACH_S = 2.0
PARTS = 8
PART_S = 20.0


@dataclass(frozen=True, slots=True)
class SignalMatch:
    """Best match of two records."""

    shift_ns: int
    """Add it to a stamp of the second record to get the instant on the time of the first."""
    peak: float
    """Correlation at the shift."""
    chance: float
    """Highest correlation that chance reaches over as many shifts."""
    rival: float
    """Highest peak elsewhere."""
    parts: Floats
    """(k,) shift in parts of the record, s relative to `shift_ns`."""
    at_ns: Stamps
    """(k,) centres of the parts, on the second record's time."""

    @property
    def sure(self) -> bool:
        return self.peak > max(LEAST_PEAK, MARGIN * self.chance) and self.rival < RIVAL * self.peak


def match_signals(
    one: Series, other: Series, about_ns: int | None = None, within_s: float | None = None
) -> SignalMatch | None:
    """Return the best match of `other` with `one`. None if either is constant or too short.

    about_ns, within_s: limit the search to shifts within `within_s` of `about_ns`.
    """
    # Coarse search over all shifts.
    longest_s = max(float(series.stamp_ns[-1] - series.stamp_ns[0]) * 1e-9 for series in (one, other))
    rate_hz = min(COARSE_HZ, MOST_SAMPLES / max(longest_s, 1.0))
    a, b = _even(one, rate_hz), _even(other, rate_hz)
    least = max(LEAST_OVERLAP_S * rate_hz, LEAST_SHARE * min(len(a), len(b)))
    if min(len(a), len(b)) < least or a.std() <= 0.0 or b.std() <= 0.0:
        return None
    lags, values, overlap = _normalised(a, b)
    allowed = overlap >= least
    base_ns = int(one.stamp_ns[0]) - int(other.stamp_ns[0])
    if about_ns is not None and within_s is not None:
        allowed &= np.abs(lags / rate_hz - (about_ns - base_ns) * 1e-9) <= within_s
    if not allowed.any():
        return None
    scores = np.where(allowed, values, -np.inf)
    best = int(np.argmax(scores))
    # Values that chance and the second-best shift reach.
    independent = overlap * _independent(a, b)
    noise = 1.0 / np.sqrt(np.maximum(independent[best], 4.0))
    tries = max(float(np.sum(allowed)) * _independent(a, b), 2.0)
    chance = float(min(noise * np.sqrt(2.0 * np.log(tries)), 1.0))
    weight = np.sqrt(overlap / overlap[best])  # a short overlap correlates by chance
    away = allowed & (np.abs(lags - lags[best]) > RIVAL_AWAY_S * rate_hz)
    rival = float(np.max(np.where(away, values * np.minimum(weight, 1.0), 0.0), initial=0.0))
    # Fine search about the best shift, over the whole record and in its parts.
    coarse_s = _peak(lags, scores, best) / rate_hz
    shift_ns = base_ns + round(coarse_s * 1e9)
    finer_s, peak = _finer(one, other, shift_ns)
    shift_ns += round(finer_s * 1e9)
    parts, at_ns = _parts(one, other, shift_ns)
    return SignalMatch(shift_ns, max(peak, float(values[best])), chance, rival, parts, at_ns)


def _even(series: Series, rate_hz: float) -> Floats:
    """(N,) values at an even rate from the first stamp. Denser samples are averaged, to remove content above half the
    rate."""
    span_s = float(series.stamp_ns[-1] - series.stamp_ns[0]) * 1e-9
    count = int(min(span_s * rate_hz, MOST_SAMPLES)) + 1
    where = (series.stamp_ns - series.stamp_ns[0]).astype(np.float64) * 1e-9 * rate_hz
    cell = np.minimum(np.round(where).astype(np.int64), count - 1)
    total = np.bincount(cell, series.values, minlength=count)
    number = np.bincount(cell, minlength=count)
    known = np.flatnonzero(number)
    return np.interp(np.arange(count), known, total[known] / number[known])


def _normalised(a: Floats, b: Floats) -> tuple[Stamps, Floats, Floats]:
    """Correlation of a[i + lag] with b[i] at every lag, and the number of overlapping samples."""
    a, b = a - a.mean(), b - b.mean()
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    ones_a, ones_b = np.ones(len(a)), np.ones(len(b))

    def spectrum(x: Floats) -> NDArray[np.complex128]:
        return np.fft.rfft(x, size)

    fa, fb = spectrum(a), np.conj(spectrum(b))
    na, nb = spectrum(ones_a), np.conj(spectrum(ones_b))

    def back(x: NDArray[np.complex128]) -> Floats:
        full = np.fft.irfft(x, size)
        return np.concatenate((full[size - len(b) + 1 :], full[: len(a)]))

    count = np.maximum(np.round(back(na * nb)), 1.0)
    sum_a, sum_b = back(fa * nb), back(na * fb)
    square_a, square_b = back(spectrum(a * a) * nb), back(na * np.conj(spectrum(b * b)))
    cross = back(fa * fb) - sum_a * sum_b / count
    scale = np.sqrt(
        np.maximum(square_a - sum_a * sum_a / count, 0.0) * np.maximum(square_b - sum_b * sum_b / count, 0.0)
    )
    floor = 1e-3 * len(b) * a.std() * b.std()  # without movement there is nothing to compare
    values = np.where(scale > floor, cross / np.maximum(scale, floor), 0.0)
    return np.arange(-len(b) + 1, len(a)), values, count


def _independent(a: Floats, b: Floats) -> float:
    """Share of independent samples, from the product of the autocorrelations."""
    reach = min(len(a), len(b)) // 2
    product = _autocorrelation(a, reach) * _autocorrelation(b, reach)
    return float(np.clip(1.0 / max(1.0 + 2.0 * float(np.sum(product[1:])), 1.0), 1e-4, 1.0))


def _autocorrelation(x: Floats, reach: int) -> Floats:
    x = x - x.mean()
    size = 1 << int(np.ceil(np.log2(2 * len(x))))
    power = np.fft.irfft(np.abs(np.fft.rfft(x, size)) ** 2, size)[: max(reach, 1)]
    own: Floats = power / power[0] if power[0] > 0.0 else np.zeros(len(power))
    return own


def _peak(lags: Stamps, values: Floats, best: int) -> float:
    """Position of the peak between the samples, by the parabola through three of them."""
    if 0 < best < len(values) - 1 and np.isfinite(values[best - 1 : best + 2]).all():
        low, top, high = values[best - 1 : best + 2].tolist()
        curve = low - 2.0 * top + high
        if curve < 0.0:
            return float(lags[best] + 0.5 * (low - high) / curve)
    return float(lags[best])


def _finer(
    one: Series, other: Series, shift_ns: int, from_ns: int | None = None, until_ns: int | None = None
) -> tuple[float, float]:
    """Seconds to add to a known shift, and the correlation there. from_ns, until_ns: use only this part of `other`."""
    begin = max(int(one.stamp_ns[0]) - shift_ns, int(other.stamp_ns[0]), from_ns or -(1 << 62))
    end = min(int(one.stamp_ns[-1]) - shift_ns, int(other.stamp_ns[-1]), until_ns or 1 << 62)
    period_ns = round(1e9 / FINE_HZ)
    reach = round(REACH_S * FINE_HZ)
    count = min((end - begin) // period_ns + 1, MOST_SAMPLES)
    if count < 4 * reach:
        return 0.0, -1.0
    grid = begin + period_ns * np.arange(count, dtype=np.int64)
    b = _smooth(other, grid)
    a = _smooth(one, grid + shift_ns)
    middle = b[reach:-reach]
    lags = np.arange(-reach, reach + 1)
    values = np.array([_correlated(a[reach + lag : len(a) - reach + lag], middle) for lag in lags])
    best = int(np.argmax(values))
    return _peak(lags, values, best) / FINE_HZ, float(values[best])


def _smooth(series: Series, stamp_ns: Stamps) -> Floats:
    """Linear interpolation between samples. Denser samples are averaged over a period of the grid."""
    x = (series.stamp_ns - series.stamp_ns[0]).astype(np.float64)
    wanted = (stamp_ns - series.stamp_ns[0]).astype(np.float64)
    if len(x) < 2:
        return np.full(len(stamp_ns), float(series.values[0]))
    area = np.concatenate(([0.0], np.cumsum(0.5 * (series.values[1:] + series.values[:-1]) * np.diff(x))))
    half = max(0.5e9 / FINE_HZ, 0.5 * float(np.median(np.diff(x))))
    low, high = np.clip(wanted - half, x[0], x[-1]), np.clip(wanted + half, x[0], x[-1])
    width = high - low
    mean = (np.interp(high, x, area) - np.interp(low, x, area)) / np.maximum(width, 1.0)
    smooth: Floats = np.where(width > 1.0, mean, np.interp(wanted, x, series.values))
    return smooth


def _correlated(a: Floats, b: Floats) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return float(np.sum(a * b)) / scale if scale > 0.0 else 0.0


def _parts(one: Series, other: Series, shift_ns: int) -> tuple[Floats, Stamps]:
    """Shifts of parts of the record, each by itself, and their centres. Parts without a clear peak are omitted."""
    begin = max(int(one.stamp_ns[0]) - shift_ns, int(other.stamp_ns[0]))
    end = min(int(one.stamp_ns[-1]) - shift_ns, int(other.stamp_ns[-1]))
    number = int(min(PARTS, (end - begin) * 1e-9 / PART_S))
    shifts: list[float] = []
    centres: list[int] = []
    for index in range(number):
        from_ns = begin + (end - begin) * index // number
        until_ns = begin + (end - begin) * (index + 1) // number
        further_s, peak = _finer(one, other, shift_ns, from_ns, until_ns)
        if peak > LEAST_PEAK and abs(further_s) < 0.95 * REACH_S:
            shifts.append(further_s)
            centres.append((from_ns + until_ns) // 2)
    values = np.array(shifts)
    good = np.abs(values - np.median(values)) <= max(6.0 * robust_spread(values), 0.05) if len(values) else values > 0.0
    return values[good], np.array(centres, dtype=np.int64)[good]


LEAST_ERROR_S = 2e-3
MOST_DRIFT = 2e-3
EDGE_S = 0.05
MOVES = {"deg/s": 1.0, "m/s": 0.2, "us": 15.0, "": 0.1}
"""Scatter by unit above which a signal is more than noise."""


def shared_signals(one: Log, other: Log) -> Iterator[tuple[str, Series, Series]]:
    """Yield the shared signals with their names, the most distinctive first."""
    for name, signal_of in (("the turn rate", _turn_rate), ("the speed over ground", ground_speed)):
        first = signal_of(one)
        second = None if first is None else signal_of(other)
        if first is not None and second is not None:
            yield name, first, second
    ours, theirs = outputs(one), outputs(other)
    for channel in sorted(set(ours) & set(theirs)):
        if ours[channel].values.std() > 0.0 and theirs[channel].values.std() > 0.0:
            yield f"motor output {channel}", ours[channel], theirs[channel]
    first, second = _arming_series(one), _arming_series(other)
    if first is not None and second is not None:
        yield "arming", first, second


def _turn_rate(log: Log) -> Series | None:
    """Measured yaw rate, or the derivative of the heading."""
    measured = yaw_rate(log)
    if measured is not None and len(measured.values) > 2 and measured.values.std() > 0.0:
        return measured
    heading = yaw(log)
    if heading is None or len(heading.values) < 3:
        return None
    turned_deg = np.unwrap(heading.values, period=360.0)
    dt_s = np.diff(heading.stamp_ns).astype(np.float64) * 1e-9
    middle = heading.stamp_ns[:-1] + np.diff(heading.stamp_ns) // 2
    return Series(middle, np.diff(turned_deg) / dt_s, "deg/s", heading.source)


def _arming_series(log: Log) -> Series | None:
    """Arming as 0 and 1; None if it does not change within the log."""
    span = log.span_ns
    spans = armed(log)
    if span is None or not spans:
        return None
    edge_ns = round(EDGE_S * 1e9)
    stamps, values = [span[0]], [0.0]
    for armed_span in spans:
        for at_ns, value in ((armed_span.from_ns, 1.0), (armed_span.until_ns, 0.0)):
            if stamps[-1] + edge_ns < at_ns < span[1]:
                stamps += [at_ns - edge_ns // 2, at_ns + edge_ns // 2]
                values += [values[-1], value]
    if len(stamps) == 1:
        return None
    keep = [0, *(i for i in range(1, len(stamps)) if stamps[i] > stamps[i - 1])]
    return Series(np.array(stamps)[keep], np.array(values)[keep], "", "armed")


def moved_to_reference(series: Series, placement: LogPlacement) -> Series:
    """The series on the reference's time."""
    stamps = placement.on_reference(series.stamp_ns)
    ahead = rising(stamps)
    return replace(series, stamp_ns=stamps[ahead], values=series.values[ahead])


def exceeds_noise(series: Series) -> bool:
    """Whether the series has more than noise. If so, the same signal in another log must resemble it."""
    values = series.values[: len(series.values) // 10 * 10].reshape(-1, 10).mean(axis=1)
    return bool(len(values) > 10 and float(np.std(values)) > MOVES.get(series.unit, np.inf))


def offset_line(match: SignalMatch, span_ns: tuple[int, int]) -> tuple[int, int, float, float]:
    """Return the line of a match: instant of its offset (log's time), offset (ns), drift (1), and the error of both
    (s).

    The drift is 0 unless the parts show more than their scatter. The error is two standard deviations at the farther
    end of the log.
    """
    middle_ns = (span_ns[0] + span_ns[1]) // 2
    if len(match.parts) < 3:
        spread_s = float(np.max(np.abs(match.parts), initial=0.0)) if len(match.parts) else 0.05
        return middle_ns, match.shift_ns, 0.0, max(2.0 * spread_s, LEAST_ERROR_S, 0.02)
    about_ns = int(np.mean(match.at_ns.astype(np.float64) - match.at_ns[0])) + int(match.at_ns[0])
    x = (match.at_ns - about_ns).astype(np.float64) * 1e-9
    slope, value_s = robust_line(x, match.parts)
    error_s = match.parts - value_s - slope * x
    count = len(x)
    sigma_s = max(float(np.sqrt(np.sum(error_s**2) / max(count - 2, 1))), 0.5 * LEAST_ERROR_S)
    slope_sigma = sigma_s / float(np.sqrt(np.sum(x * x)))
    far_s = max(abs(span_ns[0] - about_ns), abs(span_ns[1] - about_ns)) * 1e-9
    if abs(slope) < 3.0 * slope_sigma or abs(slope) > MOST_DRIFT:
        value_s = float(np.median(match.parts))
        sigma_s = max(float(np.std(match.parts)), sigma_s)
        return about_ns, match.shift_ns + round(value_s * 1e9), 0.0, max(2.0 * sigma_s, LEAST_ERROR_S)
    total_s = 2.0 * float(np.hypot(sigma_s / np.sqrt(count), slope_sigma * far_s))
    return about_ns, match.shift_ns + round(value_s * 1e9), slope, max(total_s, LEAST_ERROR_S)


BOOT, AGENT = "the autopilot's clock", "the agent's clock"
BEHIND_AGENT = "node autopilot"
OURS = "xitl "


@dataclass(frozen=True, slots=True)
class ClockChain:
    """Conversion from a log's own time to the reference."""

    to_reference: Callable[[Stamps], Stamps]
    breaks_ns: tuple[int, ...]
    """Bends and steps of the conversion, on the log's own time."""
    error_s: float
    method: str
    sentence: str


@dataclass(frozen=True, slots=True)
class _Way:
    """Conversion from a log's own time to a named clock and back."""

    clock: str
    out: Callable[[Stamps], Stamps]
    back: Callable[[Stamps], Stamps]
    breaks_ns: tuple[int, ...]
    error_s: float
    method: str
    by: str


def chains(reference: Log, log: Log) -> Iterator[ClockChain]:
    """Yield every possible conversion. It does not check whether two clocks since boot belong to the same autopilot."""
    theirs, ours = ways(reference), ways(log)
    if any(_lockstep(*pair) for pair in ((reference, log), (log, reference))):
        yield ClockChain(
            lambda stamp_ns: stamp_ns,
            (),
            1e-3,
            "same clock",
            "both are stamped with the simulation time of a lockstep run",
        )
    for mine in ours:
        for other in theirs:
            own_both = not mine.by and not other.by and mine.clock in (BOOT, AGENT)
            if _is_same_clock(mine.clock, other.clock) and not own_both:  # clocks of two boots are different clocks
                yield _joined(mine, other)


def _is_same_clock(one: str, other: str) -> bool:
    boots = (BOOT, AGENT, "autopilot ", "node ")
    if one.startswith("autopilot ") and other.startswith("autopilot "):
        return one == other
    if one == other:
        return True
    nodes = [clock for clock in (one, other) if clock.startswith("node ")]
    own = [clock for clock in (one, other) if clock in (BOOT, AGENT)]
    if nodes and own:  # another autopilot behind an agent has its own clock
        return (nodes[0] == BEHIND_AGENT) == (own[0] == BOOT)
    return one.startswith(boots) and other.startswith(boots) and len(nodes) < 2 and len(own) < 2


def _joined(mine: _Way, other: _Way) -> ClockChain:
    # A break of the other log on this log's time: the middle of the interval that this log's clock jumped over there.
    breaks_ns = list(mine.breaks_ns)
    for at_ns in other.breaks_ns:
        ends, begins = mine.back(other.out(np.array([at_ns - 1, at_ns], dtype=np.int64))).tolist()
        breaks_ns.append(int(begins - max(begins - ends, 0) // 2))
    method = other.method if mine.by == "" else mine.method
    by = ", ".join(dict.fromkeys(part for part in (mine.by, other.by) if part))
    return ClockChain(
        lambda stamp_ns: other.back(mine.out(stamp_ns)),
        tuple(breaks_ns),
        float(np.hypot(mine.error_s, other.error_s)),
        "telemetry" if "telemetry" in (mine.method, other.method) else method,
        f"over {other.clock}, by {by}" if by else f"both are stamped by {mine.clock}",
    )


def _lockstep(reference: Log, log: Log) -> bool:
    """Whether both are stamped with the simulation time of a lockstep run."""
    if reference.base != "simulation" or "/misses" in reference.tables or _in_real_time(reference):
        return False
    if log.base == "simulation":
        return not _in_real_time(log)
    return log.format == "dataflash" and first_text(log, LOCKSTEP) is not None


def _in_real_time(log: Log) -> bool:
    return any(relation.readings.key == "clocks.PS1" for relation in clock_relations(log))


def ways(log: Log) -> list[_Way]:
    """Clocks to which the log's own time can be converted, its own first."""
    own = {"boot": BOOT if first_text(log, OURS) is None else AGENT, "simulation": SIMULATION, "utc": UTC}.get(log.base)
    known: list[_Way] = []
    if own is not None and log.format != "tlog":
        known.append(_Way(own, _as_is, _as_is, (), 0.0, "clock records", ""))
    elif own is not None:  # the ground station's UTC is the clock of its computer
        known.append(_Way(UTC, _as_is, _as_is, (), 0.5, "UTC", "the ground station's UTC"))
    fitted = clock_relations(log)
    host = next((relation for relation in fitted if relation.readings.key == "clocks.PS1"), None)
    boots = {relation.readings.first: relation for relation in fitted if relation.readings.key.startswith("boot.")}
    for relation in fitted:
        if relation.readings.key.startswith("system_time."):
            way = _reported_utc(relation, boots)
        else:
            way = _way(relation, host)
        if way is not None:
            known.append(way)
    return known


def _reported_utc(reported: ClockRelation, boots: Mapping[str, ClockRelation]) -> _Way | None:
    """UTC as the autopilot reports it, converted through its own clock."""
    boot = boots.get(reported.readings.first)
    if boot is None:
        return None
    return _Way(
        UTC,
        lambda stamp_ns: reported.to_second(boot.to_first(stamp_ns)),
        lambda utc_ns: boot.to_second(reported.to_first(utc_ns)),
        _breaks(boot, own_is_first=False),
        float(np.hypot(_error_s(reported), _error_s(boot))),
        "UTC",
        f"{reported.readings.message} ({reported.readings.fields})",
    )


def _as_is(stamp_ns: Stamps) -> Stamps:
    return stamp_ns


def _way(relation: ClockRelation, host: ClockRelation | None) -> _Way | None:
    readings = relation.readings
    key, error_s = readings.key, _error_s(relation)
    by = f"{readings.message} ({readings.fields})"
    if key == "clocks.PS1":
        return None
    node_clock = f"node {key.removeprefix('clocks.')}"
    if key.startswith("clocks.") and readings.first != SIMULATION:
        if readings.first != HOST or host is None:
            return None
        # Breaks of a node's clock, given on the host's clock, in simulation time.
        at_host = np.array([step.first_ns for step in relation.steps], dtype=np.int64)
        return _Way(
            node_clock,
            lambda stamp_ns: relation.to_second(host.to_second(stamp_ns)),
            lambda node_ns: host.to_first(relation.to_first(node_ns)),
            _breaks(host, own_is_first=True) + tuple(host.to_first(at_host).tolist()),
            float(np.hypot(error_s, _error_s(host))),
            "clock records",
            by,
        )
    rules = (
        # beginning of the key, the other clock, whether the log's own clock is the first one, method
        ("clocks.", node_clock, True, "clock records"),
        ("boot.", readings.first, False, "telemetry"),
        ("gps", UTC, False, "UTC"),
        ("rtc", UTC, True, "UTC"),
        ("samples.", SIMULATION, False, "clock records"),
    )
    for beginning, clock, own_is_first, method in rules:
        if key.startswith(beginning):
            ways = (relation.to_second, relation.to_first)
            out, back = ways if own_is_first else ways[::-1]
            return _Way(clock, out, back, _breaks(relation, own_is_first), error_s, method, by)
    return None


def _breaks(relation: ClockRelation, own_is_first: bool) -> tuple[int, ...]:
    if not own_is_first:
        return relation.second_bounds_ns
    return tuple(int(relation.readings.first_ns[step.index]) for step in relation.steps)


def _error_s(relation: ClockRelation) -> float:
    """Two standard deviations of the lines, plus the uncertainty from delays.

    For an exchange, this is half of the shortest round trip. Otherwise it is the scatter of the delays, because their
    minimum is unknown.
    """
    readings = relation.readings
    line_s = 2.0 * max(piece.offset_error_s for piece in relation.pieces)
    if readings.floor_ns is not None:
        open_s = 0.5e-9 * float(np.min(readings.offset_ns - readings.floor_ns))
    elif readings.late:
        open_s = 2.0 * max(piece.residual_s for piece in relation.pieces)
    else:
        open_s = 0.0
    bends_s = max((piece.residual_s for piece in relation.pieces), default=0.0) if not readings.late else 0.0
    return line_s + open_s + bends_s + readings.resolution_s + readings.slack_s


CHECK_WITHIN_S = 5.0
CHECK_MARGIN_S = 0.2  # one log may lag in the same motion: signals have different filters, and telemetry waits
CONTRADICTED = 0.25


def align_logs(logs: Sequence[Log]) -> list[LogPlacement]:
    """Return one placement per log, in the same order.

    Never raises: the placement of a log that cannot be aligned gives the reason.
    """
    if not logs:
        return []
    reference = reference_of(logs)
    return [
        LogPlacement(log, 0, 0.0, None, "reference", True, "the report uses its time")
        if log is reference
        else _placed(reference, log)
        for log in logs
    ]


def reference_of(logs: Sequence[Log]) -> Log:
    """The host's recording of a run, or another recording of it, or the first log."""
    ours = [log for log in logs if log.base == "simulation" and "/clocks" in log.tables]
    runs = ours or [log for log in logs if log.base == "simulation"]
    return (runs or list(logs))[0]


@dataclass(frozen=True, slots=True)
class _Check:
    """Check of a placement by a shared signal."""

    signal: str
    away_s: float | None
    """Shift that the signal would apply; None if undecided."""
    contradicts: bool = False


def _placed(reference: Log, log: Log) -> LogPlacement:
    span_ns = log.span_ns
    if span_ns is None or reference.span_ns is None:
        return _not_aligned(log, "one of the logs has no row with a time stamp")
    why: list[str] = []
    unchecked: LogPlacement | None = None
    for chain in sorted(chains(reference, log), key=lambda chain: chain.error_s):
        about = {"error_s": chain.error_s, "method": chain.method, "sentence": chain.sentence}
        placement = placement_from(log, span_ns, chain.to_reference, chain.breaks_ns, **about)
        if _apart(reference, placement):
            unchecked = unchecked or replace(
                placement, sentence=f"{placement.sentence}; the logs do not overlap in time, so they are not of one run"
            )
            continue
        check = _check(reference, log, placement)
        if check.contradicts:
            why.append(f"{chain.method} gives a place where {check.signal} does not agree in both")
            continue
        if check.away_s is None:
            unchecked = unchecked or placement
            continue
        seconds = abs(check.away_s)
        if seconds < 1e-3:
            length = f"{seconds * 1e6:.0f} us"
        else:
            length = f"{seconds * 1e3:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s"
        return replace(placement, sentence=f"{placement.sentence}; {check.signal} of both agrees to {length}")
    if unchecked is not None and unchecked.method == "UTC" and _apart(reference, unchecked):
        return unchecked
    correlated = align_by_signal(reference, log)
    if correlated is not None and correlated.aligned:
        doubt = "; its clock records contradict this, so it may be of another run of the same mission" if why else ""
        return replace(correlated, sentence=correlated.sentence + doubt)
    if unchecked is not None:
        if _apart(reference, unchecked):
            return unchecked
        return replace(unchecked, sentence=f"{unchecked.sentence}; no shared signal could check it")
    why.append(
        correlated.sentence.removeprefix(NOT_ALIGNED)
        if correlated is not None
        else "the logs share no signal that can be compared"
    )
    return _not_aligned(log, "; ".join(why))


def _apart(reference: Log, placement: LogPlacement) -> bool:
    """Whether one log ends before the other begins."""
    assert reference.span_ns is not None
    assert placement.log.span_ns is not None
    begin, end = placement.on_reference(np.array(placement.log.span_ns, dtype=np.int64)).tolist()
    return bool(end < reference.span_ns[0] or begin > reference.span_ns[1])


def _check(reference: Log, log: Log, placement: LogPlacement) -> _Check:
    """Check by the first shared signal with a clear match near the placement."""
    tried = ""
    for name, one, other in shared_signals(reference, log):
        moved = moved_to_reference(other, placement)
        near = match_signals(one, moved, 0, CHECK_WITHIN_S)
        if near is None:
            continue
        away_s = near.shift_ns * 1e-9
        if near.peak > max(0.4, near.chance) and abs(away_s) < placement_margin_s(placement):
            return _Check(name, away_s)
        wide = match_signals(one, moved)
        if wide is not None and wide.sure and abs(wide.shift_ns) * 1e-9 > placement_margin_s(placement):
            return _Check(name, None, contradicts=True)
        if exceeds_noise(one) and exceeds_noise(other) and near.peak < CONTRADICTED:
            tried = tried or name
    return _Check(tried, None, contradicts=bool(tried))


def placement_margin_s(placement: LogPlacement) -> float:
    """Allowed disagreement of a signal: the error of the placement, and the delay of filters."""
    return CHECK_MARGIN_S + 2.0 * (placement.error_s or 0.0)


def align_by_signal(reference: Log, log: Log) -> LogPlacement | None:
    """Align by the signal with the clearest peak. None if no signal can be compared."""
    sure: list[tuple[float, str, SignalMatch]] = []
    doubtful: list[tuple[float, str, SignalMatch]] = []
    for name, one, other in shared_signals(reference, log):
        match = match_signals(one, other)
        if match is None:
            continue
        (sure if match.sure else doubtful).append((match.peak, name, match))
        if match.sure and match.peak > 0.9:
            break
    if sure:
        _, name, match = max(sure, key=lambda entry: entry[0])
        assert log.span_ns is not None
        about_ns, offset_ns, drift, error_s = offset_line(match, log.span_ns)

        def to_reference(stamp_ns: Stamps) -> Stamps:
            return stamp_ns + offset_ns + whole_ns(drift * (stamp_ns - about_ns).astype(np.float64))

        parts = f" and in each of {len(match.parts)} parts of it" if len(match.parts) > 1 else ""
        return placement_from(
            log,
            log.span_ns,
            to_reference,
            (),
            error_s=error_s,
            method="correlation",
            sentence=f"by {name} in both, which correlates {match.peak:.2f} there{parts}, {match.rival:.2f} elsewhere",
        )
    if doubtful:
        peak, name, match = max(doubtful, key=lambda entry: entry[0])
        if match.rival >= 0.85 * match.peak:
            return _not_aligned(log, f"{name} fits at more than one offset ({peak:.2f} and {match.rival:.2f})")
        return _not_aligned(log, f"{name} fits no better ({peak:.2f}) than by chance ({match.chance:.2f})")
    return None


def _not_aligned(log: Log, why: str) -> LogPlacement:
    return LogPlacement(log, 0, 0.0, None, "not aligned", False, NOT_ALIGNED + why)
