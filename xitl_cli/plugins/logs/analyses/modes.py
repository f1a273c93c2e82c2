"""Modes: their spans and the reasons of changes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import (
    FAILSAFE_REASONS,
    NAVIGATING,
    error_name,
    is_failsafe_error,
    mode_name,
    reason_name,
)
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Section, Severity
from xitl_cli.logs.model.table import first_of
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.states import error_rows, vehicle_kind

_SAME_CAUSE_NS = 1_000_000_000
_EVENT_NS = 3_000_000_000  # a run records a mode change up to 2 s after the heartbeat that shows it
_MOST_MARKS = 200
_STEPS = {
    3: "Check the receiver and FS_THR_ENABLE, FS_TIMEOUT; disable the failsafe if no RC is fitted.",
    4: "Look at the power section, and at BATT_LOW_VOLT and BATT_CRT_VOLT.",
    5: "Look at the telemetry link (radio section), FS_GCS_ENABLE and FS_GCS_TIMEOUT.",
    6: "Look at the estimator section before this instant: which test ratio was over 1, of which sensor.",
    10: "Compare the track with the fence. FENCE_ACTION decided the reaction.",
    19: "Look at attitude, throttle and speed just before.",
}

_KINDS = {3: ".link", 4: ".battery", 5: ".link", 6: ".position", 7: ".position", 25: ".link", 50: ".position"}
"""Trouble behind a reason, as the end of a finding's key. Rover gives 25 if radio or ground station is lost."""


@dataclass(frozen=True, slots=True)
class ModeSpan:
    """A span in one mode."""

    from_ns: int
    until_ns: int
    number: int | None
    name: str
    reason: int | None
    """Number of ModeReason; None if not logged."""
    cause: str
    """In words; "" if unknown."""
    failsafe: bool
    source: str


def analyse(log: Log) -> Section | None:
    spans = mode_spans(log)
    if not spans:
        if log.of_topics:
            return None
        return Section("modes", "Modes", lacks=("The log has no MODE and no HEARTBEAT, so the modes are unknown.",))
    clock = LogClock(log)
    rows = [
        (
            clock.second(span.from_ns),
            clock.second(span.until_ns),
            rounded((span.until_ns - span.from_ns) * 1e-9),
            span.name,
            span.cause,
        )
        for span in spans
    ]
    in_mode: dict[str, float] = {}
    for span in spans:
        in_mode[span.name] = in_mode.get(span.name, 0.0) + (span.until_ns - span.from_ns) * 1e-9
    facts = (
        Fact("mode_changes", "Mode changes", len(spans) - 1),
        *(
            Fact(f"in_{name.lower().replace(' ', '_')}_s", f"In {name}", rounded(total_s, 1), "s")
            for name, total_s in sorted(in_mode.items(), key=lambda item: -item[1])[:12]
        ),
    )
    table = Grid.limited("modes", "Modes", ("from (s)", "until (s)", "duration (s)", "mode", "why"), rows)
    findings = _failsafes(spans, clock)
    lacks: tuple[str, ...] = ()
    if all(span.reason is None and not span.cause for span in spans):
        lacks = ("Telemetry does not contain the reasons of mode changes. The DataFlash log does.",)
    return Section("modes", "Modes", facts, tuple(findings), (table,), lacks=lacks)


def mode_spans(log: Log) -> list[ModeSpan]:
    """Mode spans in order of time. The same mode logged again is no new span."""
    table = log.tables.get("MODE")
    column = None if table is None else first_of(table, ("ModeNum", "Mode"))
    if table is None or column is None:
        spans = signals.modes(log)
        causes = [_recorded_cause(log, span.from_ns, span.text) for span in spans]
        return [
            ModeSpan(span.from_ns, span.until_ns, None, span.text, None, cause, bool(cause), span.source)
            for span, cause in zip(spans, causes, strict=True)
        ]
    kind = vehicle_kind(log)
    order = np.argsort(table.stamp_ns, kind="stable")
    stamps = table.stamp_ns[order].tolist()
    numbers = np.asarray(table.values(column, raw=True))[order].astype(np.int64).tolist()
    reason_column = first_of(table, ("Rsn", "Reason"))
    reasons = [0] * len(stamps)
    if reason_column is not None:
        reasons = np.asarray(table.values(reason_column, raw=True))[order].astype(np.int64).tolist()
    end_ns = max(stamps[-1], log.span_ns[1] if log.span_ns else 0)
    starts = [row for row in range(len(stamps)) if row == 0 or numbers[row] != numbers[row - 1]]
    logged = []
    for place, row in enumerate(starts):
        until_ns = stamps[starts[place + 1]] if place + 1 < len(starts) else end_ns
        reason = reasons[row]
        cause, failsafe = reason_name(reason), reason in FAILSAFE_REASONS
        if reason == 0 and place and (trouble := _failsafe_at(log, stamps[row])):
            cause, failsafe = trouble, True
        name = mode_name(kind, numbers[row])
        known = None if reason_column is None else reason
        logged.append(ModeSpan(stamps[row], until_ns, numbers[row], name, known, cause, failsafe, f"MODE.{column}"))
    return logged


def _recorded_cause(log: Log, from_ns: int, name: str) -> str:
    """Failsafe that a run recorded for the change to this mode; empty if there is none."""
    table = log.tables.get("/autopilot/events")
    if table is None or not {"event", "mode", "reason"} <= set(table.columns):
        return ""
    columns = (table.values(key).tolist() for key in ("event", "mode", "reason"))
    rows = zip(table.stamp_ns.tolist(), *columns, strict=True)
    near = (
        reason
        for stamp_ns, event, mode, reason in rows
        if event == "mode" and mode == name and abs(stamp_ns - from_ns) <= _EVENT_NS
    )
    return next(near, "")


def _failsafe_at(log: Log, at_ns: int) -> str:
    """Failsafe that was logged as an error with the mode change, for autopilots that give no reason."""
    names = (
        error_name(subsystem, code)
        for error_ns, subsystem, code in error_rows(log)
        if abs(error_ns - at_ns) <= _SAME_CAUSE_NS and code and is_failsafe_error(subsystem)
    )
    return next(names, "").removesuffix(": occurred")


def _failsafes(spans: list[ModeSpan], clock: LogClock) -> Iterator[Finding]:
    for before, span in zip([None, *spans[:-1]], spans, strict=True):
        if not span.failsafe:
            continue
        on = clock.was_armed(span.from_ns)
        interrupted = on and before is not None and before.name in NAVIGATING
        severity = Severity.CRITICAL if interrupted else Severity.WARNING if on else Severity.NOTICE
        left = "" if before is None else f" out of {before.name}"
        state = "armed" if on else "not armed"
        evidence = (
            Evidence("/autopilot/events", "reason", span.from_ns, value=span.cause)
            if span.number is None
            else Evidence("MODE", "Rsn", span.from_ns, value=None if span.reason is None else str(span.reason))
        )
        yield Finding(
            f"modes.failsafe{_KINDS.get(span.reason or 0, '')}",
            severity,
            f"At {clock.text(span.from_ns)} {span.cause} changed the mode to {span.name}{left}, {state}",
            (evidence,),
            _STEPS.get(span.reason or 0, "Look at the events around this time for the cause."),
        )
