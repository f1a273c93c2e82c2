"""When the estimator had what: which filter was in use, its origin, its first position, its height origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xitl_cli.logs import signals
from xitl_cli.logs.analyses.estimator.cores import Core, whole
from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Finding, Severity
from xitl_cli.logs.words.estimator import ABSOLUTE, ACTIVE, GPS_CHECKS
from xitl_cli.logs.words.heard import heard

_AT_START_NS = 1_000_000_000
_DIFFERENT_M = 0.01


@dataclass(frozen=True, slots=True)
class Origin:
    """set_ns: None where it was set before the log began. altitude_m: of ORGN, height_m: XKF1.OH at first."""

    set_ns: int | None
    latitude_deg: float | None
    longitude_deg: float | None
    altitude_m: float | None
    height_m: float | None
    heights: tuple[tuple[int, float], ...]


@dataclass(frozen=True, slots=True)
class Use:
    """A filter that steers attitude and position, from when until when."""

    from_ns: int
    until_ns: int
    name: str


def origin(log: Log, every: list[Core], instants: Instants) -> Origin | None:
    """The estimator's, None when the log shows none."""
    rows = _origin_rows(log)
    heights = _heights(every)
    said = [text.at_ns for text in signals.texts(log) if "origin set" in text.text.lower()]
    if not rows and not heights and not said:
        return None
    # A new log repeats the origin in its first rows.
    known = [*said, *(at_ns for at_ns, *_ in rows), *(at_ns for at_ns, _ in heights[:1])]
    first_ns = min(known)
    before = first_ns <= instants.start_ns + _AT_START_NS
    latitude, longitude, altitude = rows[0][1:] if rows else (None, None, None)
    return Origin(
        None if before else first_ns, latitude, longitude, altitude, heights[0][1] if heights else None, tuple(heights)
    )


def first_position_ns(every: list[Core]) -> int | None:
    """When a core first said that its absolute position is good."""
    found = []
    for core in every:
        if core.health is not None and "SS" in core.health.columns:
            good = np.flatnonzero(whole(core.health, "SS") & ABSOLUTE)
            found += [int(core.health.stamp_ns[good[0]])] if len(good) else []
    return min(found, default=None)


def never_positioned(every: list[Core], armed: list[tuple[int, int]], instants: Instants) -> list[Finding]:
    """No core ever had an absolute position, and what its checks of GPS said most often."""
    tables = [core.health for core in every if core.health is not None and "SS" in core.health.columns]
    if not tables or first_position_ns(every) is not None:
        return []
    why = ""
    if "GPS" in tables[0].columns and (checks := whole(tables[0], "GPS")).any():
        failed = [(int(np.count_nonzero(checks >> bit & 1)), name) for bit, name in GPS_CHECKS.items()]
        names = [name for count, name in sorted(failed, reverse=True) if count][:3]
        why = f"; its checks of GPS failed for {', '.join(names)}"
    last_ns = int(tables[0].stamp_ns[-1])
    return [
        Finding(
            "estimator.never_positioned",
            Severity.WARNING if armed else Severity.NOTICE,
            f"The estimator had no absolute position until {instants.text(last_ns)}, when the log ends{why}",
            (Evidence(tables[0].name, "SS", int(tables[0].stamp_ns[0]), last_ns),),
            "Look at the GNSS section, and wait for the position before arming in a mode that needs one.",
        )
    ]


def uses(log: Log) -> list[Use]:
    """By ATT.AEKF; empty where it is not logged."""
    table = log.tables.get("ATT")
    if table is None or "AEKF" not in table.columns or not len(table):
        return []
    numbers = whole(table, "AEKF")
    stamps = table.stamp_ns
    begins = np.flatnonzero(np.concatenate(([True], np.diff(numbers) != 0)))
    ends = np.concatenate((stamps[begins[1:]], stamps[-1:]))
    return [
        Use(int(stamps[begin]), int(end), ACTIVE.get(int(numbers[begin]), f"filter {int(numbers[begin])}"))
        for begin, end in zip(begins, ends, strict=True)
    ]


def _origin_rows(log: Log) -> list[tuple[int, float, float, float]]:
    table = log.tables.get("ORGN")
    if table is not None and {"Type", "Lat", "Lng", "Alt"} <= set(table.columns):
        rows = np.flatnonzero(whole(table, "Type") == 0)
        columns = (np.asarray(table.values(name, rows), dtype=np.float64).tolist() for name in ("Lat", "Lng", "Alt"))
        return list(zip(table.stamp_ns[rows].tolist(), *columns, strict=True))
    table = heard(log, "GPS_GLOBAL_ORIGIN")
    if table is not None and {"latitude", "longitude", "altitude"} <= set(table.columns):
        names = ("latitude", "longitude", "altitude")
        columns = (np.asarray(table.values(name), dtype=np.float64).tolist() for name in names)
        return list(zip(table.stamp_ns.tolist(), *columns, strict=True))
    return []


def _heights(every: list[Core]) -> list[tuple[int, float]]:
    """(stamp, m) where the height of the origin changed, of the first core that logs it; 0 means that there is none."""
    for core in every:
        if core.solution is None or "OH" not in core.solution.columns:
            continue
        values = np.asarray(core.solution.values("OH"), dtype=np.float64)
        kept = np.flatnonzero(np.isfinite(values) & (values != 0.0))
        if not len(kept):
            continue
        new = np.concatenate(([True], np.abs(np.diff(values[kept])) >= _DIFFERENT_M))
        rows = kept[new]
        return list(zip(core.solution.stamp_ns[rows].tolist(), values[rows].tolist(), strict=True))
    return []
