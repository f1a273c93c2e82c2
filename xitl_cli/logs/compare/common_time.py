"""Samples of two logs at the same instants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.signals import Series

Array = NDArray[np.float64]
Instants = NDArray[np.int64]

_MOST_SAMPLES = 200_000
_LONGEST_GAP_S = 2.0
_USUAL_STEPS = 3.0


@dataclass(frozen=True, slots=True)
class Pairing:
    """How stamps of B become stamps of A. sentence: for the user. error_s: how far it may be off, None if not known.

    zero_ns: on A's time, what seconds count from, where an event gives it. from_ns, until_ns: on A's time, what of the
    common time is compared; None: all of it.
    """

    on_a: Callable[[Instants], Instants]
    method: str
    sentence: str
    error_s: float | None = None
    zero_ns: int | None = None
    from_ns: int | None = None
    until_ns: int | None = None

    def instant(self, stamp_ns: int) -> int:
        """One stamp of B on A's time."""
        return int(self.on_a(np.array([stamp_ns], dtype=np.int64))[0])

    def moved(self, series: Series) -> Series:
        """Of B, on A's time; samples that come out earlier than the one before are left out."""
        stamps = self.on_a(series.stamp_ns)
        newest = np.maximum.accumulate(stamps)
        forward = np.concatenate(([True], stamps[1:] > newest[:-1]))
        return Series(stamps[forward], series.values[forward], series.unit, series.source, series.turns)


def match(a: Series, b: Series, pairing: Pairing) -> tuple[Instants, Array, Array] | None:
    """Stamps (N,) of A within B's time, A's values there and B's on straight lines; at most 200 000 of them.

    Stamps within a gap of B are left out: more than 2 s and more than 3 of its usual steps. None unless there are two.
    """
    other = pairing.moved(b)
    inside = (a.stamp_ns >= other.stamp_ns[0]) & (a.stamp_ns <= other.stamp_ns[-1])
    if pairing.from_ns is not None:
        inside &= a.stamp_ns >= pairing.from_ns
    if pairing.until_ns is not None:
        inside &= a.stamp_ns <= pairing.until_ns
    stamps, values = a.stamp_ns[inside], a.values[inside]
    every = max(1, -(-len(stamps) // _MOST_SAMPLES))
    stamps, values = stamps[::every], values[::every]
    if len(stamps) < 2 or len(other.stamp_ns) < 2:
        return None
    steps_s = np.diff(other.stamp_ns) * 1e-9
    after = np.clip(np.searchsorted(other.stamp_ns, stamps), 1, len(other.stamp_ns) - 1)
    near = steps_s[after - 1] <= _gap_s(steps_s)
    stamps, values = stamps[near], values[near]
    return None if len(stamps) < 2 else (stamps, values, other.at(stamps))


def integral(stamp_ns: Instants, values: Array) -> tuple[float, float]:
    """Seconds covered and the integral over them, by trapezoids; gaps (as in `match`) left out."""
    steps_s = np.diff(stamp_ns) * 1e-9
    if not len(steps_s):
        return 0.0, 0.0
    joined = steps_s <= _gap_s(steps_s)
    areas = 0.5 * (values[1:] + values[:-1]) * steps_s
    return float(steps_s[joined].sum()), float(areas[joined].sum())


def _gap_s(steps_s: Array) -> float:
    """The longest step that is not a gap."""
    return max(_LONGEST_GAP_S, _USUAL_STEPS * float(np.median(steps_s)))
