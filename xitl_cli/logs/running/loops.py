"""PM rows by what they mean: names changed from version to version."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.table import Table, first_of

Floats = NDArray[np.float64]

SITL_BOARD = 3  # VER.BT
LONGEST_WINDOW_NS = 60_000_000_000
USUAL_WINDOW_NS = 10_000_000_000
LONG_AT = 1.2
LOCKSTEP = "Lockstep:"

# Oldest name last. A field is named by its meaning: what counts up, and what is of the window.
_LONG, _LOOPS, _LONGEST, _LOAD = ("NLon",), ("NL", "NLoop"), ("MaxT",), ("Load",)
_EXTRA, _RATE, _MEMORY = ("Ex", "ExUS"), ("LR",), ("Mem",)
_COUNTERS = (
    ("internal_errors", "internal errors", ("ErC", "ErrC", "IntEC")),
    ("spi", "SPI transactions", ("SPIC",)),
    ("i2c", "I2C transactions", ("I2CC",)),
    ("i2c_interrupts", "I2C interrupts", ("I2CI",)),
)


@dataclass(frozen=True, slots=True)
class Counter:
    """Counts up since boot. grown: (N,) by how much in each window, 0 where it went back (a restart)."""

    key: str
    label: str
    field: str
    total: int
    grown: Floats


@dataclass(frozen=True, slots=True)
class Loops:
    """(N,) a window each. from_ns, until_ns: what it covers. NaN arrays stand for fields that this version lacks.

    long_loops: of 1.2 periods and more. longest_us: from one IMU sample to the next, not processor time.
    load_percent: saturates at 100 when the loop rate falls under 95 % of what it should be. extra_us: added to the
    loop's budget for tasks that are 8 times late. rate_hz: loop rate as filtered. memory_bytes: free.
    """

    from_ns: NDArray[np.int64]
    until_ns: NDArray[np.int64]
    loops: Floats
    long_loops: Floats
    longest_us: Floats
    load_percent: Floats
    extra_us: Floats
    rate_hz: Floats
    memory_bytes: Floats
    counters: tuple[Counter, ...]
    names: tuple[tuple[str, str], ...]

    def field(self, meaning: str) -> str:
        """What this version calls it."""
        return dict(self.names)[meaning]

    @property
    def period_s(self) -> float | None:
        """Of the loop, by its own filtered rate, else by the windows."""
        rates = self.rate_hz[np.isfinite(self.rate_hz) & (self.rate_hz > 0.0)]
        if len(rates):
            return 1.0 / float(np.median(rates))
        length_s = (self.until_ns - self.from_ns).astype(np.float64) * 1e-9
        known = (self.loops > 0.0) & (length_s > 0.0)
        return float(np.median(length_s[known] / self.loops[known])) if known.any() else None


def loops(log: Log) -> Loops | None:
    """None without a PM row."""
    table = log.tables.get("PM")
    if table is None or not len(table):
        return None
    until_ns = table.stamp_ns
    length_ns = np.diff(until_ns)
    usual = length_ns[(length_ns > 0) & (length_ns < LONGEST_WINDOW_NS)]
    usual_ns = int(np.median(usual)) if len(usual) else USUAL_WINDOW_NS
    from_ns = until_ns - np.concatenate(([usual_ns], length_ns))
    wrong = (from_ns >= until_ns) | (until_ns - from_ns > LONGEST_WINDOW_NS)
    from_ns = np.where(wrong, until_ns - usual_ns, from_ns)
    meanings = {
        "long_loops": _LONG, "loops": _LOOPS, "longest_us": _LONGEST, "load_percent": _LOAD, "extra_us": _EXTRA,
        "rate_hz": _RATE, "memory_bytes": _MEMORY,
    }  # fmt: skip
    names = {meaning: first_of(table, fields) for meaning, fields in meanings.items()}
    values = {meaning: _values(table, name) for meaning, name in names.items()}
    values["load_percent"] = values["load_percent"] * 0.1
    counters = []
    for key, label, fields in _COUNTERS:
        name = first_of(table, fields)
        if name is not None:
            counted = _values(table, name)
            grown = np.maximum(np.diff(counted, prepend=counted[:1]), 0.0)
            counters.append(Counter(key, label, name, int(np.nansum(grown)), grown))
    known = tuple((meaning, name) for meaning, name in names.items() if name is not None)
    return Loops(from_ns=from_ns, until_ns=until_ns, counters=tuple(counters), names=known, **values)


def _values(table: Table, name: str | None) -> Floats:
    """As stored, NaN without the field."""
    if name is None or table.columns[name].kind != "number":
        return np.full(len(table), np.nan)
    values = np.asarray(table.values(name, raw=True), dtype=np.float64)
    return values if values.ndim == 1 else np.full(len(table), np.nan)


def simulated(log: Log) -> str:
    """Why loop times of this log say nothing of a processor; "" where they do."""
    version = log.tables.get("VER")
    if version is not None and "BT" in version.columns and SITL_BOARD in version.values("BT", raw=True)[-1:].tolist():
        return "the board is ArduPilot's own simulator (VER.BT 3)"
    if "SIM" in log.tables:
        return "a simulator writes into it (SIM)"
    messages = log.tables.get("MSG")
    said = () if messages is None or "Message" not in messages.columns else messages.values("Message", slice(0, 50))
    if any(str(text).startswith(LOCKSTEP) for text in said):
        return "it ran in lockstep (MSG)"
    found = loops(log)
    if version is None and found is not None and len(found.until_ns) >= 3:
        load, longest = found.load_percent, found.longest_us
        if np.isfinite(load).all() and not load.any() and np.isfinite(longest).all() and len(set(longest[1:])) == 1:
            return "load is always 0 and the longest loop the same in every window"
    return ""
