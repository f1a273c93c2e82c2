"""Events, errors and texts in one table, and findings on those that are troubles."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model import codes as codes
from xitl_cli.logs.model.codes import SWITCH_POSITIONS, SWITCH_SOURCES, VehicleKind, auxiliary_function_name
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Section, Severity
from xitl_cli.logs.model.table import Table, first_of
from xitl_cli.logs.model.text import length_text
from xitl_cli.logs.signals import LogText
from xitl_cli.logs.signals.states import error_rows, event_rows, vehicle_kind
from xitl_cli.plugins.logs.analyses.modes import mode_spans

_OVER = re.compile(r"\b(cleared|clear|over|off|recovered|resolved|ended|restored|back|healthy)\b", re.I)
_ROWS: tuple[tuple[str, str, Severity], ...] = (
    (r"^crash\b|crash: disarming", "crash", Severity.CRITICAL),
    (r"^WDG:|watchdog reset", "watchdog", Severity.CRITICAL),
    (r"internal errors? 0x|internal error", "internal_error", Severity.CRITICAL),
    (r"controller failed", "controller", Severity.CRITICAL),
    (r"radio failsafe|throttle failsafe|rc failsafe", "radio_failsafe", Severity.WARNING),
    (r"gcs failsafe", "gcs_failsafe", Severity.WARNING),
    (r"ekf failsafe", "ekf_failsafe", Severity.WARNING),
    (r"batt(ery)?\b.*(failsafe|low|critical)", "battery", Severity.WARNING),
    (r"fence breach", "fence", Severity.WARNING),
    (r"failsafe", "failsafe", Severity.WARNING),
    (r"ekf variance", "ekf_variance", Severity.WARNING),
    (r"potential thrust loss|yaw imbalance|vibration compensation on", "flight", Severity.WARNING),
    (r"gps( \d)? glitch|compass error|bad gyro|imu\d? .*fail", "sensor", Severity.WARNING),
    (r"no logging|logging failed|log: .*(slow|no space)|unable to (start|open) log", "logging", Severity.WARNING),
)
_PATTERNS = tuple((re.compile(pattern, re.I), key, severity) for pattern, key, severity in _ROWS)
_PLAIN = re.compile(r"\b(disabled|enabled|ready|config|param|pre-?arm|arm:)\b|^(PreArm|Arm)\s*:", re.I)

_RUN = "run"  # name of its sender in /log
_LOG_ERROR = 4  # level of foxglove.Log


@dataclass(frozen=True, slots=True)
class ReportedTrouble:
    """A trouble reported in texts."""

    key: str
    severity: Severity
    text: LogText
    count: int
    until_ns: int | None
    """Instant at which the autopilot reported its end; None if it never did."""


def reported_troubles(texts: list[LogText]) -> list[ReportedTrouble]:
    """One for each kind of trouble, from its first text to the text that ends it, in order of time."""
    open_ones: dict[str, ReportedTrouble] = {}
    done: list[ReportedTrouble] = []
    for text in texts:
        found = next(((key, severity) for pattern, key, severity in _PATTERNS if pattern.search(text.text)), None)
        if found is None or _PLAIN.search(text.text):
            continue
        key, severity = found
        before = open_ones.get(key)
        if _OVER.search(text.text):
            if before is not None:
                done.append(ReportedTrouble(key, before.severity, before.text, before.count, text.at_ns))
                del open_ones[key]
            continue
        first = text if before is None else before.text
        open_ones[key] = ReportedTrouble(key, severity, first, 1 if before is None else before.count + 1, None)
    return sorted([*done, *open_ones.values()], key=lambda trouble: trouble.text.at_ns)


@dataclass(frozen=True, slots=True)
class ErrorSpan:
    """An error from its first row to its end."""

    subsystem: int
    code: int
    """First code of the span."""
    from_ns: int
    until_ns: int | None
    """Instant at which it was cleared; None if it never was, or if it is an instant."""


def error_spans(rows: list[tuple[int, int, int]]) -> list[ErrorSpan]:
    """Spans of errors. A code 0 ends the error of its subsystem; without such an error it is part of a healthy
    start."""
    open_ones: dict[int, ErrorSpan] = {}
    done: list[ErrorSpan] = []
    for at_ns, subsystem, code in rows:
        if not codes.error_persists(subsystem):
            done.append(ErrorSpan(subsystem, code, at_ns, None))
        elif code == 0:
            before = open_ones.pop(subsystem, None)
            if before is not None:
                done.append(ErrorSpan(subsystem, before.code, before.from_ns, at_ns))
        elif subsystem not in open_ones:
            open_ones[subsystem] = ErrorSpan(subsystem, code, at_ns, None)
    return sorted([*done, *open_ones.values()], key=lambda span: span.from_ns)


_NEAR_NS = 2_000_000_000
_MOST_EVIDENCE = 20
_SOURCES = {"EV", "AUXF", "WDOG", "MON", "PM"}
_LEVELS = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
_STEPS: Mapping[int, str] = MappingProxyType(
    {
        codes.ERR_COMPASS: "Compare the compasses and MAG.Health (sensors section); check wiring and interference.",
        codes.ERR_GPS: "Look at the GNSS section: fix, satellites, HDOP at this time.",
        codes.ERR_BARO: "Look at BARO.H and BARO.Press (sensors section); its altitude is not valid meanwhile.",
        codes.ERR_EKF_CHECK: "Look at test ratios and position in the estimator section at this time.",
        codes.ERR_EKF_FAILSAFE: "Look at the estimator section: position was lost or inconsistent.",
        codes.ERR_CPU: "Look at the scheduler section: the main loop stopped.",
        codes.ERR_CRASH: "Look at attitude, speed and throttle just before.",
        codes.ERR_INTERNAL: "Look up the bits in PM.InE or MON.IErr, and report it with this log.",
        codes.ERR_GCS_FAILSAFE: "Look at the radio section, and FS_GCS_ENABLE.",
        codes.ERR_RC_FAILSAFE: "Check the receiver, FS_THR_ENABLE and FS_TIMEOUT.",
        codes.ERR_BATTERY_FAILSAFE: "Look at the power section, BATT_LOW_VOLT and BATT_CRT_VOLT.",
        codes.ERR_FENCE: "Compare the track with the fence. FENCE_ACTION decided the reaction.",
        codes.ERR_NAVIGATION: "Check the destination against fence and position at this time.",
        codes.ERR_MODE_REFUSED: "The mode needs something that was missing, most often a position. See the messages "
        "at this time.",
        codes.ERR_SENSORS: "See in the sensors section which of them stopped.",
        codes.ERR_EKF_PRIMARY: "Look at the estimator section.",
    }
)


def analyse(log: Log) -> Section | None:
    texts = signals.texts(log)
    rows = error_rows(log)
    if not texts and not rows and not _SOURCES & set(log.tables):
        if log.of_topics:
            return None
        return Section("events", "Events and errors", lacks=("The log has no EV, ERR, MSG or STATUSTEXT.",))
    clock, kind = LogClock(log), vehicle_kind(log)
    spans, told = error_spans(rows), reported_troubles(texts)
    # One finding per subsystem and code: the open error first, else their number and duration.
    from_errors: list[Finding] = []
    groups: dict[tuple[int, int], list[ErrorSpan]] = {}
    for span in spans:
        if span.subsystem != codes.ERR_EKF_PRIMARY:
            groups.setdefault((span.subsystem, span.code), []).append(span)
    from_errors.extend(_error(subsystem, code, group, kind, clock) for (subsystem, code), group in groups.items())
    findings = [
        *from_errors,
        *_from_texts(log, told, spans, clock),
        *_internal_error_findings(log, clock),
        *_failure_of_run(log, clock),
    ]
    table = Grid.limited(
        "events", "What happened", ("at (s)", "source", "level", "what"), _table(log, texts, rows, kind, clock)
    )
    facts = (
        Fact("events", "Events", len(log.tables["EV"]) if "EV" in log.tables else 0),
        Fact("errors", "Errors", sum(1 for _, subsystem, code in rows if code or not codes.error_persists(subsystem))),
        Fact("errors_open", "Errors never cleared", sum(1 for one in spans if _open(one))),
        Fact("texts", "Sentences", len(texts)),
    )
    return Section("events", "Events and errors", facts, tuple(findings), (table,))


def _open(span: ErrorSpan) -> bool:
    return span.until_ns is None and codes.error_persists(span.subsystem)


def _table(
    log: Log, texts: list[signals.LogText], rows: list[tuple[int, int, int]], kind: VehicleKind, clock: LogClock
) -> list[tuple[float, str, str, str]]:
    found = [
        (
            text.at_ns,
            text.source.partition(".")[0],
            (_LEVELS[text.severity] if text.severity is not None and 0 <= text.severity < len(_LEVELS) else ""),
            text.text,
        )
        for text in texts
    ]
    found += [
        (at_ns, "ERR", "error" if code else "", codes.error_name(subsystem, code, kind))
        for at_ns, subsystem, code in rows
    ]
    found += [(at_ns, "EV", "", codes.event_name(number)) for at_ns, number in event_rows(log)]
    for span in mode_spans(log):
        why = f" ({span.cause})" if span.cause else ""
        found.append((span.from_ns, span.source.partition(".")[0].rpartition(":")[2], "", f"mode {span.name}{why}"))
    found += _switches(log)
    found.sort(key=lambda row: row[0])
    return [(clock.second(at_ns), source, level, what) for at_ns, source, level, what in found]


def _switches(log: Log) -> list[tuple[int, str, str, str]]:
    """AUXF: functions switched by RC switches and ground stations."""
    table = log.tables.get("AUXF")
    if table is None or not {"function", "pos"} <= set(table.columns):
        return []
    names = [name for name in ("function", "pos", "source") if name in table.columns]
    columns = [np.asarray(table.values(name, raw=True)).astype(np.int64).tolist() for name in names]
    rows = []
    for at_ns, function, position, *source in zip(table.stamp_ns.tolist(), *columns, strict=True):
        by = SWITCH_SOURCES.get(source[0], "") if source else ""
        what = f"switch {auxiliary_function_name(function)} {SWITCH_POSITIONS.get(position, position)}"
        rows.append((at_ns, "AUXF", "", f"{what} ({by})" if by else what))
    return rows


def _error(subsystem: int, code: int, group: list[ErrorSpan], kind: VehicleKind, clock: LogClock) -> Finding:
    on = clock.was_armed(*(span.from_ns for span in group))
    open_one = next((span for span in group if _open(span)), None)
    name = codes.error_name(subsystem, code, kind)
    state = "armed" if on else "not armed"
    when = clock.text(group[0].from_ns)
    many = "" if len(group) == 1 else f", {len(group)} times in all"
    if open_one is not None:
        sentence = f"{name} at {clock.text(open_one.from_ns)}, {state}, and never cleared{many}"
    elif group[0].until_ns is None:
        sentence = f"{name} at {when}, {state}{many}"
    else:
        total_s = sum(((span.until_ns or span.from_ns) - span.from_ns) * 1e-9 for span in group)
        sentence = f"{name} at {when}, {state}, cleared after {length_text(total_s)}{many}"
    return Finding(
        f"events.error.{subsystem}.{code}",
        _severity(subsystem, on, open_one is not None),
        sentence[0].upper() + sentence[1:],
        tuple(
            Evidence("ERR", "ECode", span.from_ns, span.until_ns, f"{subsystem}/{code}")
            for span in group[:_MOST_EVIDENCE]
        ),
        _STEPS.get(subsystem, "Look at the messages around this time."),
    )


def _severity(subsystem: int, armed: bool, is_open: bool) -> Severity:
    if subsystem in (codes.ERR_CRASH, codes.ERR_INTERNAL, codes.ERR_CPU):
        return Severity.CRITICAL
    if subsystem in (codes.ERR_MODE_REFUSED, codes.ERR_NAVIGATION):
        return Severity.NOTICE
    if codes.is_failsafe_error(subsystem) and armed:
        return Severity.CRITICAL if is_open else Severity.WARNING
    return Severity.WARNING if armed or is_open else Severity.NOTICE


def _from_texts(log: Log, told: list[ReportedTrouble], spans: list[ErrorSpan], clock: LogClock) -> Iterator[Finding]:
    """Texts of trouble that no error code and no mode change reports already."""
    explained = [span.from_ns for span in spans if span.subsystem != codes.ERR_EKF_PRIMARY]
    explained += [span.from_ns for span in mode_spans(log) if span.failsafe]
    for trouble in told:
        at_ns = trouble.text.at_ns
        if trouble.severity < Severity.CRITICAL and any(abs(at_ns - other) <= _NEAR_NS for other in explained):
            continue
        if trouble.key == "internal_error" and any(span.subsystem == codes.ERR_INTERNAL for span in spans):
            continue
        on = clock.was_armed(at_ns)
        severity = trouble.severity if on or trouble.severity == Severity.CRITICAL else Severity.NOTICE
        times = f" ({trouble.count} times)" if trouble.count > 1 else ""
        over = "" if trouble.until_ns is None else f"; over at {clock.text(trouble.until_ns)}"
        message, _, field = trouble.text.source.partition(".")
        yield Finding(
            f"events.said.{trouble.key}",
            severity,
            f'"{trouble.text.text}"{times} at {clock.text(at_ns)}, {"armed" if on else "not armed"}{over}',
            (Evidence(message, field, at_ns, trouble.until_ns, trouble.text.text),),
            "Look at the messages and changes around this time.",
        )


def _failure_of_run(log: Log, clock: LogClock) -> Iterator[Finding]:
    """Reason for the end of an xitl run: its own last text with the level of an error."""
    table = log.tables.get("/log")
    if table is None or not {"level", "name", "message"} <= set(table.columns):
        return
    rows = np.flatnonzero((table.values("level", raw=True) >= _LOG_ERROR) & (table.values("name") == _RUN))
    if len(rows):
        last = int(rows[-1])
        at_ns, text = int(table.stamp_ns[last]), str(table.values("message")[last])
        yield Finding.critical(
            "events.run_failed",
            f"The run failed at {clock.text(at_ns)}: {text}",
            (Evidence("/log", "message", at_ns, value=text),),
            "The recording is complete until then. summary.json has the same sentence.",
        )


def _internal_error_findings(log: Log, clock: LogClock) -> Iterator[Finding]:
    """MON: the main loop stopped. WDOG: the watchdog reset the board before this log. PM: internal errors."""
    watchdog = log.tables.get("WDOG")
    if watchdog is not None:
        sentence = "The watchdog reset the board before this log began"
        if "Task" in watchdog.columns or "Tsk" in watchdog.columns:
            task = watchdog.values(first_of(watchdog, ("Task", "Tsk")) or "", raw=True)[-1]
            sentence += f", in scheduler task {int(task)}"
        evidence = Evidence("WDOG", None, int(watchdog.stamp_ns[-1]))
        step = "Report it with this log: WDOG and @SYS/crash_dump.bin show which code stopped."
        yield Finding.critical("events.watchdog", sentence, (evidence,), step)
    stuck = log.tables.get("MON")
    if stuck is not None:
        sentence = f"The main loop stopped long enough to be logged {len(stuck)} times"
        if "Dly" in stuck.columns:
            sentence += f", for up to {int(np.max(stuck.values('Dly', raw=True)))} ms"
        step = "Look at the scheduler section at this time, and at MON.Tsk for the task in which it stopped."
        each = tuple(Evidence("MON", "Dly", at_ns) for at_ns in stuck.stamp_ns[:_MOST_EVIDENCE].tolist())
        yield Finding.critical("events.main_loop_stuck", sentence, each, step)
    for name, columns in (("PM", ("InE", "IntE", "IErr")), ("MON", ("IErr",)), ("WDOG", ("IErr",))):
        table = log.tables.get(name)
        column = None if table is None else first_of(table, columns)
        if table is not None and column is not None and (bits := _bits(table, column)):
            rows = np.flatnonzero(np.asarray(table.values(column, raw=True)).astype(np.int64) & bits)
            at_ns = int(table.stamp_ns[rows[0]])
            only_reset = bits == codes.WATCHDOG_RESET
            yield Finding.critical(
                "events.internal_errors",
                f"Internal errors of the firmware, first at {clock.text(at_ns)}: "
                f"{', '.join(codes.internal_error_names(bits))}",
                (Evidence(name, column, at_ns, int(table.stamp_ns[rows[-1]]), f"0x{bits:x}"),),
                "The board was reset by its watchdog: look at WDOG."
                if only_reset
                else "Report it to ArduPilot with this log.",
            )
            break


def _bits(table: Table, column: str) -> int:
    if table.columns[column].kind != "number":
        return 0
    values = np.asarray(table.values(column, raw=True))
    if values.dtype.kind not in "iu" or not len(values):
        return 0
    bits = int(np.bitwise_or.reduce(values.astype(np.int64)))
    return bits & sum(1 << bit for bit in codes.INTERNAL_ERRORS)
