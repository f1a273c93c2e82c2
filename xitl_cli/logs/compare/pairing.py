"""Two logs on one time line: of the same run by their clocks, of different runs by what happened in both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from xitl_cli.logs import signals
from xitl_cli.logs.compare.common_time import Instants, Pairing
from xitl_cli.logs.compare.one_run import contradiction
from xitl_cli.logs.compare.states import modes
from xitl_cli.logs.errors import LogError
from xitl_cli.logs.log import Log
from xitl_cli.logs.timeline.placement import Placement
from xitl_cli.logs.words.modes import NAVIGATING

Start = Literal["auto", "clocks", "mission", "armed", "motion", "correlation"]

_SAME_RUN = ("same clock", "clock records", "telemetry")
_MOVING_MPS = 0.3
_MOVING_S = 1.0


def pair(a: Log, b: Log, start: Start = "auto", shift_s: float | None = None) -> Pairing:
    """shift_s: B's first row is so much later than A's; None: found by `start`.

    auto: by clocks when both may be of one run, else where both begin a mission, arm, or begin to move, else by
    correlating a shared signal. Raises LogError when none of it, or not what was asked for, is in both.
    """
    for log in (a, b):
        if log.span_ns is None:
            raise LogError(f"{log.path}: holds nothing with a time, so it cannot be compared; give another log")
    assert a.span_ns is not None
    assert b.span_ns is not None
    if shift_s is not None:
        offset = a.span_ns[0] - b.span_ns[0] + round(shift_s * 1e9)
        return _shifted(offset, "shift", f"B begins {shift_s:g} s after A, as asked")
    if a.path.resolve() == b.path.resolve():
        return _shifted(0, "same file", "A and B are one file")
    tried: list[str] = []
    for way in _order(a, b) if start == "auto" else (start,):
        found = _WAYS[way](a, b)
        if isinstance(found, Pairing):
            return found
        tried.append(found)
    raise LogError(
        f"{a.path} and {b.path} have no common time: {'; '.join(tried)}; lay one on the other with --shift SECONDS"
    )


def within(a: Log, b: Log, pairing: Pairing, from_s: float | None, until_s: float | None, armed: bool) -> Pairing:
    """Compares only from and until so many seconds after the zero (see `zero_ns`), and only while both were armed.

    Raises LogError when nothing is left.
    """
    zero = zero_ns(a, b, pairing)
    from_ns = None if from_s is None else zero + round(from_s * 1e9)
    until_ns = None if until_s is None else zero + round(until_s * 1e9)
    if armed:
        spans = signals.armed(a), signals.armed(b)
        for name, found in zip("AB", spans, strict=True):
            if not found:
                raise LogError(f"{name} does not show when it was armed; leave --armed out, or use --from and --until")
        begin = max(spans[0][0].from_ns, pairing.instant(spans[1][0].from_ns))
        end = min(spans[0][-1].until_ns, pairing.instant(spans[1][-1].until_ns))
        from_ns = begin if from_ns is None else max(begin, from_ns)
        until_ns = end if until_ns is None else min(end, until_ns)
    if from_ns is not None and until_ns is not None and from_ns >= until_ns:
        raise LogError("nothing is left to compare: the end comes before the beginning; choose other times")
    return replace(pairing, from_ns=from_ns, until_ns=until_ns)


def zero_ns(a: Log, b: Log, pairing: Pairing) -> int:
    """On A's time: where both begin together if they were laid by an event, else where the common time begins."""
    if pairing.zero_ns is not None:
        return pairing.zero_ns
    begins = [0 if log.span_ns is None else log.span_ns[0] for log in (a, b)]
    return max(begins[0], pairing.instant(begins[1]))


def _by_clocks(a: Log, b: Log) -> Pairing | str:
    from xitl_cli.logs.timeline.alignment import align

    moved = next(placement for placement in align([a, b]) if not placement.reference)
    if moved.method not in _SAME_RUN:
        return "their clocks do not say that they are of one run"
    found = _placed(moved, b, "taken as one run: ")
    against = contradiction(a, b, found)
    return found if against is None else f"their clocks would make them one run, but {against}"


def _by_correlation(a: Log, b: Log) -> Pairing | str:
    from xitl_cli.logs.timeline.alignment import by_signal

    moved = by_signal(a, b)
    if moved is None or not moved.aligned:
        return "no signal that both hold is alike" if moved is None else moved.sentence.removeprefix("not aligned: ")
    return _placed(moved, b, "")


def _placed(moved: Placement, b: Log, words: str) -> Pairing:
    said = Pairing(moved.on_reference, moved.method, words + moved.sentence, moved.error_s)
    if moved.log is b:
        return said

    def on_a(stamp_ns: Instants) -> Instants:
        # The inverse of A on B, by steps that shrink as drift does.
        back = stamp_ns - moved.offset_ns
        for _ in range(3):
            back = back + (stamp_ns - moved.on_reference(back))
        return back

    return replace(said, on_a=on_a)


def _order(a: Log, b: Log) -> tuple[str, ...]:
    """Two logs of an autopilot, or two recordings of a host, are of two runs, though their world may be the same."""
    autopilots = a.format == b.format == "dataflash"
    hosts = all(log.base == "simulation" and "/truth/state" in log.tables for log in (a, b))
    return _ORDER[1:] if autopilots or hosts else _ORDER


def _by_event(name: str, words: str, when: Callable[[Log], int | None]) -> Callable[[Log, Log], Pairing | str]:
    def way(a: Log, b: Log) -> Pairing | str:
        in_a, in_b = when(a), when(b)
        if in_a is None or in_b is None:
            return f"{'A' if in_a is None else 'B'} does not show when it {words}"
        return replace(_shifted(in_a - in_b, name, f"two runs, laid where each first {words}"), zero_ns=in_a)

    return way


def _mission_ns(log: Log) -> int | None:
    """The first navigating mode while armed: when it was entered, or armed in, whichever came later."""
    spans = signals.armed(log)
    for mode in modes(log):
        if mode.text.upper() not in NAVIGATING:
            continue
        for span in spans:
            if span.from_ns < mode.until_ns and mode.from_ns < span.until_ns:
                return max(mode.from_ns, span.from_ns)
    return None


def _armed_ns(log: Log) -> int | None:
    spans = signals.armed(log)
    return spans[0].from_ns if spans else None


def _motion_ns(log: Log) -> int | None:
    """The first time that it stays in motion for a second: an estimator that finds its place jumps."""
    speed = signals.ground_speed(log)
    if speed is None:
        return None
    moving = speed.values > _MOVING_MPS
    edges = np.flatnonzero(np.diff(np.concatenate(([0], moving.astype(np.int8), [0]))))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if speed.stamp_ns[end - 1] - speed.stamp_ns[begin] >= _MOVING_S * 1e9:
            return int(speed.stamp_ns[begin])
    return None


def _shifted(offset_ns: int, method: str, sentence: str) -> Pairing:
    return Pairing(lambda stamp_ns: np.asarray(stamp_ns, dtype=np.int64) + offset_ns, method, sentence)


_WAYS: dict[str, Callable[[Log, Log], Pairing | str]] = {
    "clocks": _by_clocks,
    "mission": _by_event("mission", "navigated by itself while armed", _mission_ns),
    "armed": _by_event("armed", "armed", _armed_ns),
    "motion": _by_event("motion", f"moved faster than {_MOVING_MPS} m/s", _motion_ns),
    "correlation": _by_correlation,
}
_ORDER = ("clocks", "mission", "armed", "motion", "correlation")
