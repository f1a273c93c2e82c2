"""Delay between the same signal in two logs, over an unknown offset of hours.

The normalised cross-correlation of two records is computed at every shift by FFT. Each shift uses the mean and scatter
of the overlapping part. A peak counts if it exceeds the highest value that chance reaches over as many independent
shifts. Records of a limited bandwidth have fewer independent samples than samples (Bartlett, J. R. Stat. Soc. Suppl. 8,
1946). The highest of n normal values is about sqrt(2 ln n).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.clocks.fit import robust_line, robust_spread
from xitl_cli.logs.clocks.time_line import LogPlacement
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.signals import armed, ground_speed, outputs, yaw, yaw_rate
from xitl_cli.logs.signals.series import Series

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
    fine = _search(one, other, about_ns, within_s)
    if fine is None:
        return None
    shift_ns, peak, chance, rival = fine
    parts, at_ns = _parts(one, other, shift_ns)
    return SignalMatch(shift_ns, peak, chance, rival, parts, at_ns)


def _search(
    one: Series, other: Series, about_ns: int | None, within_s: float | None
) -> tuple[int, float, float, float] | None:
    longest_s = max(float(each.stamp_ns[-1] - each.stamp_ns[0]) * 1e-9 for each in (one, other))
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
    independent = overlap * _independent(a, b)
    noise = 1.0 / np.sqrt(np.maximum(independent[best], 4.0))
    tries = max(float(np.sum(allowed)) * _independent(a, b), 2.0)
    chance = float(min(noise * np.sqrt(2.0 * np.log(tries)), 1.0))
    weight = np.sqrt(overlap / overlap[best])  # a short overlap correlates by chance
    away = allowed & (np.abs(lags - lags[best]) > RIVAL_AWAY_S * rate_hz)
    rival = float(np.max(np.where(away, values * np.minimum(weight, 1.0), 0.0), initial=0.0))
    coarse_s = _peak(lags, scores, best) / rate_hz
    shift_ns = base_ns + round(coarse_s * 1e9)
    finer_s, peak = _finer(one, other, shift_ns)
    return shift_ns + round(finer_s * 1e9), max(peak, float(values[best])), chance, rival


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
    for name, of in (("the turn rate", _turn_rate), ("the speed over ground", ground_speed)):
        first = of(one)
        second = None if first is None else of(other)
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
    for each in spans:
        for at_ns, value in ((each.from_ns, 1.0), (each.until_ns, 0.0)):
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
    newest = np.maximum.accumulate(stamps)
    ahead = np.concatenate(([True], stamps[1:] > newest[:-1]))
    return replace(series, stamp_ns=stamps[ahead], values=series.values[ahead])


def exceeds_noise(series: Series) -> bool:
    """Whether the series has more than noise. If so, the same signal in another log must resemble it."""
    values = series.values[: len(series.values) // 10 * 10].reshape(-1, 10).mean(axis=1)
    return bool(len(values) > 10 and float(np.std(values)) > MOVES.get(series.unit, np.inf))


def offset_line(found: SignalMatch, span_ns: tuple[int, int]) -> tuple[int, int, float, float]:
    """Return the line of a match: instant of its offset (log's time), offset (ns), drift (1), and the error of both
    (s).

    The drift is 0 unless the parts show more than their scatter. The error is two standard deviations at the farther
    end of the log.
    """
    middle_ns = (span_ns[0] + span_ns[1]) // 2
    if len(found.parts) < 3:
        spread_s = float(np.max(np.abs(found.parts), initial=0.0)) if len(found.parts) else 0.05
        return middle_ns, found.shift_ns, 0.0, max(2.0 * spread_s, LEAST_ERROR_S, 0.02)
    about_ns = int(np.mean(found.at_ns.astype(np.float64) - found.at_ns[0])) + int(found.at_ns[0])
    x = (found.at_ns - about_ns).astype(np.float64) * 1e-9
    slope, value_s = robust_line(x, found.parts)
    error_s = found.parts - value_s - slope * x
    count = len(x)
    sigma_s = max(float(np.sqrt(np.sum(error_s**2) / max(count - 2, 1))), 0.5 * LEAST_ERROR_S)
    slope_sigma = sigma_s / float(np.sqrt(np.sum(x * x)))
    far_s = max(abs(span_ns[0] - about_ns), abs(span_ns[1] - about_ns)) * 1e-9
    if abs(slope) < 3.0 * slope_sigma or abs(slope) > MOST_DRIFT:
        value_s = float(np.median(found.parts))
        sigma_s = max(float(np.std(found.parts)), sigma_s)
        return about_ns, found.shift_ns + round(value_s * 1e9), 0.0, max(2.0 * sigma_s, LEAST_ERROR_S)
    total_s = 2.0 * float(np.hypot(sigma_s / np.sqrt(count), slope_sigma * far_s))
    return about_ns, found.shift_ns + round(value_s * 1e9), slope, max(total_s, LEAST_ERROR_S)
