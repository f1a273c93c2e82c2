"""Stamps of a log on the time line of a report or of another log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from xitl_cli.logs.model.log import Log, LogView
from xitl_cli.logs.model.table import Flags, Floats, Stamps, whole_ns
from xitl_cli.logs.model.text import clock_text
from xitl_cli.logs.signals.spans import inside
from xitl_cli.logs.signals.states import armed

StampMap = Callable[[Stamps], Stamps]

_EDGE_NS = 1000  # a break is known to a nanosecond or two
NOT_ALIGNED = "not aligned: "
"""Beginning of the sentence of a log that is not aligned."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A straight part of a placement: from `from_ns` (the log's own time), the reference is stamp + offset_ns plus
    drift."""

    from_ns: int
    offset_ns: int
    drift_ppm: float
    """Growth of the offset since `from_ns`."""


@dataclass(frozen=True, slots=True)
class LogPlacement:
    """Position of a log on the time line of the reference."""

    log: Log
    offset_ns: int
    """Reference minus log at the log's first stamp."""
    drift_ppm: float
    """Of the longest stretch."""
    error_s: float | None
    """Two standard deviations, or the bound if one is known. None if the log is not aligned or is the reference
    itself."""
    method: str
    """One of "reference", "same clock", "clock records", "telemetry", "UTC", "correlation" or "not aligned"."""
    reference: bool
    sentence: str
    """For the user: the method of the alignment, or the reason why there is none."""
    stretches: tuple[Stretch, ...] = field(default=())

    @property
    def aligned(self) -> bool:
        return self.method != "not aligned"

    def on_reference(self, stamp_ns: Stamps) -> Stamps:
        """(N,) stamps of the log on the reference's time."""
        stamps = np.asarray(stamp_ns, dtype=np.int64)
        if not self.stretches:
            return stamps + self.offset_ns
        begins = np.array([stretch.from_ns for stretch in self.stretches], dtype=np.int64)
        which = np.maximum(np.searchsorted(begins, stamps, side="right") - 1, 0)
        offset = np.array([stretch.offset_ns for stretch in self.stretches], dtype=np.int64)[which]
        rate = np.array([stretch.drift_ppm for stretch in self.stretches])[which] * 1e-6
        grown = whole_ns(rate * (stamps - begins[which]).astype(np.float64))
        return stamps + offset + grown


def placement_from(
    log: Log, span_ns: tuple[int, int], to_reference: StampMap, breaks_ns: Sequence[int], **about: object
) -> LogPlacement:
    """Build a placement from a function that is linear between `breaks_ns` (the log's own time).

    about: error, method and sentence of the placement.
    """
    begin, end = span_ns
    breaks = sorted({at_ns for at_ns in breaks_ns if begin < at_ns < end})
    bounds = [begin, *breaks, max(end, begin + 1)]
    stretches: list[Stretch] = []
    for from_ns, until_ns in pairwise(bounds):
        edge_ns = min(_EDGE_NS, (until_ns - from_ns) // 4)
        first_ns, last_ns = from_ns + edge_ns, max(until_ns - edge_ns - 1, from_ns + edge_ns + 1)
        first, last = to_reference(np.array([first_ns, last_ns], dtype=np.int64)).tolist()
        drift_ppm = 1e6 * ((last - first) / (last_ns - first_ns) - 1.0)
        stretches.append(Stretch(from_ns, first - first_ns - round(drift_ppm * 1e-6 * edge_ns), drift_ppm))
    lengths = np.diff(np.array(bounds))
    longest = stretches[int(np.argmax(lengths))]
    return LogPlacement(
        log,
        stretches[0].offset_ns,
        longest.drift_ppm,
        reference=False,
        stretches=tuple(stretches),
        **about,  # type: ignore[arg-type]
    )


_FARTHEST_NS = 1 << 62  # a larger value is no instant


@dataclass(frozen=True, slots=True)
class TimeLine:
    """Relation of a log's stamps to the report's time line, which counts seconds from `zero_ns` of the reference."""

    zero_ns: int = 0
    stretches: tuple[Stretch, ...] = ()
    """Of the placement, in order; none for the reference or a single log."""
    offset_ns: int = 0
    """Of the placement, for people."""
    drift_ppm: float = 0.0
    """Of the placement, for people."""
    error_s: float | None = None
    """Of the placement, for people."""
    method: str = ""
    """Of the placement, for people."""
    sentence: str = ""
    """Of the placement, for people."""
    reference: bool = True

    def seconds(self, stamp_ns: Stamps | Floats) -> Floats:
        """(N,) on the report's time line."""
        stamps = np.asarray(stamp_ns)
        since_zero = stamps - (np.int64(self.zero_ns) if stamps.dtype.kind == "i" else float(self.zero_ns))
        seconds: Floats = since_zero.astype(np.float64) * 1e-9
        if self.stretches:
            begins = np.array([stretch.from_ns for stretch in self.stretches], dtype=np.int64)
            which = np.maximum(np.searchsorted(begins, stamps, side="right") - 1, 0)
            offset_s = np.array([stretch.offset_ns * 1e-9 for stretch in self.stretches])[which]
            rate = np.array([stretch.drift_ppm * 1e-6 for stretch in self.stretches])[which]
            seconds = seconds + offset_s + rate * ((stamps - begins[which]).astype(np.float64) * 1e-9)
        return seconds

    def second(self, stamp_ns: int) -> float:
        within = min(max(stamp_ns, -_FARTHEST_NS), _FARTHEST_NS)
        return float(self.seconds(np.array([within], dtype=np.int64))[0])


class AlignedLog(LogView):
    """A log with its stamps unchanged, which also knows its place on the time line of the report."""

    def __init__(self, log: Log, time_line: TimeLine) -> None:
        super().__init__(log)
        self.time_line = time_line


class LogClock:
    """Stamps of a log on the time line of the report, or in seconds since its own zero (`Log.zero_ns`).

    armed: spans (ns) in which the motors were armed.
    """

    def __init__(self, log: Log) -> None:
        self.start_ns, self.end_ns = log.span_ns or (0, 0)
        self.armed = [(span.from_ns, span.until_ns) for span in armed(log)]
        self._line = log.time_line if isinstance(log, AlignedLog) else TimeLine(log.zero_ns)

    def second(self, at_ns: int) -> float:
        """Return seconds for tables and facts, rounded to a millisecond."""
        return round(self._line.second(at_ns), 3)

    def text(self, at_ns: int) -> str:
        """Return the instant for sentences: 1:46.5."""
        return clock_text(self._line.second(at_ns))

    def was_armed(self, *at_ns: int) -> bool:
        """Whether the motors were armed at any of these instants."""
        return bool(self.armed_rows(np.array(at_ns, dtype=np.int64)).any())

    def armed_rows(self, at_ns: Stamps) -> Flags:
        """(N,) whether the motors were armed at each of these instants."""
        return inside(at_ns, self.armed)
