"""What is too long to drift: boom, banks, dam. Cells that stay where they are, and are remembered when out of view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.companion.sighting import cells_of

Array = NDArray[np.float64]

_KEPT_NS = 600_000_000_000
_UNSEEN_NS = 2_500_000_000  # a cell in view that is not hit for so long is not there
_SETTLED_NS, _SETTLED_HITS = 1_500_000_000, 6
_WET_NS, _WET_HITS, _WET_KEPT_NS = 8_000_000_000, 40, 20_000_000_000  # the same where water returns
WET_HIT_NS = 280_000_000  # and there so often, on the mean: crests come and go, what stands is hit at every look
STREWN = 1.4  # times as far as water returns, single crests still do
_VIEW_RAD = np.radians(28.0)
_FAR_M = 100.0


class Structure:
    """Cells by number, with where they were hit, when they were first and last seen, and how often.

    A cell counts once it was seen again and again over a while: crests that gleam in a row are elsewhere soon.
    """

    def __init__(self) -> None:
        self._points_ne_m: Array = np.empty((0, 2))
        self._cells: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._first_ns: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._seen_ns: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._hits: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._dry: NDArray[np.int64] = np.empty(0, dtype=np.int64)  # hits where no water returns

    @property
    def points_ne_m(self) -> Array:
        """Points (k, 2) of the cells that count."""
        points: Array = self._points_ne_m[self._settled]
        return points

    @property
    def _settled(self) -> NDArray[np.bool_]:
        seen_ns = self._seen_ns - self._first_ns
        wet = (self._hits >= _WET_HITS) & (seen_ns >= _WET_NS) & (seen_ns < self._hits * WET_HIT_NS)
        return wet | ((self._dry >= _SETTLED_HITS) & (seen_ns >= _SETTLED_NS))

    def see(self, stamp_ns: int, points_ne_m: Array, pos_ne_m: Array, water_reach_m: float) -> None:
        """Cells that were hit now, from pos_ne_m (2,). Where water returns, within water_reach_m, that says little."""
        cells, one_each = np.unique(cells_of(points_ne_m), return_index=True)
        known = np.searchsorted(self._cells, cells)
        again = np.zeros(len(cells), dtype=np.bool_)
        inside = known < len(self._cells)
        again[inside] = self._cells[known[inside]] == cells[inside]
        old = known[again]
        self._seen_ns[old] = stamp_ns
        self._hits[old] += 1
        off = points_ne_m[one_each] - pos_ne_m
        dry = (np.hypot(off[:, 0], off[:, 1]) > STREWN * water_reach_m).astype(np.int64)
        self._dry[old] += dry[again]
        new = ~again
        number = int(np.count_nonzero(new))
        merged = np.concatenate((self._cells, cells[new]))
        order = np.argsort(merged, kind="stable")
        stamps = np.full(number, stamp_ns, dtype=np.int64)
        self._cells = merged[order]
        self._points_ne_m = np.concatenate((self._points_ne_m, points_ne_m[one_each][new]))[order]
        self._first_ns = np.concatenate((self._first_ns, stamps))[order]
        self._seen_ns = np.concatenate((self._seen_ns, stamps))[order]
        self._hits = np.concatenate((self._hits, np.ones(number, dtype=np.int64)))[order]
        self._dry = np.concatenate((self._dry, dry[new]))[order]

    def forget(self, now_ns: int, pos_ne_m: Array, bow_rad: float, clear_m: tuple[float, float]) -> None:
        """Drop what is old or far, and what would be seen if it were there: ahead, between `clear_m` of the vessel."""
        if not len(self._cells):
            return
        off = self._points_ne_m - pos_ne_m
        range_m = np.hypot(off[:, 0], off[:, 1])
        bearing = np.arctan2(off[:, 1], off[:, 0]) - bow_rad
        ahead = np.abs((bearing + np.pi) % (2.0 * np.pi) - np.pi) < _VIEW_RAD
        age_ns = now_ns - self._seen_ns
        gone = ahead & (range_m > clear_m[0]) & (range_m < clear_m[1]) & (age_ns > _UNSEEN_NS)
        gone |= ~self._settled & (age_ns > _UNSEEN_NS)
        gone |= (self._dry < _SETTLED_HITS) & (age_ns > _WET_KEPT_NS)
        keep = ~gone & (age_ns < _KEPT_NS) & (range_m < _FAR_M)
        self._cells, self._points_ne_m, self._hits = self._cells[keep], self._points_ne_m[keep], self._hits[keep]
        self._first_ns, self._seen_ns, self._dry = self._first_ns[keep], self._seen_ns[keep], self._dry[keep]

    def within(self, pos_ne_m: Array, range_m: float) -> Array:
        """Points (k, 2) not farther off than `range_m`."""
        points = self.points_ne_m
        off = points - pos_ne_m
        near: Array = points[np.hypot(off[:, 0], off[:, 1]) < range_m]
        return near

    def covers(self, point_ne_m: Array, radius_m: float) -> bool:
        """Whether there is structure so near to a point."""
        off = self.points_ne_m - point_ne_m
        return bool((np.hypot(off[:, 0], off[:, 1]) < radius_m).any())
