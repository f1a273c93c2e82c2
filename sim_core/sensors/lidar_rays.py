"""The rays of one frame: each from where the sensor is at its instant, and where it then looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import float32, float64, int64
from numpy.typing import NDArray

Array = NDArray[float64]
Array32 = NDArray[float32]


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where a body was at K >= 2 instants of one frame, from its start to its end.

    stamps_ns (K,); pos_ned_m (K, 3); rot_ned_frd (K, 3, 3). Between two instants both are interpolated linearly: for
    steps of milliseconds a matrix between two is a rotation to 1e-6.
    """

    stamps_ns: NDArray[int64]
    pos_ned_m: Array
    rot_ned_frd: Array

    @property
    def duration_s(self) -> float:
        """From the first instant to the last."""
        return float(self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9

    def poses(self, later_s: Array) -> tuple[Array, Array]:
        """Place (k, 3) and attitude (k, 3, 3) later_s (k,) after the start."""
        known_s = (self.stamps_ns - self.stamps_ns[0]) * 1e-9
        leg = np.clip(np.searchsorted(known_s, later_s, side="right") - 1, 0, len(known_s) - 2)
        share = ((later_s - known_s[leg]) / (known_s[leg + 1] - known_s[leg]))[:, None]
        place = (1.0 - share) * self.pos_ned_m[leg] + share * self.pos_ned_m[leg + 1]
        share = share[:, None]
        return place, (1.0 - share) * self.rot_ned_frd[leg] + share * self.rot_ned_frd[leg + 1]


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """n rays: origins and unit directions (n, 3), later_s (n,) after the start of the frame."""

    origin_ned_m: Array32
    direction_ned: Array32
    later_s: Array32

    def of(self, rows: NDArray[np.intp]) -> Rays:
        """Some of them."""
        return Rays(self.origin_ned_m.take(rows, 0), self.direction_ned.take(rows, 0), self.later_s[rows])


def rays_from(
    track: Track, position_frd_m: Array, rot_frd_sensor: Array, looking: Array32, first_s: float, interval_s: float
) -> Rays:
    """Rays along looking (3, n), in the sensor's axes, of a sensor at (3,), turned by (3, 3), on the track.

    The first goes out first_s after the track's start, each other interval_s later. They go in blocks of about a step
    of the track; in a block the pose goes linearly from one end to the other, which is two products of matrices.
    """
    count = looking.shape[1]
    size = min(max(round(track.duration_s / (len(track.stamps_ns) - 1) / interval_s), 1), max(count, 1))
    blocks = -(-count // size)
    place, turned = track.poses(first_s + np.arange(blocks + 1) * (size * interval_s))
    place = place + turned @ position_frd_m
    turned = turned @ rot_frd_sensor
    share = np.arange(size, dtype=float32) / float32(size)
    both = np.zeros((2, 3, blocks * size), float32)
    both[0, :, :count] = looking
    np.multiply(both[0].reshape(3, blocks, size), share, out=both[1].reshape(3, blocks, size))
    along = np.concatenate([turned[:-1], np.diff(turned, axis=0)], axis=2).astype(float32)
    direction = both.reshape(6, blocks, size).transpose(1, 2, 0) @ along.transpose(0, 2, 1)
    ends = np.stack([place[:-1], np.diff(place, axis=0)], axis=1).astype(float32)
    fractions: Array32 = np.column_stack([np.ones_like(share), share])
    origin = fractions @ ends
    later_s = np.arange(count, dtype=float32) * float32(interval_s) + float32(first_s)
    return Rays(origin.reshape(-1, 3)[:count], direction.reshape(-1, 3)[:count], later_s)
