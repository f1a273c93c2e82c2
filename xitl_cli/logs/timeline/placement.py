"""Where a log lies on the time of another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log

Instants = NDArray[np.int64]
Mapping_ = Callable[[Instants], Instants]

_EDGE_NS = 1000  # a break is known to a nanosecond or two


@dataclass(frozen=True, slots=True)
class Stretch:
    """From `from_ns` (the log's own time) on: the reference is stamp + offset_ns, and `drift_ppm` more since then."""

    from_ns: int
    offset_ns: int
    drift_ppm: float


@dataclass(frozen=True, slots=True)
class Placement:
    """offset_ns: reference less log at the log's first stamp; drift_ppm: of its longest stretch.

    error_s: how far it may be off: two standard deviations, or the bound where one is known; None when not aligned or
    for the reference itself. method: "reference", "same clock", "clock records", "telemetry", "UTC", "correlation" or
    "not aligned". sentence: how it was placed, or why it was not, for the user.
    """

    log: Log
    offset_ns: int
    drift_ppm: float
    error_s: float | None
    method: str
    reference: bool
    sentence: str
    stretches: tuple[Stretch, ...] = field(default=())

    @property
    def aligned(self) -> bool:
        return self.method != "not aligned"

    def on_reference(self, stamp_ns: Instants) -> Instants:
        """(N,) stamps of the log on the reference's time."""
        stamps = np.asarray(stamp_ns, dtype=np.int64)
        if not self.stretches:
            return stamps + self.offset_ns
        begins = np.array([stretch.from_ns for stretch in self.stretches], dtype=np.int64)
        which = np.maximum(np.searchsorted(begins, stamps, side="right") - 1, 0)
        offset = np.array([stretch.offset_ns for stretch in self.stretches], dtype=np.int64)[which]
        rate = np.array([stretch.drift_ppm for stretch in self.stretches])[which] * 1e-6
        grown = np.round(rate * (stamps - begins[which]).astype(np.float64)).astype(np.int64)
        return stamps + offset + grown


def place(
    log: Log, span_ns: tuple[int, int], to_reference: Mapping_, breaks_ns: Sequence[int], **said: object
) -> Placement:
    """A placement from a function that is straight between `breaks_ns` (the log's own time)."""
    begin, end = span_ns
    inside = sorted({one for one in breaks_ns if begin < one < end})
    bounds = [begin, *inside, max(end, begin + 1)]
    stretches: list[Stretch] = []
    for from_ns, until_ns in pairwise(bounds):
        edge_ns = min(_EDGE_NS, (until_ns - from_ns) // 4)
        first_ns, last_ns = from_ns + edge_ns, max(until_ns - edge_ns - 1, from_ns + edge_ns + 1)
        first, last = to_reference(np.array([first_ns, last_ns], dtype=np.int64)).tolist()
        drift_ppm = 1e6 * ((last - first) / (last_ns - first_ns) - 1.0)
        stretches.append(Stretch(from_ns, first - first_ns - round(drift_ppm * 1e-6 * edge_ns), drift_ppm))
    lengths = np.diff(np.array(bounds))
    longest = stretches[int(np.argmax(lengths))]
    return Placement(
        log,
        stretches[0].offset_ns,
        longest.drift_ppm,
        reference=False,
        stretches=tuple(stretches),
        **said,  # type: ignore[arg-type]
    )
