"""A log on the one time line of a report: every instant that people read is one of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Base, Format, Health, Log
from xitl_cli.logs.table import Table
from xitl_cli.logs.timeline.placement import Stretch

_FARTHEST_NS = 1 << 62  # what is beyond is no instant


@dataclass(frozen=True, slots=True)
class TimeLine:
    """How a log's stamps lie on the report's one time line, which counts seconds from `zero_ns` of the reference.

    stretches: of the placement, in order; none for a log that is the reference or on its own. offset_ns, drift_ppm,
    error_s, method and sentence: the placement's, for people.
    """

    zero_ns: int = 0
    stretches: tuple[Stretch, ...] = ()
    offset_ns: int = 0
    drift_ppm: float = 0.0
    error_s: float | None = None
    method: str = ""
    sentence: str = ""
    reference: bool = True

    def seconds(self, stamp_ns: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) on the report's time line."""
        stamps = np.asarray(stamp_ns)
        since_zero = stamps - (np.int64(self.zero_ns) if stamps.dtype.kind == "i" else float(self.zero_ns))
        seconds: NDArray[np.float64] = since_zero.astype(np.float64) * 1e-9
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


class LaidLog:
    """The log, its stamps as they are, that knows how they lie on the time line of the report."""

    def __init__(self, log: Log, time_line: TimeLine) -> None:
        self.inner = log
        self.time_line = time_line

    @property
    def path(self) -> Path:
        return self.inner.path

    @property
    def format(self) -> Format:
        return self.inner.format

    @property
    def base(self) -> Base:
        return self.inner.base

    @property
    def tables(self) -> Mapping[str, Table]:
        return self.inner.tables

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self.inner.span_ns

    @property
    def health(self) -> Health:
        return self.inner.health

    @property
    def facts(self) -> Mapping[str, str]:
        return self.inner.facts

    def close(self) -> None:
        self.inner.close()

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
