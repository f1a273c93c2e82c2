"""UTC of a log with time that counts from the start of an autopilot or of a run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.clocks.readings import (
    EARLIEST_UTC_NS,
    GPS_EPOCH_S,
    GPS_LEAP_S,
    LATEST_UTC_NS,
    WEEK_MS,
    whole_numbers,
)
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Stamps, Table, first_of
from xitl_cli.logs.signals import px4

_FIX_3D = 3
_MOST_WEEKS = 10_000
_RECEIVED = "/rx"


@dataclass(frozen=True, slots=True)
class UtcOffset:
    """Offset of UTC from the stamps of a log."""

    offset_ns: int
    """UTC minus the log's stamps."""
    source: str
    """Source of the offset, worded to follow "UTC"."""


def utc_offset(log: Log) -> UtcOffset | None:
    """Return the median offset by the log's best source of UTC: GPS, the autopilot's clock or SYSTEM_TIME.

    None if there is no source.
    """
    if log.base == "utc":
        return UtcOffset(0, "of the receiving machine")
    for source, stamp_ns, utc_ns in _told(log):
        known = (utc_ns > EARLIEST_UTC_NS) & (utc_ns < LATEST_UTC_NS)
        if known.any():
            offset_ns = np.sort(utc_ns[known] - stamp_ns[known])
            return UtcOffset(int(offset_ns[len(offset_ns) // 2]), source)
    return None


def in_utc(stamp_ns: Stamps, utc: UtcOffset | None) -> Stamps:
    """Stamps in UTC; unchanged if UTC is unknown."""
    if utc is None:
        return stamp_ns
    return np.minimum(stamp_ns, np.iinfo(np.int64).max - max(utc.offset_ns, 0)) + utc.offset_ns


def _told(log: Log) -> Iterator[tuple[str, Stamps, Stamps]]:
    """Yield source, stamps and UTC at each stamp, without a plausibility check."""
    if (told := px4.utc(log)) is not None:
        yield "by GPS", *told
    gps = log.tables.get("GPS")
    if gps is not None and "Status" in gps.columns:
        week, ms = first_of(gps, ("GWk", "Week")), first_of(gps, ("GMS", "TimeMS"))
        if week is not None and ms is not None:
            weeks = whole_numbers(gps, week)
            fixed = (np.asarray(gps.values("Status", raw=True)) >= _FIX_3D) & (weeks > 0) & (weeks < _MOST_WEEKS)
            since_ms = weeks[fixed] * WEEK_MS + whole_numbers(gps, ms)[fixed]
            yield "by GPS", gps.stamp_ns[fixed], since_ms * 1_000_000 + (GPS_EPOCH_S - GPS_LEAP_S) * 1_000_000_000
    performance = log.tables.get("PM")
    if performance is not None and "R" in performance.columns:
        yield "by PM.R", performance.stamp_ns, whole_numbers(performance, "R") * 1000
    for table in _system_times(log):
        if "time_unix_usec" in table.columns:
            yield "by SYSTEM_TIME", table.stamp_ns, whole_numbers(table, "time_unix_usec") * 1000


def _system_times(log: Log) -> Iterator[Table]:
    if "SYSTEM_TIME" in log.tables:
        yield log.tables["SYSTEM_TIME"]
    for topic in log.tables if log.of_topics else ():
        if topic.endswith(_RECEIVED) and f"{topic}:SYSTEM_TIME" in log.tables:
            yield log.tables[f"{topic}:SYSTEM_TIME"]
