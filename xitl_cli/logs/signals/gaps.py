"""Regularity of a series of stamps: its rate, its gaps, and stamps that repeat or go back.

Rows may be sampled evenly and stamped in bursts: four at once, then a pause of four periods. Their rate is the mean
rate, and only rows that the mean rate lacks are missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GAP_PERIODS = 1.5
LONG_GAP_PERIODS = 5.0
_LISTED = 20
_WINDOW_ROWS = 32  # number of rows that averages bursts
_EVEN = 0.25  # of a period: largest deviation of a regular step
_FEW_STEPS = 0.05
_MOST_LATE_ROWS = 1000
_FARTHEST_NS = 1 << 61  # seventy years; differences of larger values would overflow


@dataclass(frozen=True, slots=True)
class Gap:
    """A span between two consecutive stamps."""

    from_ns: int
    until_ns: int
    missing: int
    """Number of rows that the rate requires there."""

    @property
    def duration_s(self) -> float:
        return (self.until_ns - self.from_ns) * 1e-9


@dataclass(frozen=True, slots=True)
class Gaps:
    """All gaps of a series; each array is (G,)."""

    row: NDArray[np.int64]
    """The row before the gap."""
    from_ns: NDArray[np.int64]
    """As in `Gap`."""
    until_ns: NDArray[np.int64]
    """As in `Gap`."""
    missing: NDArray[np.int64]
    """As in `Gap`."""

    def __len__(self) -> int:
        return len(self.row)

    def longest(self, most: int = _LISTED) -> tuple[Gap, ...]:
        """The longest gaps, longest first."""
        order = np.argsort(self.from_ns - self.until_ns, kind="stable")[:most]
        return tuple(Gap(int(self.from_ns[at]), int(self.until_ns[at]), int(self.missing[at])) for at in order)


@dataclass(frozen=True, slots=True)
class Regularity:
    """Regularity of a series."""

    rows: int
    period_s: float
    """Median forward step if most steps have that length, else time per row without outages. `rate_hz` is its
    inverse."""
    bursts: bool
    """Whether rows arrive in bursts."""
    jitter_s: float
    """Half of the range of the middle 68 % of the steps."""
    gaps: int
    """Number of gaps of over 1.5 periods."""
    long_gaps: int
    """Number of gaps of over 5 periods."""
    missing: int
    """Rows that the gaps lack."""
    longest: tuple[Gap, ...]
    """Up to 20 gaps, the longest first."""
    repeated: int
    """Stamps equal to the previous stamp."""
    backward: int
    """Stamps earlier than the previous stamp."""
    back_s: float
    """Largest step back."""

    @property
    def rate_hz(self) -> float:
        return 1.0 / self.period_s

    @property
    def longest_gap_s(self) -> float:
        """Length of the longest gap; 0 without a gap."""
        return self.longest[0].duration_s if self.longest else 0.0


def regularity(stamp_ns: NDArray[np.int64], period_s: float | None = None) -> Regularity | None:
    """Regularity of stamps (N,) in the order of the log; None with fewer than three rows or no step forward.

    period_s: nominal period; None: the series determines it. A stamp that goes back is counted and otherwise ignored: a
    gap is from the latest stamp so far to a later stamp.
    """
    stamps = _within(stamp_ns)
    if len(stamps) < 3:
        return None
    steps = np.diff(stamps)
    forward = steps[steps > 0]
    if not len(forward):
        return None
    period_ns, bursts = _period_ns(stamps) if period_s is None else (period_s * 1e9, False)
    if not period_ns > 0.0:
        return None
    wide = gaps(stamps, period_ns * 1e-9, bursts=bursts)
    low, high = np.percentile(forward, (16.0, 84.0))
    backward = steps < 0
    return Regularity(
        rows=len(stamps),
        period_s=period_ns * 1e-9,
        bursts=bursts,
        jitter_s=float(high - low) * 0.5e-9,
        gaps=len(wide),
        long_gaps=int(np.count_nonzero(wide.until_ns - wide.from_ns > LONG_GAP_PERIODS * period_ns)),
        missing=int(wide.missing.sum()),
        longest=wide.longest(),
        repeated=int(np.count_nonzero(steps == 0)),
        backward=int(np.count_nonzero(backward)),
        back_s=float(-steps[backward].min()) * 1e-9 if backward.any() else 0.0,
    )


def gaps(stamp_ns: NDArray[np.int64], period_s: float, *, bursts: bool = False) -> Gaps:
    """Gaps at which stamps (N,) advance by more than 1.5 periods, unless the following rows compensate.

    bursts: rows arrive in bursts (`Regularity.bursts`).
    """
    reached = np.maximum.accumulate(_within(stamp_ns))
    beyond = np.diff(reached)
    period_ns = period_s * 1e9
    wide = np.flatnonzero(beyond > GAP_PERIODS * period_ns)
    missing = np.maximum(np.rint(beyond[wide] / period_ns).astype(np.int64) - 1, 1)
    doubted = np.flatnonzero((missing > 2) | bursts)
    if len(doubted):
        missing[doubted] = np.minimum(missing[doubted], _lacking(reached, period_ns, wide[doubted]))
        wide, missing = wide[missing > 0], missing[missing > 0]
    return Gaps(wide.astype(np.int64), reached[wide], reached[wide + 1], missing)


def _period_ns(stamp_ns: NDArray[np.int64]) -> tuple[float, bool]:
    """Period (ns), and whether rows arrive in bursts."""
    reached = np.maximum.accumulate(stamp_ns)
    steps = np.diff(reached)
    if not (steps > 0).any():
        back_and_forth = np.diff(stamp_ns)
        return float(np.median(back_and_forth[back_and_forth > 0])), False
    usual = float(np.median(steps[steps > 0]))
    ratio = steps[steps > 0] / usual
    wide = ratio[ratio > GAP_PERIODS]
    if not len(wide) or len(steps) < _WINDOW_ROWS:
        return usual, False
    near = wide[wide < 2 * LONG_GAP_PERIODS]
    # Rows that share a stamp are a burst.
    even = np.count_nonzero(np.abs(ratio - 1.0) <= _EVEN) > 0.5 * len(steps)
    on_grid = not len(near) or float(np.mean(np.abs(near - np.rint(near)) <= _EVEN)) > 0.5
    windows = np.diff(reached[::_WINDOW_ROWS]) / usual - _WINDOW_ROWS  # missing rows in each window
    lacking = windows[windows < _WINDOW_ROWS]
    mean = float(lacking.mean()) if len(lacking) else 0.0
    as_ever = len(lacking) > 1 and mean > 1.0 and float(lacking.std()) < 0.5 * mean**0.5  # losses are never so regular
    if even and on_grid and not as_ever and len(wide) - len(near) <= _FEW_STEPS * len(ratio):
        return usual, False
    over = (reached[_WINDOW_ROWS:] - reached[:-_WINDOW_ROWS]).astype(np.float64)
    whole = over < GAP_PERIODS * float(np.median(over))  # windows without an outage
    by_count = float(over[whole].mean()) / _WINDOW_ROWS if whole.any() else usual
    return (by_count, True) if by_count > 0.0 else (usual, False)


def _lacking(reached: NDArray[np.int64], period_ns: float, wide: NDArray[np.intp]) -> NDArray[np.int64]:
    """Rows that are permanently missing around each wide step: no other rows, sooner or later, compensate for them."""
    late = (reached - reached[0]) / period_ns - np.arange(len(reached))
    lacking = np.empty(len(wide), dtype=np.int64)
    for place, row in enumerate(wide.tolist()):
        reach = _WINDOW_ROWS + min(int(late[row + 1] - late[row]), _MOST_LATE_ROWS)
        before, after = late[max(row + 1 - _WINDOW_ROWS, 0) : row + 1], late[row + 1 : row + 1 + reach]
        lacking[place] = round(after.min() - before.max() + _EVEN)
    return lacking


def _within(stamp_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.clip(np.asarray(stamp_ns, dtype=np.int64), -_FARTHEST_NS, _FARTHEST_NS)
