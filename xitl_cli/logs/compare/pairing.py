"""Two logs on one time line, and their samples at common instants.

Logs of one run are paired by their clocks, logs of different runs by events that both show.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import xitl_cli.logs.signals as signals
from xitl_cli.logs.clocks.time_line import NOT_ALIGNED, LogPlacement
from xitl_cli.logs.model.codes import NAVIGATING
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Grid, Section
from xitl_cli.logs.model.table import Floats, Stamps, rising
from xitl_cli.logs.signals import Series, StateSpan
from xitl_cli.logs.signals.spans import runs

_MOST_SAMPLES = 200_000
_LONGEST_GAP_S = 2.0
_USUAL_STEPS = 3.0


@dataclass(frozen=True, slots=True)
class Pairing:
    """Conversion of stamps of B to stamps of A."""

    on_a: Callable[[Stamps], Stamps]
    method: str
    sentence: str
    """For the user."""
    error_s: float | None = None
    """Possible error; None if unknown."""
    zero_ns: int | None = None
    """On A's time: zero of the seconds, if an event defines it."""
    from_ns: int | None = None
    """Beginning of the compared time, on A's time; None: of the common time."""
    until_ns: int | None = None
    """End of the compared time, on A's time; None: of the common time."""

    def instant(self, stamp_ns: int) -> int:
        """Return one stamp of B on A's time."""
        return int(self.on_a(np.array([stamp_ns], dtype=np.int64))[0])

    def on_a_time(self, series: Series) -> Series:
        """Return a series of B on A's time. Samples with a stamp before the previous sample are omitted."""
        stamps = self.on_a(series.stamp_ns)
        forward = rising(stamps)
        return Series(stamps[forward], series.values[forward], series.unit, series.source, series.turns)


def common_samples(a: Series, b: Series, pairing: Pairing) -> tuple[Stamps, Floats, Floats] | None:
    """Stamps (N,) of A within B's time, A's values there, and B's interpolated linearly; at most 200 000.

    Stamps within a gap of B are omitted: more than 2 s and more than 3 of its usual steps. None with fewer than two.
    """
    other = pairing.on_a_time(b)
    inside = (a.stamp_ns >= other.stamp_ns[0]) & (a.stamp_ns <= other.stamp_ns[-1])
    if pairing.from_ns is not None:
        inside &= a.stamp_ns >= pairing.from_ns
    if pairing.until_ns is not None:
        inside &= a.stamp_ns <= pairing.until_ns
    stamps, values = a.stamp_ns[inside], a.values[inside]
    every = max(1, -(-len(stamps) // _MOST_SAMPLES))
    stamps, values = stamps[::every], values[::every]
    if len(stamps) < 2 or len(other.stamp_ns) < 2:
        return None
    steps_s = np.diff(other.stamp_ns) * 1e-9
    after = np.clip(np.searchsorted(other.stamp_ns, stamps), 1, len(other.stamp_ns) - 1)
    near = steps_s[after - 1] <= _gap_s(steps_s)
    stamps, values = stamps[near], values[near]
    return None if len(stamps) < 2 else (stamps, values, other.interpolated(stamps))


def time_integral(stamp_ns: Stamps, values: Floats) -> tuple[float, float]:
    """Covered seconds and the integral over them, by trapezoids, without gaps (as in `common_samples`)."""
    steps_s = np.diff(stamp_ns) * 1e-9
    if not len(steps_s):
        return 0.0, 0.0
    joined = steps_s <= _gap_s(steps_s)
    areas = 0.5 * (values[1:] + values[:-1]) * steps_s
    return float(steps_s[joined].sum()), float(areas[joined].sum())


def _gap_s(steps_s: Floats) -> float:
    """Longest step that is not a gap."""
    return max(_LONGEST_GAP_S, _USUAL_STEPS * float(np.median(steps_s)))


LONGEST_S = 10.0
LEAST_ALIKE = 0.5
_STEP_S = 0.025
_MOST_STEPS = 20_000
_LEAST_CHANGE = 1e-9


def best_lag(
    stamp_ns: Stamps, a: Floats, b: Floats, *, turns: bool, longest_s: float = LONGEST_S
) -> tuple[float | None, float | None]:
    """Highest correlation coefficient within shifts of `longest_s`, and the delay (s) of B at that shift.

    Both are sampled at `stamp_ns`. Angles (deg) are correlated as directions, so that full turns do not count. The
    coefficient is None if one of them does not change. The lag is None too if the coefficient is below 0.5 or the best
    shift is the longest.
    """
    seconds = (stamp_ns - stamp_ns[0]) * 1e-9
    step_s = max(_STEP_S, float(seconds[-1]) / _MOST_STEPS)
    grid = np.arange(0.0, float(seconds[-1]), step_s)
    most = min(int(longest_s / step_s), len(grid) // 4)
    if most < 1:
        return None, None
    in_a, in_b = _even(grid, seconds, a, turns), _even(grid, seconds, b, turns)
    if min(float(np.abs(in_a - in_a[0]).max()), float(np.abs(in_b - in_b[0]).max())) < _LEAST_CHANGE:
        return None, None
    correlations = np.array([_correlation(in_a, in_b, shift) for shift in range(-most, most + 1)])
    if not np.isfinite(correlations).any():
        return None, None
    best = int(np.nanargmax(correlations))
    highest = float(correlations[best])
    if highest < LEAST_ALIKE or not 0 < best < len(correlations) - 1:
        return highest, None
    left, top, right = correlations[best - 1 : best + 2]
    bend = float(left - 2.0 * top + right)
    between = 0.5 * float(left - right) / bend if np.isfinite(bend) and bend < 0.0 else 0.0
    return highest, (best + between - most) * step_s


def _even(grid: Floats, seconds: Floats, values: Floats, turns: bool) -> NDArray[Any]:
    if not turns:
        return np.interp(grid, seconds, values)
    angle = np.radians(values)
    return np.interp(grid, seconds, np.cos(angle)) + 1j * np.interp(grid, seconds, np.sin(angle))


def _correlation(a: NDArray[Any], b: NDArray[Any], shift: int) -> float:
    """Correlation of a(t) with b(t + shift)."""
    first, second = (a[: len(a) - shift], b[shift:]) if shift >= 0 else (a[-shift:], b[:shift])
    first, second = first - first.mean(), second - second.mean()
    scale = float(np.sqrt(np.vdot(first, first).real * np.vdot(second, second).real))
    return float(np.vdot(first, second).real) / scale if scale > 0.0 else np.nan


_WITHIN_S = 1.0
_FEWEST = 50
_LEAST_ALIKE = 0.8
_CHECKED_SIGNALS: tuple[tuple[str, Callable[[Log], Series | None], float], ...] = (
    ("roll", signals.roll, 0.5),
    ("pitch", signals.pitch, 0.5),
    ("speed over ground", signals.ground_speed, 0.2),
    ("yaw", signals.yaw, 2.0),
)
"""With the scatter above which a signal is motion. Waves and gusts, which differ from run to run, come first."""


def contradiction(a: Log, b: Log, pairing: Pairing) -> str | None:
    """Return the end of a sentence if a signal that moves differs between the logs; else None."""
    for name, signal_of, moving in _CHECKED_SIGNALS:
        in_a = signal_of(a)
        in_b = None if in_a is None else signal_of(b)
        matched = None if in_a is None or in_b is None else common_samples(in_a, in_b, pairing)
        if matched is None or in_a is None or len(matched[0]) < _FEWEST:
            continue
        stamps, first, second = matched
        if min(_scatter(first, in_a.turns), _scatter(second, in_a.turns)) < moving:
            continue
        alike, _ = best_lag(stamps, first, second, turns=in_a.turns, longest_s=_WITHIN_S)
        if alike is not None and alike < _LEAST_ALIKE:
            return f"{name} of both correlates {alike:.2f} there"
    return None


def _scatter(values: np.ndarray, turns: bool) -> float:
    return float(np.std(np.unwrap(values, period=360.0) if turns else values))


_REACHED = re.compile(r"reached waypoint #?(\d+)", re.IGNORECASE)
_ENTERED = re.compile(r"mode (\w+)", re.IGNORECASE)
_COMPLETE = re.compile(r"mission (is )?complete", re.IGNORECASE)
_MOST_ROWS = 200
_BEAT_NS = 2_500_000_000


@dataclass(frozen=True, slots=True)
class PairedEvent:
    """An event on A's time."""

    what: str
    at_s: float
    """After the zero of the comparison."""


def precise_modes(log: Log) -> list[StateSpan]:
    """Mode spans as `signals.modes`. Spans from heartbeats, which are a second late, begin at the autopilot's text."""
    modes = signals.modes(log)
    if not any("HEARTBEAT" in mode.source for mode in modes):
        return modes
    announced: dict[str, list[int]] = {}
    for text in signals.texts(log):
        if match := _ENTERED.fullmatch(text.text.strip()):
            announced.setdefault(match[1].upper(), []).append(text.at_ns)
    begins = []
    for mode in modes:
        texts_ns = announced.get(mode.text.upper(), ())
        begins.append(min((at for at in texts_ns if 0 <= mode.from_ns - at <= _BEAT_NS), default=mode.from_ns))
    ends = [*begins[1:], modes[-1].until_ns]
    return [
        replace(mode, from_ns=begin, until_ns=max(begin, end))
        for mode, begin, end in zip(modes, begins, ends, strict=True)
    ]


def paired_events(log: Log, seconds: Callable[[int], float]) -> list[PairedEvent]:
    """Armed, disarmed, modes entered, waypoints reached, in order of time."""
    span = log.span_ns
    events: list[PairedEvent] = []
    for armed in signals.armed(log):
        events.append(PairedEvent("armed", seconds(armed.from_ns)))
        if span is not None and armed.until_ns < span[1]:
            events.append(PairedEvent("disarmed", seconds(armed.until_ns)))
    events += [PairedEvent(f"mode {mode.text}", seconds(mode.from_ns)) for mode in precise_modes(log)]
    for text in signals.texts(log):
        if match := _REACHED.search(text.text):
            events.append(PairedEvent(f"waypoint {int(match[1])} reached", seconds(text.at_ns)))
        elif _COMPLETE.search(text.text):
            events.append(PairedEvent("mission complete", seconds(text.at_ns)))
    return sorted(events, key=lambda event: event.at_s)


def event_section(a: Log, b: Log, pairing: Pairing, zero_ns: int) -> Section | None:
    """Events of both logs in order of time: the n-th event of a kind in A next to the n-th in B; None without any."""
    in_a = paired_events(a, lambda at_ns: (at_ns - zero_ns) * 1e-9)
    in_b = paired_events(b, lambda at_ns: (pairing.instant(at_ns) - zero_ns) * 1e-9)
    waiting: dict[str, list[float]] = {}
    for event in in_b:
        waiting.setdefault(event.what, []).append(event.at_s)
    pairs: list[tuple[str, float | None, float | None]] = []
    for event in in_a:
        left = waiting.get(event.what, [])
        pairs.append((event.what, event.at_s, left.pop(0) if left else None))
    pairs += [(what, None, at_s) for what, left in waiting.items() for at_s in left]
    if not pairs:
        return None
    pairs.sort(key=lambda pair: min(at for at in pair[1:] if at is not None))
    rows = []
    for what, at_a, at_b in pairs[:_MOST_ROWS]:
        later = None if at_a is None or at_b is None else at_b - at_a
        rows.append((what, *(None if at_s is None else round(at_s, 3) for at_s in (at_a, at_b, later))))
    columns = ("event", "A (s)", "B (s)", "B later (s)")
    grid = Grid("compare.events", "Seconds after the zero", columns, tuple(rows))
    return Section("events", "Events", grids=(grid,))


StartEvent = Literal["auto", "clocks", "mission", "armed", "motion", "correlation"]

_SAME_RUN = ("same clock", "clock records", "telemetry")
_MOVING_MPS = 0.3
_MOVING_S = 1.0


def pair_logs(a: Log, b: Log, start: StartEvent = "auto", shift_s: float | None = None) -> Pairing:
    """Pair two logs.

    shift_s: B's first row is this much later than A's; None: `start` determines it.

    start: "auto" uses clocks if both logs may be of one run. Otherwise, it uses the first instant at which both begin a
    mission, arm or begin to move, else the correlation of a shared signal. Raises LogError if no method, or not the
    requested method, applies to both.
    """
    for log in (a, b):
        if log.span_ns is None:
            raise LogError(f"{log.path}: has no time stamps and cannot be compared; choose another log")
    assert a.span_ns is not None
    assert b.span_ns is not None
    if shift_s is not None:
        offset = a.span_ns[0] - b.span_ns[0] + round(shift_s * 1e9)
        return _shifted(offset, "shift", f"B begins {shift_s:g} s after A, as asked")
    if a.path.resolve() == b.path.resolve():
        return _shifted(0, "same file", "A and B are one file")
    tried: list[str] = []
    methods: tuple[str, ...] = (start,)
    if start == "auto":
        # Two logs of an autopilot, or two recordings of a host, are of two runs, even in the same world.
        autopilots = a.format == b.format == "dataflash"
        hosts = all(log.base == "simulation" and "/truth/state" in log.tables for log in (a, b))
        methods = _ORDER[1:] if autopilots or hosts else _ORDER
    for method in methods:
        pairing = _WAYS[method](a, b)
        if isinstance(pairing, Pairing):
            return pairing
        tried.append(pairing)
    raise LogError(
        f"{a.path} and {b.path} cannot be aligned in time: {'; '.join(tried)}; align them with --shift SECONDS"
    )


def limited(a: Log, b: Log, pairing: Pairing, from_s: float | None, until_s: float | None, armed: bool) -> Pairing:
    """Limit the comparison to seconds after the zero (see `zero_ns`), and to the time in which both were armed.

    Raises LogError if nothing is left.
    """
    zero = zero_ns(a, b, pairing)
    from_ns = None if from_s is None else zero + round(from_s * 1e9)
    until_ns = None if until_s is None else zero + round(until_s * 1e9)
    if armed:
        spans = signals.armed(a), signals.armed(b)
        for name, own in zip("AB", spans, strict=True):
            if not own:
                raise LogError(f"{name} does not show when it was armed; omit --armed, or use --from and --until")
        begin = max(spans[0][0].from_ns, pairing.instant(spans[1][0].from_ns))
        end = min(spans[0][-1].until_ns, pairing.instant(spans[1][-1].until_ns))
        from_ns = begin if from_ns is None else max(begin, from_ns)
        until_ns = end if until_ns is None else min(end, until_ns)
    if from_ns is not None and until_ns is not None and from_ns >= until_ns:
        raise LogError("nothing to compare: the end is before the beginning; choose other times")
    return replace(pairing, from_ns=from_ns, until_ns=until_ns)


def zero_ns(a: Log, b: Log, pairing: Pairing) -> int:
    """On A's time: the event that paired the logs, else the start of the common time."""
    if pairing.zero_ns is not None:
        return pairing.zero_ns
    begins = [0 if log.span_ns is None else log.span_ns[0] for log in (a, b)]
    return max(begins[0], pairing.instant(begins[1]))


def _by_clocks(a: Log, b: Log) -> Pairing | str:
    from xitl_cli.logs.clocks.alignment import align_logs as align

    moved = next(placement for placement in align([a, b]) if not placement.reference)
    if moved.method not in _SAME_RUN:
        return "their clocks do not show that they are of one run"
    pairing = _placed(moved, b, "taken as one run: ")
    against = contradiction(a, b, pairing)
    return pairing if against is None else f"by their clocks they are of one run, but {against}"


def _by_correlation(a: Log, b: Log) -> Pairing | str:
    from xitl_cli.logs.clocks.alignment import align_by_signal as by_signal

    moved = by_signal(a, b)
    if moved is None or not moved.aligned:
        return "no shared signal is similar" if moved is None else moved.sentence.removeprefix(NOT_ALIGNED)
    return _placed(moved, b, "")


def _placed(moved: LogPlacement, b: Log, words: str) -> Pairing:
    pairing = Pairing(moved.on_reference, moved.method, words + moved.sentence, moved.error_s)
    if moved.log is b:
        return pairing

    def on_a(stamp_ns: Stamps) -> Stamps:
        # Invert A on B by iteration; the error shrinks with the drift at each step.
        back = stamp_ns - moved.offset_ns
        for _ in range(3):
            back = back + (stamp_ns - moved.on_reference(back))
        return back

    return replace(pairing, on_a=on_a)


def _by_event(name: str, words: str, when: Callable[[Log], int | None]) -> Callable[[Log, Log], Pairing | str]:
    def way(a: Log, b: Log) -> Pairing | str:
        in_a, in_b = when(a), when(b)
        if in_a is None or in_b is None:
            return f"{'A' if in_a is None else 'B'} does not show when it {words}"
        return replace(_shifted(in_a - in_b, name, f"two runs, aligned where each first {words}"), zero_ns=in_a)

    return way


def _mission_ns(log: Log) -> int | None:
    """First instant in a navigating mode while armed."""
    spans = signals.armed(log)
    for mode in precise_modes(log):
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
    """First instant after which it moves for a second, because an estimator jumps when it finds its position."""
    speed = signals.ground_speed(log)
    if speed is None:
        return None
    for begin, end in runs(speed.values > _MOVING_MPS):
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
