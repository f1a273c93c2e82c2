"""Plots of a radar: samples above the noise around them, joined to objects with range, bearing, strength and size.

    plots = find_plots(radar, power)

A sample is detected when its power exceeds T times the mean of cells around it (cell-averaging CFAR, Finn and Johnson
1968). Cells are a pulse length apart, so that their noise is independent. The power of a spoke is the mean of m pulses.
In noise alone, the ratio of a sample to the mean of n cells has the F distribution with 2 m and 2 m n degrees of
freedom, and T is its quantile for the false-alarm rate. Rayleigh clutter is the same in all pulses of a spoke, so m = 1
(`cfar: clutter`). The spikes of the sea and edges of clutter have more false alarms.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.sensors.radar import FIRST_ANGLE_RAD, MarineRadar

_GUARD = 1  # pulse lengths between a sample and the cells beside it


@dataclass(frozen=True, slots=True)
class RadarPlotPlace:
    """A plot relative to the vessel. Bearings are clockwise from the bow."""

    range_m: float
    """Range of the centroid."""
    bearing_rad: float
    """Bearing of the centroid, 0 to 2 pi."""
    strength_db: float
    """Largest level above the receiver's noise."""
    length_m: float
    """Extent along the range, including the length of the pulse."""
    width_rad: float
    """Extent in bearing, including the width of the beam."""
    spoke: int
    """Number of the spoke at the centroid."""
    samples: int
    """Detected samples."""


@cache
def cfar_factor(rate: float, pulses: int, cells: int) -> float:
    """Return T for a false-alarm rate, m pulses in a sample and n cells.

    P(ratio > T) = sum over j < m of C(m n + j - 1, j) x^j / (1 + x)^(m n + j), x = T / n.
    """

    def exceeded(factor: float) -> float:
        shape, x = pulses * cells, factor / cells
        term = -shape * math.log1p(x)
        total = math.exp(term)
        for j in range(1, pulses):
            term += math.log((shape + j - 1) / j) + math.log(x / (1.0 + x))
            total += math.exp(term)
        return total

    low, high = 1e-9, 2.0
    while exceeded(high) > rate:
        high *= 2.0
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if exceeded(middle) > rate else (low, middle)
    return high


def detections(radar: MarineRadar, power: Array) -> NDArray[np.bool_]:
    """Return the detected samples (K, bins) of spokes with powers (K, bins).

    Samples with cells on one side only use this side. Samples without four cells are not detected.
    """
    spec, stride = radar.spec, radar.pulse_bins
    valid = np.zeros(spec.bins, np.intp)
    valid[radar.first_bin :] = 1
    total, count = np.zeros(power.shape), np.zeros(spec.bins, np.intp)
    for lag in range(_GUARD + 1, _GUARD + 1 + spec.cfar_cells // 2):
        shift = lag * stride
        if shift >= spec.bins:
            break
        total[:, shift:] += (power * valid)[:, :-shift]
        total[:, :-shift] += (power * valid)[:, shift:]
        count[shift:] += valid[:-shift]
        count[:-shift] += valid[shift:]
    pulses = radar.pulses if spec.cfar == "noise" else 1
    factor = np.array([math.inf if n < 4 else cfar_factor(spec.false_alarm_rate, pulses, n) for n in count.tolist()])
    usable = (valid == 1) & (count >= 4)
    mean = total / np.maximum(count, 1)
    detected: NDArray[np.bool_] = np.zeros(power.shape, np.bool_)
    detected[:, usable] = power[:, usable] > factor[usable] * mean[:, usable]
    return detected


def find_plots(radar: MarineRadar, power: Array) -> list[RadarPlotPlace]:
    """Return the plots of a turn with powers (spokes, bins), by range.

    Detected samples join if they overlap in adjacent spokes, or are at most a pulse length apart in one spoke. The
    turn is closed: plots extend across its first spoke. A plot has samples in at least `plot_spokes` spokes.
    """
    detected = detections(radar, power)
    runs = _runs(detected, radar.pulse_bins)
    group = _joined(runs, radar.spec.spokes)
    plots = []
    for rows in np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1]) if len(group) else []:
        plot = _plot(radar, power, detected, runs[rows])
        if plot is not None:
            plots.append(plot)
    return sorted(plots, key=lambda plot: (plot.range_m, plot.bearing_rad))


def _runs(detected: NDArray[np.bool_], gap: int) -> NDArray[np.intp]:
    """Return the runs of detected samples, (R, 3): spoke, first and last sample.

    Samples at most `gap` apart are one run.
    """
    spoke, sample = np.nonzero(detected)
    begins = np.ones(len(spoke), np.bool_)
    begins[1:] = (np.diff(spoke) != 0) | (np.diff(sample) > gap)
    starts = np.flatnonzero(begins)
    ends = np.append(starts[1:], len(spoke)) - 1
    ends = ends[: len(starts)]
    return np.column_stack([spoke[starts], sample[starts], sample[ends]])


def _joined(runs: NDArray[np.intp], spokes: int) -> NDArray[np.intp]:
    """Return the group of each run, (R,), numbered from 0: runs of adjacent spokes that overlap."""
    parent = list(range(len(runs)))

    def root(number: int) -> int:
        while parent[number] != number:
            parent[number] = parent[parent[number]]
            number = parent[number]
        return number

    at = np.searchsorted(runs[:, 0], np.arange(spokes + 1)).tolist()
    first, last = runs[:, 1].tolist(), runs[:, 2].tolist()
    for spoke in range(spokes):
        following = (spoke + 1) % spokes
        a, b = at[spoke], at[following]
        while a < at[spoke + 1] and b < at[following + 1]:
            if first[a] <= last[b] + 1 and first[b] <= last[a] + 1:
                parent[root(a)] = root(b)
            if last[a] < last[b]:
                a += 1
            else:
                b += 1
    roots = [root(number) for number in range(len(runs))]
    return np.unique(roots, return_inverse=True)[1] if roots else np.empty(0, np.intp)


def _plot(
    radar: MarineRadar, power: Array, detected: NDArray[np.bool_], runs: NDArray[np.intp]
) -> RadarPlotPlace | None:
    spokes = radar.spec.spokes
    if len(np.unique(runs[:, 0])) < radar.spec.plot_spokes:
        return None
    # Spokes counted on across the end of the turn, from after the largest gap
    own = np.unique(runs[:, 0])
    gaps = np.diff(np.append(own, own[0] + spokes))
    start = int(own[(int(np.argmax(gaps)) + 1) % len(own)])
    turned = (runs[:, 0] - start) % spokes
    length = runs[:, 2] - runs[:, 1] + 1
    row = np.repeat(np.arange(len(runs)), length)
    sample = np.arange(len(row)) - np.repeat(np.cumsum(length) - length, length) + runs[row, 1]
    strength = power[runs[row, 0], sample] * detected[runs[row, 0], sample]
    total = float(strength.sum())
    # A point is `pulse_bins` long, about its sample: an even number ends a sample earlier
    middle = float(strength @ sample) / total + (0.5 if radar.pulse_bins % 2 else 1.0)
    centre = float(strength @ turned[row]) / total + start
    return RadarPlotPlace(
        middle * radar.bin_m,
        (FIRST_ANGLE_RAD + centre * radar.step_rad) % math.tau,
        10.0 * math.log10(float(strength.max())),
        float(runs[:, 2].max() - runs[:, 1].min() + 1) * radar.bin_m,
        float(turned.max() + 1) * radar.step_rad,
        round(centre) % spokes,
        int(np.count_nonzero(strength)),
    )
