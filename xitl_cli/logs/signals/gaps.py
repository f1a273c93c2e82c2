"""How regular a series of stamps is: its rate, its gaps, stamps that repeat or go back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GAP_PERIODS = 1.5
LONG_GAP_PERIODS = 5.0
_LISTED = 20
_FARTHEST_NS = 1 << 61  # seventy years; differences of what lies beyond would not fit


@dataclass(frozen=True, slots=True)
class Gap:
    """Nothing between these two stamps; `missing` is how many rows the rate asks for there."""

    from_ns: int
    until_ns: int
    missing: int

    @property
    def duration_s(self) -> float:
        return (self.until_ns - self.from_ns) * 1e-9


@dataclass(frozen=True, slots=True)
class Gaps:
    """All gaps of a series, each (G,). row: the one before the gap. from_ns, until_ns, missing: as of a Gap."""

    row: NDArray[np.int64]
    from_ns: NDArray[np.int64]
    until_ns: NDArray[np.int64]
    missing: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.row)

    def longest(self, most: int = _LISTED) -> tuple[Gap, ...]:
        """The longest first."""
        order = np.argsort(self.from_ns - self.until_ns, kind="stable")[:most]
        return tuple(Gap(int(self.from_ns[at]), int(self.until_ns[at]), int(self.missing[at])) for at in order)


@dataclass(frozen=True, slots=True)
class Regularity:
    """period_s: median step forward, mean_period_s: from the first stamp to the latest, by rows; rate_hz is the inverse
    of the median. jitter_s: half of what the middle 68 % of the steps span.

    gaps, long_gaps: steps over 1.5 and over 5 periods. missing: rows that those leave out. longest: up to 20 gaps, the
    longest first. repeated: stamps equal to the one before; backward: stamps earlier than it, back_s the farthest.
    """

    rows: int
    period_s: float
    mean_period_s: float
    jitter_s: float
    gaps: int
    long_gaps: int
    missing: int
    longest: tuple[Gap, ...]
    repeated: int
    backward: int
    back_s: float

    @property
    def rate_hz(self) -> float:
        return 1.0 / self.period_s

    @property
    def longest_gap_s(self) -> float:
        """0 without a gap."""
        return self.longest[0].duration_s if self.longest else 0.0


def regularity(stamp_ns: NDArray[np.int64], period_s: float | None = None) -> Regularity | None:
    """Of stamps (N,) in the order of the log; None with fewer than three rows or no step forward.

    `period_s`: what the period should be; without it the median of the steps forward is taken for it. A stamp that goes
    back is counted and otherwise passed over: a gap is from the latest stamp so far to one beyond it.
    """
    stamps = _within(stamp_ns)
    if len(stamps) < 3:
        return None
    steps = np.diff(stamps)
    forward = steps[steps > 0]
    if not len(forward):
        return None
    period_ns = float(np.median(forward)) if period_s is None else period_s * 1e9
    if not period_ns > 0.0:
        return None
    wide = gaps(stamps, period_ns * 1e-9)
    low, high = np.percentile(forward, (16.0, 84.0))
    backward = steps < 0
    return Regularity(
        rows=len(stamps),
        period_s=period_ns * 1e-9,
        mean_period_s=float(stamps.max() - stamps[0]) * 1e-9 / (len(stamps) - 1),
        jitter_s=float(high - low) * 0.5e-9,
        gaps=len(wide),
        long_gaps=int(np.count_nonzero(wide.until_ns - wide.from_ns > LONG_GAP_PERIODS * period_ns)),
        missing=int(wide.missing.sum()),
        longest=wide.longest(),
        repeated=int(np.count_nonzero(steps == 0)),
        backward=int(np.count_nonzero(backward)),
        back_s=float(-steps[backward].min()) * 1e-9 if backward.any() else 0.0,
    )


def gaps(stamp_ns: NDArray[np.int64], period_s: float) -> Gaps:
    """Where stamps (N,) advance by more than 1.5 periods at once."""
    reached = np.maximum.accumulate(_within(stamp_ns))
    beyond = np.diff(reached)
    wide = np.flatnonzero(beyond > GAP_PERIODS * period_s * 1e9)
    missing = np.maximum(np.rint(beyond[wide] / (period_s * 1e9)).astype(np.int64) - 1, 1)
    return Gaps(wide.astype(np.int64), reached[wide], reached[wide + 1], missing)


def _within(stamp_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.clip(np.asarray(stamp_ns, dtype=np.int64), -_FARTHEST_NS, _FARTHEST_NS)
