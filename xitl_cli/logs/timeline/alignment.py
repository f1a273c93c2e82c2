"""Several logs of one run on one time line.

By clock records where both logs hold some, checked by a signal that both hold; by correlating such a signal where they
do not. The reference is the host's recording, else the first log.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from xitl_cli.logs.log import Log
from xitl_cli.logs.timeline import shared
from xitl_cli.logs.timeline.chains import Chain, chains
from xitl_cli.logs.timeline.correlation import Match
from xitl_cli.logs.timeline.placement import Instants, Placement, Stretch, place

CHECK_WITHIN_S = 5.0
CHECK_MARGIN_S = 0.2  # the same motion comes later in one: signals are of different filters, and telemetry waits
CONTRADICTED = 0.25

__all__ = ["Placement", "Stretch", "align", "by_signal"]


def align(logs: Sequence[Log]) -> list[Placement]:
    """One placement a log, in the same order. A log that cannot be placed says why; nothing is raised."""
    if not logs:
        return []
    reference = reference_of(logs)
    return [
        Placement(log, 0, 0.0, None, "reference", True, "its time is that of the report")
        if log is reference
        else _placed(reference, log)
        for log in logs
    ]


def reference_of(logs: Sequence[Log]) -> Log:
    """The host's recording of a run, else another recording of it, else the first."""
    ours = [log for log in logs if log.base == "simulation" and "/clocks" in log.tables]
    runs = ours or [log for log in logs if log.base == "simulation"]
    return (runs or list(logs))[0]


@dataclass(frozen=True, slots=True)
class _Check:
    """What a shared signal says to a placement. away_s: by how much it would shift it, None when it cannot tell."""

    signal: str
    away_s: float | None
    contradicts: bool = False


def _placed(reference: Log, log: Log) -> Placement:
    span_ns = log.span_ns
    if span_ns is None or reference.span_ns is None:
        return _nowhere(log, "one of the logs holds no stamped rows")
    why: list[str] = []
    unchecked: Placement | None = None
    for chain in _best_first(chains(reference, log)):
        found = place(
            log,
            span_ns,
            chain.to_reference,
            chain.breaks_ns,
            error_s=chain.error_s,
            method=chain.method,
            sentence=chain.sentence,
        )
        if _apart(reference, found):
            unchecked = unchecked or _said(found, f"{found.sentence}; they do not overlap: not of one run")
            continue
        check = _check(reference, log, found)
        if check.contradicts:
            why.append(f"{chain.method} would put it where {check.signal} of both does not agree")
            continue
        if check.away_s is None:
            unchecked = unchecked or found
            continue
        return _said(found, f"{found.sentence}; {check.signal} of both agrees to {_length(abs(check.away_s))}")
    if unchecked is not None and unchecked.method == "UTC" and _apart(reference, unchecked):
        return unchecked
    correlated = by_signal(reference, log)
    if correlated is not None and correlated.aligned:
        doubt = "; its clock records do not fit there: perhaps of another run of the same mission" if why else ""
        return _said(correlated, correlated.sentence + doubt)
    if unchecked is not None:
        if _apart(reference, unchecked):
            return unchecked
        return _said(unchecked, f"{unchecked.sentence}; no signal that both hold could check it")
    why.append(correlated.sentence if correlated is not None else "they share no signal that could be compared")
    return _nowhere(log, "; ".join(why))


def _apart(reference: Log, placement: Placement) -> bool:
    """Whether one ends before the other begins."""
    assert reference.span_ns is not None
    assert placement.log.span_ns is not None
    begin, end = placement.on_reference(np.array(placement.log.span_ns, dtype=np.int64)).tolist()
    return bool(end < reference.span_ns[0] or begin > reference.span_ns[1])


def _best_first(found: Iterator[Chain]) -> list[Chain]:
    return sorted(found, key=lambda chain: chain.error_s)


def _check(reference: Log, log: Log, placement: Placement) -> _Check:
    """By the first shared signal that tells anything near the placement."""
    tried = ""
    for name, one, other in shared.signals(reference, log):
        moved = shared.moved(other, placement)
        found = shared.match(one, moved, 0, CHECK_WITHIN_S)
        if found is None:
            continue
        away_s = found.shift_ns * 1e-9
        if found.peak > max(0.4, found.chance) and abs(away_s) < placement_margin_s(placement):
            return _Check(name, away_s)
        wide = shared.match(one, moved)
        if wide is not None and wide.sure and abs(wide.shift_ns) * 1e-9 > placement_margin_s(placement):
            return _Check(name, None, contradicts=True)
        if shared.tells(one) and shared.tells(other) and found.peak < CONTRADICTED:
            tried = tried or name
    return _Check(tried, None, contradicts=bool(tried))


def placement_margin_s(placement: Placement) -> float:
    """How far a signal may disagree: the error, and what filters delay."""
    return CHECK_MARGIN_S + 2.0 * (placement.error_s or 0.0)


def by_signal(reference: Log, log: Log) -> Placement | None:
    """By the signal with the clearest peak; None when there is none to compare."""
    found: list[tuple[float, str, Match]] = []
    doubtful: list[tuple[float, str, Match]] = []
    for name, one, other in shared.signals(reference, log):
        match = shared.match(one, other)
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
            return _nowhere(log, f"{name} fits in more than one place ({peak:.2f} and {match.rival:.2f})")
        return _nowhere(log, f"{name} fits nowhere better ({peak:.2f}) than chance would have it ({match.chance:.2f})")
    return None


def _correlated(log: Log, name: str, match: Match) -> Placement:
    assert log.span_ns is not None
    about_ns, offset_ns, drift, error_s = shared.line_of(match, log.span_ns)

    def to_reference(stamp_ns: Instants) -> Instants:
        return stamp_ns + offset_ns + np.round(drift * (stamp_ns - about_ns).astype(np.float64)).astype(np.int64)

    parts = f" and in each of {len(match.parts)} parts of it" if len(match.parts) > 1 else ""
    return place(
        log,
        log.span_ns,
        to_reference,
        (),
        error_s=error_s,
        method="correlation",
        sentence=f"by {name} in both, which correlates {match.peak:.2f} there{parts}, {match.rival:.2f} elsewhere",
    )


def _said(placement: Placement, sentence: str) -> Placement:
    return replace(placement, sentence=sentence)


def _nowhere(log: Log, why: str) -> Placement:
    return Placement(log, 0, 0.0, None, "not aligned", False, f"not aligned: {why}")


def _length(seconds: float) -> str:
    if seconds < 1e-3:
        return f"{seconds * 1e6:.0f} us"
    return f"{seconds * 1e3:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s"
