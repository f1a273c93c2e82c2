"""Seconds on a report's time line as people write them, and back."""

from __future__ import annotations

import math

from xitl_cli.errors import UserError
from xitl_cli.logs.report.model import TimeLine
from xitl_cli.logs.sections import Evidence


def clock_text(at_s: float, decimals: int = 1) -> str:
    """0:43.2, 12:03.4, 1:02:03.4, -0:01.0."""
    sign = "-" if at_s < 0 else ""
    units = 10**decimals
    ticks = round(abs(at_s) * units)
    whole, part = divmod(ticks, units)
    hours, minutes, seconds = whole // 3600, whole // 60 % 60, whole % 60
    clock = f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"
    return f"{sign if ticks else ''}{clock}" + (f".{part:0{decimals}}" if decimals else "")


def duration_text(length_s: float) -> str:
    """0.4 s, 43.2 s, 6:12 min, 1:02:03 h."""
    if length_s < 60.0:
        return f"{length_s:.1f} s"
    return f"{clock_text(length_s, 0)} {'h' if round(length_s) >= 3600 else 'min'}"


def seconds_of(text: str) -> float:
    """Of 90, 90.5, 1:30.5 or 1:02:03. Raises UserError."""
    parts = text.strip().lstrip("-").split(":")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 3 or not all(math.isfinite(number) and number >= 0 for number in numbers):
        raise UserError(f"{text!r} is no time; write seconds (90.5), minutes (1:30.5) or hours (1:02:03)")
    total = 0.0
    for number in numbers:
        total = total * 60.0 + number
    return -total if text.strip().startswith("-") else total


def evidence_text(evidence: Evidence, time_line: TimeLine) -> str:
    """PM.MaxT at 0:43.2–0:53.2: 23 ms."""
    where = evidence.message if evidence.field is None else f"{evidence.message}.{evidence.field}"
    text = where + (f" {when}" if (when := when_text(evidence, time_line)) else "")
    return text if evidence.value is None else f"{text}: {evidence.value}"


def when_text(evidence: Evidence, time_line: TimeLine) -> str:
    """At 0:43.2, or from 0:43.2 to 0:53.2; "" when the evidence is of no instant."""
    if evidence.at_ns is None:
        return ""
    at = clock_text(time_line.second(evidence.at_ns))
    if evidence.until_ns is None or evidence.until_ns <= evidence.at_ns:
        return f"at {at}"
    until = clock_text(time_line.second(evidence.until_ns))
    return f"at {at}" if until == at else f"from {at} to {until}"
