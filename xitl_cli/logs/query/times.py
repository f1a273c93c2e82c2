"""The seconds in which people speak of a log's rows."""

from __future__ import annotations

import math

from xitl_cli.logs.errors import LogError
from xitl_cli.logs.log import Log

NS_PER_S = 1_000_000_000
_LONGEST_UPTIME_NS = 40 * 86_400 * NS_PER_S


def zero_ns(log: Log) -> int:
    """The stamp from which seconds count: the log's own zero, or its first row where that zero is years away."""
    if log.span_ns is None:
        return 0
    first = log.span_ns[0]
    return first if log.base in ("utc", "unknown") or not 0 <= first <= _LONGEST_UPTIME_NS else 0


def zero_in_words(log: Log) -> str:
    """What second 0 is, to follow "seconds since"."""
    if log.span_ns is not None and zero_ns(log):
        return "the first row"
    return {"boot": "the autopilot started", "simulation": "the run began"}.get(log.base, "the first row")


def stamps_between(log: Log, from_s: float | None, until_s: float | None) -> tuple[int | None, int | None]:
    """Stamps of a span in seconds. Raises LogError for one that is empty."""
    for option, value in (("--from", from_s), ("--until", until_s)):
        if value is not None and not (math.isfinite(value) and abs(value) < 9e9):
            raise LogError(f"{option} = {value} is no time in a log; give seconds since {zero_in_words(log)}")
    if from_s is not None and until_s is not None and until_s < from_s:
        raise LogError(f"--until = {until_s:g} is before --from = {from_s:g}; swap them")
    zero = zero_ns(log)
    from_ns = None if from_s is None else zero + round(from_s * NS_PER_S)
    until_ns = None if until_s is None else zero + round(until_s * NS_PER_S)
    return from_ns, until_ns
