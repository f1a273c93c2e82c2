"""What happened, side by side: armed, modes, waypoints, sentences."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from xitl_cli.logs import signals
from xitl_cli.logs.compare.common_time import Pairing
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Grid, Section
from xitl_cli.logs.signals import Span

_REACHED = re.compile(r"reached waypoint #?(\d+)", re.IGNORECASE)
_ENTERED = re.compile(r"mode (\w+)", re.IGNORECASE)
_COMPLETE = re.compile(r"mission (is )?complete", re.IGNORECASE)
_MOST_ROWS = 200
_BEAT_NS = 2_500_000_000


@dataclass(frozen=True, slots=True)
class Happening:
    """at_s: after the zero of the comparison, on A's time."""

    what: str
    at_s: float


def modes(log: Log) -> list[Span]:
    """As `signals.modes`; those that heartbeats tell, a second late, from when the autopilot said so."""
    found = signals.modes(log)
    if not any("HEARTBEAT" in mode.source for mode in found):
        return found
    said: dict[str, list[int]] = {}
    for text in signals.texts(log):
        if match := _ENTERED.fullmatch(text.text.strip()):
            said.setdefault(match[1].upper(), []).append(text.at_ns)
    begins = [
        min((at for at in said.get(mode.text.upper(), ()) if 0 <= mode.from_ns - at <= _BEAT_NS), default=mode.from_ns)
        for mode in found
    ]
    ends = [*begins[1:], found[-1].until_ns]
    return [
        replace(mode, from_ns=begin, until_ns=max(begin, end))
        for mode, begin, end in zip(found, begins, ends, strict=True)
    ]


def happenings(log: Log, seconds: Callable[[int], float]) -> list[Happening]:
    """Armed, disarmed, modes entered, waypoints reached, in the order of time."""
    span = log.span_ns
    found: list[Happening] = []
    for armed in signals.armed(log):
        found.append(Happening("armed", seconds(armed.from_ns)))
        if span is not None and armed.until_ns < span[1]:
            found.append(Happening("disarmed", seconds(armed.until_ns)))
    found += [Happening(f"mode {mode.text}", seconds(mode.from_ns)) for mode in modes(log)]
    for text in signals.texts(log):
        if match := _REACHED.search(text.text):
            found.append(Happening(f"waypoint {int(match[1])} reached", seconds(text.at_ns)))
        elif _COMPLETE.search(text.text):
            found.append(Happening("mission complete", seconds(text.at_ns)))
    return sorted(found, key=lambda each: each.at_s)


def event_section(a: Log, b: Log, pairing: Pairing, zero_ns: int) -> Section | None:
    """None where nothing happened in either."""
    found = side_by_side(a, b, pairing, zero_ns)
    return None if found is None else Section("events", "Events", grids=(found,))


def side_by_side(a: Log, b: Log, pairing: Pairing, zero_ns: int) -> Grid | None:
    """Each happening of either, the n-th of its kind in A beside the n-th in B, in the order of time."""
    in_a = happenings(a, lambda at_ns: (at_ns - zero_ns) * 1e-9)
    in_b = happenings(b, lambda at_ns: (pairing.instant(at_ns) - zero_ns) * 1e-9)
    rows = []
    for what, at_a, at_b in _paired(in_a, in_b):
        later = None if at_a is None or at_b is None else round(at_b - at_a, 3)
        rows.append((what, _rounded(at_a), _rounded(at_b), later))
    if not rows:
        return None
    return Grid(
        "compare.events", "Seconds after the zero", ("event", "A (s)", "B (s)", "B later (s)"), tuple(rows[:_MOST_ROWS])
    )


def _paired(a: Sequence[Happening], b: Sequence[Happening]) -> list[tuple[str, float | None, float | None]]:
    waiting: dict[str, list[float]] = {}
    for each in b:
        waiting.setdefault(each.what, []).append(each.at_s)
    rows: list[tuple[str, float | None, float | None]] = []
    for each in a:
        left = waiting.get(each.what, [])
        rows.append((each.what, each.at_s, left.pop(0) if left else None))
    rows += [(what, None, at_s) for what, left in waiting.items() for at_s in left]
    return sorted(rows, key=lambda row: min(at for at in row[1:] if at is not None))


def _rounded(at_s: float | None) -> float | None:
    return None if at_s is None else round(at_s, 3)
