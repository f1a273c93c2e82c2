"""Arming: instants, methods, and refusals before."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import FAILSAFE_ARMING_METHODS, arming_method_name, checks_left_out
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Section
from xitl_cli.logs.model.table import Table
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.states import autopilot_messages

_REFUSED = re.compile(r"^\s*(PreArm|Arm)\s*:\s*(.+?)\s*$", re.I)
_PREARM_CHECK = 1 << 28  # MAV_SYS_STATUS_PREARM_CHECK
_AGREES_NS = 1_000_000_000
_SHUTDOWN_NS = 5_000_000_000
_MOST_FINDINGS = 10


@dataclass(frozen=True, slots=True)
class ArmSwitch:
    """One row of ARM. method and forced are None if the version does not log them."""

    at_ns: int
    armed: bool
    method: int | None
    forced: bool | None
    checks: int | None
    """Bits of the enabled checks."""


@dataclass(frozen=True, slots=True)
class ArmRefusal:
    """A reason that was given `count` times."""

    reason: str
    attempt: bool
    """Given at an attempt to arm, not before one."""
    count: int
    first_ns: int
    last_ns: int
    source: str


def analyse(log: Log) -> Section | None:
    if log.span_ns is None or (log.of_topics and not _tells(log)):
        return None
    clock = LogClock(log)
    spans, rows, refusals = signals.armed(log), arm_switches(log), arm_refusals(log)
    grids = [_intervals(spans, rows, clock)] if spans else []
    if refusals:
        grids.append(
            Grid.limited(
                "refusals",
                "Reasons not to arm",
                ("reason", "when", "times", "first (s)", "last (s)"),
                [
                    (
                        each.reason,
                        "at an attempt" if each.attempt else "before",
                        each.count,
                        clock.second(each.first_ns),
                        clock.second(each.last_ns),
                    )
                    for each in refusals
                ],
            )
        )
    findings = [*_never(log, spans, refusals, clock), *_how(rows, spans, clock)]
    lacks = () if _tells(log) else ("The log does not show whether it was armed: it has no ARM, EV, MSG or heartbeat.",)
    facts = tuple(_facts(log, spans, refusals, clock))
    return Section("arming", "Arming", facts, tuple(findings), tuple(grids), lacks=lacks)


def arm_switches(log: Log) -> list[ArmSwitch]:
    """Rows of ARM in order of time."""
    table = log.tables.get("ARM")
    if table is None or "ArmState" not in table.columns:
        return []
    states = np.asarray(table.values("ArmState", raw=True))
    found = [
        ArmSwitch(
            at_ns,
            bool(state),
            _whole(table, "Method", row),
            None if (forced := _whole(table, "Forced", row)) is None else bool(forced),
            _whole(table, "ArmChecks", row),
        )
        for row, (at_ns, state) in enumerate(zip(table.stamp_ns.tolist(), states.tolist(), strict=True))
    ]
    return sorted(found, key=lambda each: each.at_ns)


def disarming_method(log: Log, at_ns: int) -> int | None:
    """Method by which the vehicle was disarmed within a second of `at_ns`; None if it is not logged."""
    row = _switch_near(arm_switches(log), at_ns, armed=False)
    return None if row is None else row.method


def shut_down(log: Log, from_ns: int, until_ns: int) -> bool:
    """Whether a span lasts from disarming, or a later time, to the end of the log, seconds later: sensors are then
    switched off.

    A span that begins at a failsafe is not of this kind, because a sensor that stopped may have caused the failsafe.
    """
    if log.span_ns is None:
        return False
    end_ns = log.span_ns[1]
    if end_ns - from_ns > _SHUTDOWN_NS or end_ns - until_ns > _AGREES_NS:
        return False
    armed = signals.armed(log)
    if armed and max(span.until_ns for span in armed) < from_ns - _AGREES_NS:
        return True
    ends_ns = [span.until_ns for span in armed if span.until_ns < end_ns]
    return any(
        abs(at_ns - from_ns) <= _AGREES_NS and disarming_method(log, at_ns) not in FAILSAFE_ARMING_METHODS
        for at_ns in ends_ns
    )


def _switch_near(rows: list[ArmSwitch], at_ns: int, armed: bool) -> ArmSwitch | None:
    near = [row for row in rows if row.armed == armed and abs(row.at_ns - at_ns) <= _AGREES_NS]
    return min(near, key=lambda row: abs(row.at_ns - at_ns), default=None)


def arm_refusals(log: Log) -> list[ArmRefusal]:
    """Reasons not to arm, in the order of their first occurrence."""
    found: dict[tuple[str, bool], ArmRefusal] = {}
    for text in signals.texts(log):
        match = _REFUSED.match(text.text)
        if match is None:
            continue
        key = (match.group(2), match.group(1).lower() == "arm")
        before = found.get(key)
        first_ns, count = (text.at_ns, 0) if before is None else (before.first_ns, before.count)
        found[key] = ArmRefusal(*key, count + 1, first_ns, text.at_ns, text.source)
    return list(found.values())


def _whole(table: Table, column: str, row: int) -> int | None:
    return int(table.values(column, slice(row, row + 1), raw=True)[0]) if column in table.columns else None


def _tells(log: Log) -> bool:
    names = ("ARM", "EV", "MSG", "HEARTBEAT", "/link/agent/rx:HEARTBEAT", "/actuators")
    return any(name in log.tables for name in names) or bool(signals.armed(log))


def _facts(log: Log, spans: list[signals.StateSpan], refusals: list[ArmRefusal], clock: LogClock) -> Iterator[Fact]:
    yield Fact("times_armed", "Times armed", len(spans))
    yield Fact("armed_s", "Armed", rounded(sum(span.until_ns - span.from_ns for span in spans) * 1e-9, 1), "s")
    yield Fact("refusals", "Reasons not to arm", len(refusals))
    if not spans:
        return
    first_ns = spans[0].from_ns
    yield Fact("first_armed_s", "First armed at", clock.second(first_ns), "s")
    # First instant at which the pre-arm checks passed, from telemetry.
    table = autopilot_messages(log, "SYS_STATUS")
    names = ("onboard_control_sensors_present", "onboard_control_sensors_health")
    if table is not None and set(names) <= set(table.columns):
        present, health = (np.asarray(table.values(name, raw=True)).astype(np.int64) for name in names)
        passed = np.flatnonzero(present & health & _PREARM_CHECK)
        if len(passed) and (ready_ns := int(table.stamp_ns[passed[0]])) <= first_ns:
            yield Fact("ready_to_arm_s", "From checks passed to armed", rounded((first_ns - ready_ns) * 1e-9, 1), "s")
    # First instant at which it was reported as set. A row at the very start of a log repeats an earlier one.
    set_ns = [text.at_ns for text in signals.texts(log) if "origin set" in text.text.lower()]
    table = log.tables.get("ORGN")
    if table is not None and "Type" in table.columns:
        rows = table.stamp_ns[np.asarray(table.values("Type", raw=True)) == 0]
        set_ns += [int(at_ns) for at_ns in rows if at_ns > clock.start_ns + _AGREES_NS]
    if (origin_ns := min(set_ns, default=None)) is not None and origin_ns <= first_ns:
        waited_s = rounded((first_ns - origin_ns) * 1e-9, 1)
        yield Fact("origin_to_arm_s", "From estimator origin to armed", waited_s, "s")


def _intervals(spans: list[signals.StateSpan], rows: list[ArmSwitch], clock: LogClock) -> Grid:
    def by(at_ns: int, armed: bool) -> str:
        row = _switch_near(rows, at_ns, armed)
        if row is None:
            return "armed when the log ends" if not armed and at_ns >= clock.end_ns else ""
        if row.method is None:
            return ""
        return arming_method_name(row.method) + (", forced" if row.forced else "")

    return Grid.limited(
        "armed",
        "Armed",
        ("from (s)", "until (s)", "duration (s)", "armed by", "disarmed by"),
        [
            (
                clock.second(span.from_ns),
                clock.second(span.until_ns),
                rounded((span.until_ns - span.from_ns) * 1e-9, 1),
                by(span.from_ns, True),
                by(span.until_ns, False),
            )
            for span in spans
        ],
    )


def _never(log: Log, spans: list[signals.StateSpan], refusals: list[ArmRefusal], clock: LogClock) -> Iterator[Finding]:
    attempts = [refusal for refusal in refusals if refusal.attempt]
    if not spans and not _tells(log):
        return
    if not spans and refusals:
        worst = max(attempts or refusals, key=lambda refusal: refusal.last_ns)
        yield Finding.warning(
            "arming.refused",
            f'It was never armed; the last reason given was "{worst.reason}" ({worst.count} times, until '
            f"{clock.text(worst.last_ns)})",
            tuple(map(_evidence, refusals[:_MOST_FINDINGS])),
            "Clear each reason in the table. The last one still applied.",
        )
        return
    if not spans:
        lasted = (clock.end_ns - clock.start_ns) * 1e-9
        sentence = f"It was not armed in the {lasted:.0f} s of this log, and no attempt is logged"
        yield Finding.notice("arming.never", sentence, (), "Analyse the log of a run in which it was armed.")
        return
    if not attempts:
        return
    total = sum(refusal.count for refusal in attempts)
    yield Finding.notice(
        "arming.attempts_refused",
        f'Arming was refused {total} times, first for "{attempts[0].reason}"',
        tuple(map(_evidence, attempts[:_MOST_FINDINGS])),
        "Wait for the pre-arm checks before arming.",
    )


def _evidence(refusal: ArmRefusal) -> Evidence:
    message, _, field = refusal.source.partition(".")
    return Evidence(message, field, refusal.first_ns, refusal.last_ns, f"{refusal.reason} ({refusal.count})")


def _how(rows: list[ArmSwitch], spans: list[signals.StateSpan], clock: LogClock) -> Iterator[Finding]:
    unchecked = [row for row in rows if row.armed and row.checks == 0]
    partly = [row for row in rows if row.armed and row.checks and checks_left_out(row.checks)]
    if unchecked:
        yield Finding.notice(
            "arming.checks_off",
            f"It was armed at {clock.text(unchecked[0].at_ns)} with all arming checks switched off",
            tuple(Evidence("ARM", "ArmChecks", row.at_ns, value="0") for row in unchecked[:_MOST_FINDINGS]),
            "Switch the checks on (ARMING_CHECK 1, or ARMING_SKIPCHK 0 since 4.7) before trusting it on water.",
        )
    elif partly:
        left_out = checks_left_out(partly[0].checks or 0)
        yield Finding.notice(
            "arming.checks_partly_off",
            f"It was armed at {clock.text(partly[0].at_ns)} without the checks of {', '.join(left_out[:6])}"
            + (f" and {len(left_out) - 6} more" if len(left_out) > 6 else ""),
            tuple(Evidence("ARM", "ArmChecks", row.at_ns, value=str(row.checks)) for row in partly[:_MOST_FINDINGS]),
            "Check that each is left out on purpose (ARMING_CHECK, ARMING_SKIPCHK).",
        )
    for row in [row for row in rows if row.armed and row.forced][:_MOST_FINDINGS]:
        yield Finding.warning(
            "arming.forced",
            f"It was armed by force at {clock.text(row.at_ns)}, whatever the checks reported",
            (Evidence("ARM", "Forced", row.at_ns, value="1"),),
            "Arm without force. The table lists the reasons of the refusals.",
        )
    for row in [row for row in rows if not row.armed and row.method in FAILSAFE_ARMING_METHODS][:_MOST_FINDINGS]:
        yield Finding.critical(
            "arming.disarmed_by_failsafe",
            f"At {clock.text(row.at_ns)} the autopilot disarmed by itself: {arming_method_name(row.method or 0)}",
            (Evidence("ARM", "Method", row.at_ns, value=str(row.method)),),
            "The main loop stopped: see the scheduler section."
            if row.method == 6
            else "Look at the events just before.",
        )
