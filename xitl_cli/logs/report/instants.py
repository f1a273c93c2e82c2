"""When something was seen, on a report's time line."""

from __future__ import annotations

from xitl_cli.logs.sections import Evidence
from xitl_cli.logs.text import clock_text
from xitl_cli.logs.timeline.line import TimeLine


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
