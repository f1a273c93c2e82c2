"""Spectra of inertial samples: batches that ArduPilot logs at the sensor's own rate, and fast records."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.sensing.columns import numbers

_SORTS = {0: "accel", 1: "gyro"}
_PER_ROW = 32
_MOST_BATCHES = 400


@dataclass(frozen=True, slots=True)
class Batch:
    """One batch of ISBH and its ISBD: samples (n, 3) in m/s^2 or rad/s at `rate_hz`, logged from `stamp_ns` on."""

    sort: str
    instance: int
    rate_hz: float
    stamp_ns: int
    samples: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Batches:
    """whole: batches with all their samples. broken: headers whose samples are not all there."""

    whole: tuple[Batch, ...]
    broken: int


def batches(log: Log) -> Batches:
    """ISBH and ISBD; at most 400 batches, spread evenly over the log when there are more."""
    heads, rows = log.tables.get("ISBH"), log.tables.get("ISBD")
    wanted = ("N", "type", "instance", "mul", "smp_cnt", "smp_rate")
    if heads is None or rows is None or any(name not in heads.columns for name in wanted):
        return Batches((), 0)
    if any(name not in rows.columns for name in ("N", "seqno", "x", "y", "z")):
        return Batches((), 0)
    head = {name: numbers(heads, name, raw=True) for name in wanted}
    number, seqno = numbers(rows, "N", raw=True), numbers(rows, "seqno", raw=True)
    if number is None or seqno is None or any(values is None for values in head.values()):
        return Batches((), 0)
    # Numbers go round after 65536: rows of a header are those after it in the file and before the next of its number.
    places, head_places = rows.place, heads.place
    found: list[Batch] = []
    broken = 0
    chosen = np.unique(np.linspace(0, len(heads) - 1, min(len(heads), _MOST_BATCHES)).astype(np.intp))
    limits = np.concatenate((np.searchsorted(places, head_places), [len(places)]))
    for place in chosen:
        row = {name: float(values[place]) for name, values in head.items() if values is not None}
        count, rate_hz, factor = row["smp_cnt"], row["smp_rate"], row["mul"]
        if not (0 < count <= 1 << 16 and 0.0 < rate_hz < 1e6 and factor > 0.0 and row["type"] in _SORTS):
            broken += 1
            continue
        blocks = int(np.ceil(count / _PER_ROW))
        # The rows of a batch follow their header closely, with at most another batch's between them.
        window = slice(int(limits[place]), int(min(limits[place] + 4 * blocks + 8, len(places))))
        mine = np.flatnonzero(number[window] == row["N"])[:blocks] + window.start
        if len(mine) != blocks or not (seqno[mine] == np.arange(blocks)).all():
            broken += place != len(heads) - 1  # the last one may be under way where the log ends
            continue
        axes = [
            np.asarray(rows.values(axis, mine, raw=True), dtype=np.float64).reshape(-1)[: int(count)] for axis in "xyz"
        ]
        found.append(
            Batch(
                _SORTS[int(row["type"])],
                int(row["instance"]),
                rate_hz,
                int(heads.stamp_ns[place]),
                np.stack(axes, axis=1) / factor,
            )
        )
    return Batches(tuple(found), broken)


@dataclass(frozen=True, slots=True)
class Spectrum:
    """frequency_hz (M,), density (M, 3): amplitude spectral density of each axis, unit/sqrt(Hz). averaged: spectra."""

    frequency_hz: NDArray[np.float64]
    density: NDArray[np.float64]
    averaged: int

    def peak(self, from_hz: float, prominence: float = 5.0) -> tuple[float, float] | None:
        """Frequency and density of the highest line above `from_hz`, all axes together.

        None unless it stands out of the median density by the factor `prominence`.
        """
        total = np.sqrt((self.density**2).sum(axis=1))
        above = self.frequency_hz >= from_hz
        if np.count_nonzero(above) < 8:
            return None
        frequencies, levels = self.frequency_hz[above], total[above]
        place = int(np.argmax(levels))
        if levels[place] < prominence * float(np.median(levels)):
            return None
        return float(frequencies[place]), float(levels[place])


def spectrum(records: list[NDArray[np.float64]], rate_hz: float, length: int) -> Spectrum | None:
    """Welch's average of Hann-windowed periodograms (n, 3), half overlapping, each with its mean taken off.

    Scaled so that the square of the density integrates to the variance over 0 to rate/2.
    """
    window = np.hanning(length + 1)[:-1]  # periodic
    scale = 2.0 / (rate_hz * float(window @ window))
    total: NDArray[np.float64] = np.zeros((length // 2 + 1, 3))
    averaged = 0
    for record in records:
        for begin in range(0, len(record) - length + 1, max(1, length // 2)):
            part = record[begin : begin + length]
            if not np.isfinite(part).all():
                continue
            total += np.abs(np.fft.rfft((part - part.mean(axis=0)) * window[:, None], axis=0)) ** 2
            averaged += 1
    if not averaged:
        return None
    power: NDArray[np.float64] = total / averaged * scale
    power[0] /= 2.0
    if length % 2 == 0:
        power[-1] /= 2.0
    frequency_hz = np.arange(len(power), dtype=np.float64) * (rate_hz / length)
    return Spectrum(frequency_hz, np.sqrt(power).astype(np.float64), averaged)
