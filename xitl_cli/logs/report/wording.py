"""Values, health, names and instants of a report as text."""

from __future__ import annotations

import math
from collections.abc import Sequence

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.log import LogHealth
from xitl_cli.logs.model.sections import Evidence, Fact, Grid, Severity, Value
from xitl_cli.logs.model.text import clock_text, plural

FORMAT_NAMES = {
    "dataflash": "DataFlash",
    "mcap": "MCAP",
    "tlog": "telemetry log",
    "ulog": "ULog",
    "rosbag1": "ROS 1 bag",
    "rosbag2": "ROS 2 bag",
}
SEVERITY_NAMES = {
    Severity.CRITICAL: "critical",
    Severity.WARNING: "warning",
    Severity.NOTICE: "notice",
    Severity.OK: "fine",
}
UNKNOWN = "–"


def value_text(value: Value, name: str = "") -> str:
    """Value as text: – if unknown, whole numbers in full, others to six digits, positions on the Earth to a
    centimetre."""
    if value is None:
        return UNKNOWN
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            return UNKNOWN
        if any(angle in name.casefold() for angle in ("latitude", "longitude")):
            return f"{value:.7f}"
        value += 0.0  # removes the sign of -0
        return f"{value:.6g}" if abs(value) < 1e6 or abs(value) >= 1e15 else f"{value:.0f}"
    return " ".join(str(value).split())


def is_numeric(grid: Grid, index: int) -> bool:
    """Whether all known values of a column are numbers."""
    values = [row[index] for row in grid.rows if index < len(row) and row[index] is not None]
    return bool(values) and all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def sentence_text(text: str) -> str:
    """The text with an initial capital, unless it begins with a name."""
    first = text.split(" ", 1)[0]
    return text[:1].upper() + text[1:] if first.isalpha() and first.islower() else text


def vehicle_line(facts: Sequence[Fact]) -> str:
    """Known vehicle and firmware; "" otherwise."""
    known = {fact.key: value_text(fact.value) for fact in facts if fact.value}
    vehicle = known.get("vehicle_type") or known.get("vehicle")
    version = known.get("firmware_version")
    firmware = known.get("firmware") or (version and f"firmware {version}")
    return ", ".join(part for part in (vehicle, firmware) if part)


def damage_sentences(health: LogHealth) -> tuple[str, ...]:
    """Sentences for every count that is not 0."""
    unclosed = (UNCLOSED,) if health.unclosed else ()
    return (*unclosed, *loss_sentences(health))


UNCLOSED = "not closed by its writer, so the end may be missing; `xitl logs repair` writes a complete copy"


def loss_sentences(health: LogHealth) -> tuple[str, ...]:
    """Sentences on unreadable data."""
    where = f", the first at byte {health.damage[0].place} ({health.damage[0].why})" if health.damage else ""
    counts = (
        (health.damaged, f"damaged in {plural(health.damaged, 'place')}{where}"),
        (health.lost_bytes, f"{plural(health.lost_bytes, 'byte')} could not be read"),
        (health.suspect, f"{plural(health.suspect, 'record')} kept although the data after it is damaged"),
        (health.truncated_bytes, f"ends within a record, after {plural(health.truncated_bytes, 'byte')} of it"),
        (health.back_in_time, f"{plural(health.back_in_time, 'row')} with an earlier time stamp than the row before"),
        (
            health.replaced_stamps,
            f"{plural(health.replaced_stamps, 'row')} with an impossible time, replaced by that of the row before",
        ),
        (health.redefined, f"{plural(health.redefined, 'type')} described twice, with differences"),
    )
    undecoded = (
        f"{name}: {plural(rows, 'row')} not decoded ({reason})" for name, (rows, reason) in health.undecoded.items()
    )
    return (*health.gaps, *(sentence for count, sentence in counts if count), *undecoded)


def severity_counts(severities: list[Severity]) -> str:
    """Counts as text: "2 warnings, 1 notice"; "nothing to look into" without findings."""
    parts = [
        plural(many, SEVERITY_NAMES[severity])
        for severity in (Severity.CRITICAL, Severity.WARNING, Severity.NOTICE)
        if (many := severities.count(severity))
    ]
    return ", ".join(parts).replace("criticals", "critical") or "nothing to look into"


def verdict(worst: list[Severity], findings: int) -> str:
    """Counts of causes, each with the highest severity in its group: "1 critical, 2 notices (7 findings follow from
    these)"."""
    follow = findings - len(worst)
    more = "" if not follow else f" ({plural(follow, 'finding')} {'follows' if follow == 1 else 'follow'} from these)"
    return severity_counts(worst) + more


def evidence_text(evidence: Evidence, time_line: TimeLine) -> str:
    """Evidence as text: PM.MaxT at 0:43.2–0:53.2: 23 ms."""
    where = evidence.message if evidence.field is None else f"{evidence.message}.{evidence.field}"
    text = where + (f" {when}" if (when := when_text(evidence, time_line)) else "")
    return text if evidence.value is None else f"{text}: {evidence.value}"


def when_text(evidence: Evidence, time_line: TimeLine) -> str:
    """Time of evidence: at 0:43.2, or from 0:43.2 to 0:53.2; "" for evidence without an instant."""
    if evidence.at_ns is None:
        return ""
    at = clock_text(time_line.second(evidence.at_ns))
    if evidence.until_ns is None or evidence.until_ns <= evidence.at_ns:
        return f"at {at}"
    until = clock_text(time_line.second(evidence.until_ns))
    return f"at {at}" if until == at else f"from {at} to {until}"
