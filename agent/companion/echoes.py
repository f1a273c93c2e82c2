"""What stands out in the echo of a ping, as points.

Of the two levels beside a sample, nearer and farther, the greater is what it must rise above: the constant false alarm
rate detector "greatest of", which answers neither to noise nor to the edge of an echo that goes on and on, as of the
bed (Hansen and Sawyers 1980). Levels are compared in the sonar's own steps, which are decibels.
"""

from __future__ import annotations

import numpy as np
from numpy import float32, float64, int64, uint8
from numpy.typing import NDArray

from agent.companion.pings import Ping

Array = NDArray[float64]

RISE = 39.0  # 13 dB: a speckle of the noise gets there once in 70 000 samples
FLANK = 30.0  # 10 dB: an echo begins where it comes so near to its highest
NEAREST_M = 0.75  # nearer, the transducer itself still rings
GUARD_M = 0.5
TRAINING_M = 1.5
_LEAST_GUARD = 4
_LEAST_TRAINING = 12


def echo_points(
    ping: Ping, rise: float = RISE, nearest_m: float = NEAREST_M
) -> tuple[NDArray[float32], NDArray[uint8]]:
    """Echoes of a ping as points_frd_m (k, 3), in the plane of the beam's axis, and their intensity (k,).

    The beam is far taller than wide: how high or deep an echo comes from is not known.
    """
    samples = echo_samples(ping, rise, nearest_m)
    angle_rad = ping.angle_grad * (2.0 * np.pi / 400.0)
    along = np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    points = np.array(ping.position_frd_m) + ping.ranges_m()[samples, None] * along
    return points.astype(float32), ping.intensity[samples]


def echo_samples(ping: Ping, rise: float, nearest_m: float) -> NDArray[int64]:
    """Numbers of the samples (k,) where echoes begin that stand out, the highest of their surroundings by `rise`.

    A surface that the beam meets at a slant answers for a while, in speckle, and what is nearest of it answers first.
    """
    level = ping.intensity.astype(float64)
    guard = max(round(GUARD_M / ping.sample_m), _LEAST_GUARD)
    training = max(round(TRAINING_M / ping.sample_m), _LEAST_TRAINING)
    count = len(level)
    start = int(np.ceil(nearest_m / ping.sample_m))
    if count - start < guard + training:
        return np.empty(0, int64)
    total = np.concatenate(([0.0], np.cumsum(level)))
    place = np.arange(count)
    near = _mean(total, np.maximum(place - guard - training, 0), np.maximum(place - guard, 0))
    far = _mean(total, np.minimum(place + guard + 1, count), np.minimum(place + guard + 1 + training, count))
    padded = np.pad(level, guard, constant_values=-1.0)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * guard + 1)
    highest = level >= around.max(axis=1)
    highest[1:] &= level[1:] > level[:-1]  # of equal ones, the first
    peaks = np.flatnonzero(highest & (level >= np.maximum(near, far) + rise) & (place >= start))
    before = np.maximum(peaks[:, None] + np.arange(-guard, 1), start)
    first = np.argmax(level[before] >= level[peaks, None] - FLANK, axis=1)
    return np.unique(before[np.arange(len(peaks)), first])


def _mean(total: Array, first: NDArray[int64], end: NDArray[int64]) -> Array:
    """Means of [first, end) from running sums; 0 where there is nothing."""
    return np.asarray((total[end] - total[first]) / np.maximum(end - first, 1))
