"""Windows of PM with long loops: where in them the longest fell, and what else happened then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.running.loops import Loops
from xitl_cli.logs.running.moments import Moment, near, told

BESIDE_NS = 500_000_000  # of a loop that could be placed
PLACED = 0.7  # of the longest loop's time must be without a row of the loop
FAST_TABLES = ("ATT", "IMU", "RCOU", "XKF1", "NKF1", "GPS", "POS", "STER", "RATE")


@dataclass(frozen=True, slots=True)
class Window:
    """One that had long loops. placed: the pause in the log that the longest one left, None where none is found.

    leapt: it is long since the clock leapt ahead.
    """

    row: int
    placed: tuple[int, int] | None
    happened: str
    armed: bool
    leapt: bool


def with_long_loops(
    log: Log,
    windows: Loops,
    happened: Sequence[Moment],
    armed: list[tuple[int, int]],
    period_s: float | None,
) -> list[Window]:
    long = np.flatnonzero(np.nan_to_num(windows.long_loops) > 0.0)
    pauses = _pauses(log, period_s)
    found = []
    for row in long.tolist():
        from_ns, until_ns = int(windows.from_ns[row]), int(windows.until_ns[row])
        placed = _placed(pauses, from_ns, until_ns, float(windows.longest_us[row]) * 1e-6, log, period_s)
        begin, end = (from_ns, until_ns) if placed is None else placed
        beside = near(happened, begin, end, 0 if placed is None else BESIDE_NS)
        on = any(since < end and begin < until for since, until in armed)
        leapt = any(one.kind == "clock" for one in beside)
        found.append(Window(row, placed, told(beside), on, leapt))
    return found


def _pauses(log: Log, period_s: float | None) -> list[NDArray[np.int64]]:
    """Stamps of what is logged in about every loop."""
    if period_s is None:
        return []
    found = []
    for name in FAST_TABLES:
        table = log.tables.get(name)
        if table is None or len(table) < 20:
            continue
        stamps = np.unique(table.stamp_ns)
        if len(stamps) > 2 and float(np.median(np.diff(stamps))) * 1e-9 < 2.5 * period_s:
            found.append(stamps)
    return found


def _placed(
    pauses: list[NDArray[np.int64]],
    from_ns: int,
    until_ns: int,
    longest_s: float,
    log: Log,
    period_s: float | None,
) -> tuple[int, int] | None:
    """Where nothing of the loop was logged for as long as the longest loop; before the log's first row at its start."""
    if not np.isfinite(longest_s) or period_s is None or longest_s < 2.0 * period_s:
        return None
    best: tuple[int, int] | None = None
    for stamps in pauses:
        first, last = np.searchsorted(stamps, (from_ns - round(longest_s * 1e9), until_ns))
        inside = stamps[max(int(first) - 1, 0) : int(last) + 1]
        if len(inside) < 2:
            continue
        widest = int(np.argmax(np.diff(inside)))
        begin, end = int(inside[widest]), int(inside[widest + 1])
        if end - begin >= PLACED * longest_s * 1e9 and (best is None or end - begin < best[1] - best[0]):
            best = (begin, end)
    if best is not None:
        return best
    begins_ns = log.span_ns[0] if log.span_ns else from_ns
    if pauses and from_ns < begins_ns < until_ns:  # no pause since the first row, so it was before
        return (begins_ns - round(longest_s * 1e9), begins_ns)
    return None
