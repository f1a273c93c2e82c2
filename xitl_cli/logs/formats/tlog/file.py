"""A telemetry log (.tlog) as MAVProxy, Mission Planner and QGroundControl write it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.file_bytes import FileBytes
from xitl_cli.logs.formats.tlog.frames import tables_of
from xitl_cli.logs.formats.tlog.index import Index, index
from xitl_cli.logs.log import Base, Format, Health
from xitl_cli.logs.table import Table, steps_back

_FIRST_YEAR_US, _LAST_YEAR_US = 978_307_200_000_000, 4_102_444_800_000_000  # 2001 and 2100
_LISTED_UNKNOWN = 3
_DAY_US, _MINUTE_US = 86_400_000_000, 60_000_000
_LARGEST_US = 9_223_372_036_854_775


class TelemetryLog:
    """Frames by message, stamped by the ground station that received them.

    A stamp that is far from those around it, or that damage has taken, is replaced by the one before. base is "utc", or
    "unknown" when the stamps are not of this century.
    """

    format: Format = "tlog"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._bytes = FileBytes(path)
        data = self._bytes.data
        found = index(data)
        stamp_us, replaced = _trusted(found)
        stamp_ns = stamp_us * 1000
        self.base: Base = "utc" if _plausible(stamp_us) else "unknown"
        self.tables: Mapping[str, Table] = tables_of("", data, found.start, found.kind, stamp_ns, found.start)
        self.span_ns = (int(stamp_ns.min()), int(stamp_ns.max())) if len(stamp_ns) else None
        self.health: Health = found.losses.health(
            len(data),
            len(found.start) + sum(found.unknown.values()),
            back_in_time=sum(steps_back(table.stamp_ns) for table in self.tables.values()),
            replaced_stamps=replaced,
            undecoded=_undecoded(found.unknown),
        )
        self.facts: Mapping[str, str] = {"signed frames": str(found.signed)} if found.signed else {}

    def close(self) -> None:
        """Tables keep the bytes as long as they are held."""
        self.tables = {}
        self._bytes.close()

    def __enter__(self) -> TelemetryLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _trusted(found: Index) -> tuple[NDArray[np.int64], int]:
    """(N,) µs, and how many of them had to be replaced."""
    doubted = ~found.stamped | (found.stamp_us > _LARGEST_US)
    stamps = np.where(doubted, 0, found.stamp_us).astype(np.int64)
    told = np.flatnonzero(~doubted)
    doubted[told[_strange(stamps[told])]] = True
    if not doubted.any():
        return stamps, 0
    trusted = np.flatnonzero(~doubted)
    if not len(trusted):
        return np.zeros_like(stamps), len(stamps)
    last = np.maximum(np.searchsorted(trusted, np.arange(len(stamps)), side="right") - 1, 0)
    return stamps[trusted[last]], int(doubted.sum())


def _strange(stamp_us: NDArray[np.int64]) -> NDArray[np.intp]:
    """Those a day from the median of the five around them, or a minute and out of order.

    A clock that is set, once, has none of them, and neither has a log with long silences.
    """
    steps = np.diff(stamp_us)
    jumps = np.flatnonzero(np.abs(steps) > _MINUTE_US)
    if not len(jumps) or len(stamp_us) < 5:
        return np.zeros(0, dtype=np.intp)
    doubtful = np.unique(jumps[:, None] + np.arange(-1, 3))
    doubtful = doubtful[(doubtful >= 0) & (doubtful < len(stamp_us))]
    around = np.clip(doubtful, 2, len(stamp_us) - 3)[:, None] + np.arange(-2, 3)
    away = np.abs(stamp_us[doubtful] - np.sort(stamp_us[around], axis=1)[:, 2])
    back = np.concatenate([[False], steps < 0, [False]])
    out_of_order = back[doubtful] | back[doubtful + 1]
    strange: NDArray[np.intp] = doubtful[(away > _DAY_US) | (out_of_order & (away > _MINUTE_US))]
    return strange


def _undecoded(unknown: Mapping[int, int]) -> dict[str, tuple[int, str]]:
    """The most frequent by number, the others together: in a damaged log any number can turn up once."""
    ordered = sorted(unknown.items(), key=lambda item: -item[1])
    listed, others = ordered[:_LISTED_UNKNOWN], ordered[_LISTED_UNKNOWN:]
    reasons = {f"message {number}": (count, "no dialect here has it") for number, count in listed}
    if others:
        reasons["further messages"] = (
            sum(count for _, count in others),
            f"{len(others)} other numbers that no dialect here has",
        )
    return reasons


def _plausible(stamp_us: NDArray[np.int64]) -> bool:
    return bool(len(stamp_us)) and _FIRST_YEAR_US <= float(np.median(stamp_us)) <= _LAST_YEAR_US
