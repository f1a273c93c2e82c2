"""Alignment of several logs of one run on one time line.

If both logs have clock records, these align the logs, and a shared signal checks the result. Otherwise, correlation of
a shared signal aligns them. The reference is the host's recording, or the first log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from xitl_cli.logs.clocks.correlation import (
    SignalMatch,
    exceeds_noise,
    match_signals,
    moved_to_reference,
    offset_line,
    shared_signals,
)
from xitl_cli.logs.clocks.fit import ClockRelation, clock_relations
from xitl_cli.logs.clocks.readings import HOST, SIMULATION, UTC
from xitl_cli.logs.clocks.time_line import LogPlacement, placement_from
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Stamps, whole_ns
from xitl_cli.logs.signals.states import LOCKSTEP, first_text

BOOT, AGENT = "the autopilot's clock", "the agent's clock"
BEHIND_AGENT = "node autopilot"
OURS = "xitl "


@dataclass(frozen=True, slots=True)
class ClockChain:
    """Conversion from a log's own time to the reference."""

    to_reference: Callable[[Stamps], Stamps]
    breaks_ns: tuple[int, ...]
    """Bends and steps of the conversion, on the log's own time."""
    error_s: float
    method: str
    sentence: str


@dataclass(frozen=True, slots=True)
class _Way:
    """Conversion from a log's own time to a named clock and back."""

    clock: str
    out: Callable[[Stamps], Stamps]
    back: Callable[[Stamps], Stamps]
    breaks_ns: tuple[int, ...]
    error_s: float
    method: str
    by: str


def chains(reference: Log, log: Log) -> Iterator[ClockChain]:
    """Yield every possible conversion. It does not check whether two clocks since boot belong to the same autopilot."""
    theirs, ours = ways(reference), ways(log)
    if any(_lockstep(*pair) for pair in ((reference, log), (log, reference))):
        yield ClockChain(
            lambda stamp_ns: stamp_ns, (), 1e-3, "same clock", "in lockstep both are stamped with simulation time"
        )
    for mine in ours:
        for other in theirs:
            own_both = not mine.by and not other.by and mine.clock in (BOOT, AGENT)
            if _same(mine.clock, other.clock) and not own_both:  # clocks of two boots are different clocks
                yield _joined(mine, other)


def _same(one: str, other: str) -> bool:
    boots = (BOOT, AGENT, "autopilot ", "node ")
    if one.startswith("autopilot ") and other.startswith("autopilot "):
        return one == other
    if one == other:
        return True
    nodes = [clock for clock in (one, other) if clock.startswith("node ")]
    own = [clock for clock in (one, other) if clock in (BOOT, AGENT)]
    if nodes and own:  # another autopilot behind an agent has its own clock
        return (nodes[0] == BEHIND_AGENT) == (own[0] == BOOT)
    return one.startswith(boots) and other.startswith(boots) and len(nodes) < 2 and len(own) < 2


def _joined(mine: _Way, other: _Way) -> ClockChain:
    by = ", ".join(dict.fromkeys(part for part in (mine.by, other.by) if part))
    return ClockChain(
        lambda stamp_ns: other.back(mine.out(stamp_ns)),
        (*mine.breaks_ns, *(_own(mine, other, at_ns) for at_ns in other.breaks_ns)),
        float(np.hypot(mine.error_s, other.error_s)),
        "telemetry" if "telemetry" in (mine.method, other.method) else other.method if mine.by == "" else mine.method,
        f"over {other.clock}, by {by}" if by else f"both are stamped by {mine.clock}",
    )


def _own(mine: _Way, other: _Way, at_ns: int) -> int:
    """A break of the other log on this log's time: the middle of the interval that this log's clock jumped over
    there."""
    ends, begins = mine.back(other.out(np.array([at_ns - 1, at_ns], dtype=np.int64))).tolist()
    return int(begins - max(begins - ends, 0) // 2)


def _lockstep(reference: Log, log: Log) -> bool:
    """Whether both are stamped with the simulation time of a lockstep run."""
    if reference.base != "simulation" or "/misses" in reference.tables or _in_real_time(reference):
        return False
    if log.base == "simulation":
        return not _in_real_time(log)
    return log.format == "dataflash" and first_text(log, LOCKSTEP) is not None


def _in_real_time(log: Log) -> bool:
    return any(relation.readings.key == "clocks.PS1" for relation in clock_relations(log))


def ways(log: Log) -> list[_Way]:
    """Clocks to which the log's own time can be converted, its own first."""
    own = {"boot": BOOT if first_text(log, OURS) is None else AGENT, "simulation": SIMULATION, "utc": UTC}.get(log.base)
    found: list[_Way] = []
    if own is not None and log.format != "tlog":
        found.append(_Way(own, _as_is, _as_is, (), 0.0, "clock records", ""))
    elif own is not None:  # the ground station's UTC is the clock of its computer
        found.append(_Way(UTC, _as_is, _as_is, (), 0.5, "UTC", "the ground station's UTC"))
    fitted = clock_relations(log)
    host = next((relation for relation in fitted if relation.readings.key == "clocks.PS1"), None)
    boots = {relation.readings.first: relation for relation in fitted if relation.readings.key.startswith("boot.")}
    for relation in fitted:
        way = _told(relation, boots) if relation.readings.key.startswith("system_time.") else _way(relation, host)
        if way is not None:
            found.append(way)
    return found


def _told(told: ClockRelation, boots: Mapping[str, ClockRelation]) -> _Way | None:
    """UTC as the autopilot reports it, converted through its own clock."""
    boot = boots.get(told.readings.first)
    if boot is None:
        return None
    return _Way(
        UTC,
        lambda stamp_ns: told.to_second(boot.to_first(stamp_ns)),
        lambda utc_ns: boot.to_second(told.to_first(utc_ns)),
        _breaks(boot, own_is_first=False),
        float(np.hypot(_error_s(told), _error_s(boot))),
        "UTC",
        f"{told.readings.message} ({told.readings.fields})",
    )


def _as_is(stamp_ns: Stamps) -> Stamps:
    return stamp_ns


def _way(relation: ClockRelation, host: ClockRelation | None) -> _Way | None:
    readings = relation.readings
    key = readings.key
    error_s = _error_s(relation)
    by = f"{readings.message} ({readings.fields})"
    if key == "clocks.PS1":
        return None
    if key.startswith("clocks."):
        node = key.removeprefix("clocks.")
        clock = f"node {node}"
        if readings.first == HOST and host is not None:
            # Breaks of a node's clock, given on the host's clock, in simulation time.
            at_host = np.array([step.first_ns for step in relation.steps], dtype=np.int64)
            return _Way(
                clock,
                lambda stamp_ns: relation.to_second(host.to_second(stamp_ns)),
                lambda node_ns: host.to_first(relation.to_first(node_ns)),
                _breaks(host, own_is_first=True) + tuple(host.to_first(at_host).tolist()),
                float(np.hypot(error_s, _error_s(host))),
                "clock records",
                by,
            )
        if readings.first == SIMULATION:
            return _Way(
                clock, relation.to_second, relation.to_first, _breaks(relation, True), error_s, "clock records", by
            )
        return None
    if key.startswith("boot."):
        return _Way(
            readings.first, relation.to_first, relation.to_second, _breaks(relation, False), error_s, "telemetry", by
        )
    if key.startswith("gps"):
        return _Way(UTC, relation.to_first, relation.to_second, _breaks(relation, False), error_s, "UTC", by)
    if key == "rtc":
        return _Way(UTC, relation.to_second, relation.to_first, _breaks(relation, True), error_s, "UTC", by)
    if key.startswith("samples."):
        return _Way(
            SIMULATION, relation.to_first, relation.to_second, _breaks(relation, False), error_s, "clock records", by
        )
    return None


def _breaks(relation: ClockRelation, own_is_first: bool) -> tuple[int, ...]:
    if not own_is_first:
        return relation.second_bounds_ns
    return tuple(int(relation.readings.first_ns[step.index]) for step in relation.steps)


def _error_s(relation: ClockRelation) -> float:
    """Two standard deviations of the lines, plus the uncertainty from delays.

    For an exchange, this is half of the shortest round trip. Otherwise it is the scatter of the delays, because their
    minimum is unknown.
    """
    readings = relation.readings
    line_s = 2.0 * max(piece.offset_error_s for piece in relation.pieces)
    if readings.floor_ns is not None:
        open_s = 0.5e-9 * float(np.min(readings.offset_ns - readings.floor_ns))
    elif readings.late:
        open_s = 2.0 * max(piece.residual_s for piece in relation.pieces)
    else:
        open_s = 0.0
    bends_s = max((piece.residual_s for piece in relation.pieces), default=0.0) if not readings.late else 0.0
    return line_s + open_s + bends_s + readings.resolution_s + readings.slack_s


CHECK_WITHIN_S = 5.0
CHECK_MARGIN_S = 0.2  # one log may lag in the same motion: signals have different filters, and telemetry waits
CONTRADICTED = 0.25


def align_logs(logs: Sequence[Log]) -> list[LogPlacement]:
    """Return one placement per log, in the same order.

    Never raises: the placement of a log that cannot be aligned gives the reason.
    """
    if not logs:
        return []
    reference = reference_of(logs)
    return [
        LogPlacement(log, 0, 0.0, None, "reference", True, "its time is that of the report")
        if log is reference
        else _placed(reference, log)
        for log in logs
    ]


def reference_of(logs: Sequence[Log]) -> Log:
    """The host's recording of a run, or another recording of it, or the first log."""
    ours = [log for log in logs if log.base == "simulation" and "/clocks" in log.tables]
    runs = ours or [log for log in logs if log.base == "simulation"]
    return (runs or list(logs))[0]


@dataclass(frozen=True, slots=True)
class _Check:
    """Check of a placement by a shared signal."""

    signal: str
    away_s: float | None
    """Shift that the signal would apply; None if undecided."""
    contradicts: bool = False


def _placed(reference: Log, log: Log) -> LogPlacement:
    span_ns = log.span_ns
    if span_ns is None or reference.span_ns is None:
        return _not_aligned(log, "one of the logs holds no stamped rows")
    why: list[str] = []
    unchecked: LogPlacement | None = None
    for chain in sorted(chains(reference, log), key=lambda chain: chain.error_s):
        found = placement_from(
            log,
            span_ns,
            chain.to_reference,
            chain.breaks_ns,
            error_s=chain.error_s,
            method=chain.method,
            sentence=chain.sentence,
        )
        if _apart(reference, found):
            unchecked = unchecked or _with_sentence(found, f"{found.sentence}; they do not overlap: not of one run")
            continue
        check = _check(reference, log, found)
        if check.contradicts:
            why.append(f"{chain.method} would put it where {check.signal} of both does not agree")
            continue
        if check.away_s is None:
            unchecked = unchecked or found
            continue
        seconds = abs(check.away_s)
        length = (
            f"{seconds * 1e6:.0f} us"
            if seconds < 1e-3
            else (f"{seconds * 1e3:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s")
        )
        return _with_sentence(found, f"{found.sentence}; {check.signal} of both agrees to {length}")
    if unchecked is not None and unchecked.method == "UTC" and _apart(reference, unchecked):
        return unchecked
    correlated = align_by_signal(reference, log)
    if correlated is not None and correlated.aligned:
        doubt = "; its clock records do not fit there: perhaps of another run of the same mission" if why else ""
        return _with_sentence(correlated, correlated.sentence + doubt)
    if unchecked is not None:
        if _apart(reference, unchecked):
            return unchecked
        return _with_sentence(unchecked, f"{unchecked.sentence}; no signal that both hold could check it")
    why.append(correlated.sentence if correlated is not None else "they share no signal that could be compared")
    return _not_aligned(log, "; ".join(why))


def _apart(reference: Log, placement: LogPlacement) -> bool:
    """Whether one log ends before the other begins."""
    assert reference.span_ns is not None
    assert placement.log.span_ns is not None
    begin, end = placement.on_reference(np.array(placement.log.span_ns, dtype=np.int64)).tolist()
    return bool(end < reference.span_ns[0] or begin > reference.span_ns[1])


def _check(reference: Log, log: Log, placement: LogPlacement) -> _Check:
    """Check by the first shared signal with a clear match near the placement."""
    tried = ""
    for name, one, other in shared_signals(reference, log):
        moved = moved_to_reference(other, placement)
        found = match_signals(one, moved, 0, CHECK_WITHIN_S)
        if found is None:
            continue
        away_s = found.shift_ns * 1e-9
        if found.peak > max(0.4, found.chance) and abs(away_s) < placement_margin_s(placement):
            return _Check(name, away_s)
        wide = match_signals(one, moved)
        if wide is not None and wide.sure and abs(wide.shift_ns) * 1e-9 > placement_margin_s(placement):
            return _Check(name, None, contradicts=True)
        if exceeds_noise(one) and exceeds_noise(other) and found.peak < CONTRADICTED:
            tried = tried or name
    return _Check(tried, None, contradicts=bool(tried))


def placement_margin_s(placement: LogPlacement) -> float:
    """Allowed disagreement of a signal: the error of the placement, and the delay of filters."""
    return CHECK_MARGIN_S + 2.0 * (placement.error_s or 0.0)


def align_by_signal(reference: Log, log: Log) -> LogPlacement | None:
    """Align by the signal with the clearest peak. None if no signal can be compared."""
    found: list[tuple[float, str, SignalMatch]] = []
    doubtful: list[tuple[float, str, SignalMatch]] = []
    for name, one, other in shared_signals(reference, log):
        match = match_signals(one, other)
        if match is None:
            continue
        (found if match.sure else doubtful).append((match.peak, name, match))
        if match.sure and match.peak > 0.9:
            break
    if found:
        _, name, match = max(found, key=lambda each: each[0])
        return _correlated(log, name, match)
    if doubtful:
        peak, name, match = max(doubtful, key=lambda each: each[0])
        if match.rival >= 0.85 * match.peak:
            return _not_aligned(log, f"{name} fits in more than one place ({peak:.2f} and {match.rival:.2f})")
        return _not_aligned(
            log, f"{name} fits nowhere better ({peak:.2f}) than chance would have it ({match.chance:.2f})"
        )
    return None


def _correlated(log: Log, name: str, match: SignalMatch) -> LogPlacement:
    assert log.span_ns is not None
    about_ns, offset_ns, drift, error_s = offset_line(match, log.span_ns)

    def to_reference(stamp_ns: Stamps) -> Stamps:
        return stamp_ns + offset_ns + whole_ns(drift * (stamp_ns - about_ns).astype(np.float64))

    parts = f" and in each of {len(match.parts)} parts of it" if len(match.parts) > 1 else ""
    return placement_from(
        log,
        log.span_ns,
        to_reference,
        (),
        error_s=error_s,
        method="correlation",
        sentence=f"by {name} in both, which correlates {match.peak:.2f} there{parts}, {match.rival:.2f} elsewhere",
    )


def _with_sentence(placement: LogPlacement, sentence: str) -> LogPlacement:
    return replace(placement, sentence=sentence)


def _not_aligned(log: Log, why: str) -> LogPlacement:
    return LogPlacement(log, 0, 0.0, None, "not aligned", False, f"not aligned: {why}")
