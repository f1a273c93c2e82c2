"""Troubles logged by PX4: failsafes, failure detector, estimator, load, supply and the logger; only for ULogs.

Limits: a test ratio over 1 rejects a measurement (EKF2 of PX4). `battery_status.warning` 1 is low, 2 critical, 3
emergency. Load and memory are shares of 1.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import xitl_cli.logs.signals as signals
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Section
from xitl_cli.logs.model.table import Flags, Floats, Table, by_instance
from xitl_cli.logs.model.text import length_text, plural
from xitl_cli.logs.signals import px4
from xitl_cli.logs.signals.series import instance_label, numbers, rounded
from xitl_cli.logs.signals.spans import runs
from xitl_cli.logs.signals.states import LogText

_MOST_FINDINGS = 12
_HIGH_LOAD = 0.9
_HIGH_MEMORY = 0.95
_REJECTED_S = 1.0
_ERROR = 3  # MAVLink's severity
_RATIOS = {
    "mag_test_ratio": ("magnetometer", "EKF2_MAG_GATE, EKF2_MAG_TYPE and the distance of the compass to power lines"),
    "vel_test_ratio": ("velocity", "EKF2_GPS_V_GATE, EKF2_GPS_DELAY and the quality of the receiver"),
    "pos_test_ratio": ("position", "EKF2_GPS_P_GATE, EKF2_GPS_DELAY and the quality of the receiver"),
    "hgt_test_ratio": ("height", "EKF2_BARO_GATE, EKF2_HGT_REF and the shelter of the barometer"),
    "hdg_test_ratio": ("heading", "EKF2_HDG_GATE, EKF2_MAG_TYPE and the distance of the compass to power lines"),
}
_DETECTED = {
    "fd_roll": ("roll beyond FD_FAIL_R", "FD_FAIL_R"), "fd_pitch": ("pitch beyond FD_FAIL_P", "FD_FAIL_P"),
    "fd_alt": ("loss of height", "FD_FAIL_R"), "fd_ext": ("an external trigger", "FD_EXT_ATS_EN"),
    "fd_arm_escs": ("a motor controller that did not arm", "FD_ESCS_EN"),
    "fd_battery": ("a battery failure", "BAT1_SOURCE"),
    "fd_imbalanced_prop": ("an imbalanced propeller", "FD_IMB_PROP_THR"), "fd_motor": ("a motor failure", "FD_ACT_EN"),
}  # fmt: skip
_RESETS = (
    ("xy_reset_counter", "position", "delta_xy", 1.0, "m", 1.0),
    ("heading_reset_counter", "heading", "delta_heading", np.degrees(1.0), "°", 5.0),
)
"""Counter, name, change, factor to its unit, unit, and the change below which a reset is a notice."""
_BATTERY = {1: "low", 2: "critical", 3: "emergency", 4: "failed"}


def analyse(log: Log) -> Section | None:
    if log.format != "ulog" or log.span_ns is None:
        return None
    clock = LogClock(log)
    ends_armed: list[Finding] = []
    states = px4.arm_states(log)
    if states is not None and len(states[1]) and states[1][-1]:
        ends_armed.append(
            Finding.warning(
                "px4.ends_armed",
                "The log ends while the vehicle was armed: the supply failed, PX4 crashed, or the log was cut off",
                (Evidence("vehicle_status", "arming_state", int(states[0][-1]), value="2"),),
                "Look at the supply and for a fault log on the card. SDLOG_MODE decides until when PX4 logs.",
            )
        )
    findings = [
        *_failsafes(log, clock),
        *_detected(log, clock),
        *ends_armed,
        *_reported(signals.texts(log), clock),
        *_rejected(log, clock),
        *_resets(log, clock),
        *_clipping(log, clock),
        *_battery(log, clock),
        *_load(log),
        *_dropouts(log),
    ]
    facts: list[Fact] = []
    load = px4.topic(log, "cpuload")
    for field, label in (("load", "Processor load, highest"), ("ram_usage", "Memory in use, highest")):
        values = None if load is None else numbers(load, field)
        if values is not None and _shares(values).any():
            highest = rounded(100.0 * float(_shares(values).max()), 1)
            facts.append(Fact(f"{field}_highest_percent", label, highest, "%"))
    lost = log.tables.get("dropouts")
    duration = None if lost is None else numbers(lost, "duration")
    facts.append(
        Fact("dropouts_s", "Lost by the logger", 0.0 if duration is None else rounded(1e-3 * duration.sum()), "s")
    )
    return Section("px4", "PX4", tuple(facts), tuple(findings))


def _shares(values: Floats) -> Floats:
    """(N,) shares of 1. Others are no measurement (boards without a memory report) and become 0."""
    shares: Floats = np.where((values >= 0.0) & (values <= 1.0), values, 0.0)
    return shares


def _true(table: Table | None, field: str) -> Flags:
    """(N,) True if a flag is set."""
    values = None if table is None else numbers(table, field)
    return np.zeros(0, np.bool_) if values is None or values.ndim != 1 else values > 0.0


def _span(table: Table, first: int, after: int) -> tuple[int, int]:
    stamps = table.stamp_ns
    return int(stamps[first]), int(stamps[min(after, len(stamps) - 1)])


def _failsafes(log: Log, clock: LogClock) -> Iterator[Finding]:
    table = px4.topic(log, "vehicle_status")
    if table is None:
        return
    armed = signals.armed(log)
    for first, after in list(runs(_true(table, "failsafe")))[:_MOST_FINDINGS]:
        from_ns, until_ns = _span(table, first, after)
        reasons = _flags_set(log, from_ns, until_ns)
        because = f" ({', '.join(reasons)})" if reasons else ""
        lasted = f"for {length_text((until_ns - from_ns) * 1e-9)}" if after < len(table) else "to the end of the log"
        acted = any(span.from_ns <= until_ns and from_ns <= span.until_ns for span in armed)
        judge, while_text = (Finding.critical, "") if acted else (Finding.notice, " while disarmed")
        yield judge(
            "px4.failsafe",
            f"PX4 was in failsafe{while_text} from {clock.text(from_ns)} {lasted}{because}",
            (
                Evidence("vehicle_status", "failsafe", from_ns, until_ns, "1"),
                *(Evidence("failsafe_flags", name, from_ns, until_ns, "1") for name in reasons),
            ),
            "Find the flag that came first and its cause. COM_*_ACT and NAV_*_ACT decide the reaction of PX4.",
        )


_NO_REASON = ("timestamp", "mode_req_", "multi_id")


def _flags_set(log: Log, from_ns: int, until_ns: int) -> list[str]:
    """Flags of failsafe_flags that were set when a failsafe began, without those that were always set before."""
    table = px4.topic(log, "failsafe_flags")
    if table is None or not len(table):
        return []
    row = min(int(np.searchsorted(table.stamp_ns, from_ns, side="right")), len(table) - 1)
    names = []
    for name in table.columns:
        flags = _true(table, name)
        if name.startswith(_NO_REASON) or not len(flags):
            continue
        if flags[max(row - 1, 0) : row + 1].any() and not flags[: max(row - 1, 1)].all():
            names.append(name)
    return names[:6]


def _detected(log: Log, clock: LogClock) -> Iterator[Finding]:
    table = px4.topic(log, "failure_detector_status")
    if table is None:
        return
    for field, (failure, parameter) in _DETECTED.items():
        for first, after in list(runs(_true(table, field)))[:1]:
            from_ns, until_ns = _span(table, first, after)
            yield Finding.critical(
                "px4.failure_detected",
                f"PX4's failure detector reported {failure} at {clock.text(from_ns)}",
                (Evidence("failure_detector_status", field, from_ns, until_ns, "1"),),
                f"Look at attitude, outputs and supply just before; {parameter} sets its limit.",
            )


def _reported(texts: list[LogText], clock: LogClock) -> Iterator[Finding]:
    by_text: dict[str, list[LogText]] = {}
    for text in texts:
        words = " ".join(text.text.split())
        if text.severity is not None and (text.severity <= _ERROR or "Preflight Fail" in words):
            by_text.setdefault(words, []).append(text)
    for words, alike in list(by_text.items())[:_MOST_FINDINGS]:
        times = "" if len(alike) == 1 else f" ({len(alike)} times)"
        yield Finding.warning(
            "px4.reported",
            f'PX4 reported "{words}" at {clock.text(alike[0].at_ns)}{times}',
            (Evidence("logged_messages", "message", alike[0].at_ns, alike[-1].at_ns, words),),
            "Look at the sensors and states of this text just before.",
        )


def _rejected(log: Log, clock: LogClock) -> Iterator[Finding]:
    table = px4.topic(log, "estimator_status")
    if table is None:
        return
    for field, (what, advice) in _RATIOS.items():
        values = numbers(table, field)
        if values is None or values.ndim != 1:
            continue
        spans = [_span(table, *run) for run in runs(np.nan_to_num(values) > 1.0)]
        long = [(begin, end) for begin, end in spans if (end - begin) * 1e-9 >= _REJECTED_S]
        if not long:
            continue
        longest = max(end - begin for begin, end in long) * 1e-9
        yield Finding.warning(
            "px4.rejected",
            f"EKF2 rejected the {what} {plural(len(long), 'time')} for a second or more, first at "
            f"{clock.text(long[0][0])} and for up to {length_text(longest)} "
            f"(estimator_status.{field} up to {float(np.nanmax(values)):.3g})",
            tuple(Evidence("estimator_status", field, begin, end) for begin, end in long[:_MOST_FINDINGS]),
            f"Look at {advice}.",
        )


def _resets(log: Log, clock: LogClock) -> Iterator[Finding]:
    table, armed = px4.topic(log, "vehicle_local_position"), signals.armed(log)
    if table is None:
        return
    for field, what, change_field, factor, unit, small in _RESETS:
        if field not in table.columns:
            continue
        rows = np.flatnonzero(np.diff(table.values(field)) != 0) + 1
        rows = rows[[any(s.from_ns <= at <= s.until_ns for s in armed) for at in table.stamp_ns[rows].tolist()]]
        if not len(rows):
            continue
        changes = numbers(table, change_field)
        size = None  # of numbers (N,) or vectors (N, k)
        if changes is not None:
            size = float(np.linalg.norm(changes[rows].reshape(len(rows), -1), axis=1).max()) * factor
        judge = Finding.notice if size is not None and size < small else Finding.warning
        by = "" if size is None else f", by {size:.2g} {unit}" if len(rows) == 1 else f", by {size:.2g} {unit} at most"
        stamps = table.stamp_ns[rows].tolist()
        yield judge(
            "px4.estimate_reset",
            f"EKF2 reset its {what} {plural(len(stamps), 'time')} while armed, first at {clock.text(stamps[0])}{by}",
            tuple(Evidence("vehicle_local_position", field, at) for at in stamps[:_MOST_FINDINGS]),
            "Look at the test ratios, the compass and the receiver just before. EKF2 aligns its heading once after "
            "takeoff; other resets make the vehicle jump to its track.",
        )


def _clipping(log: Log, clock: LogClock) -> Iterator[Finding]:
    whole = log.tables.get("vehicle_imu_status")
    if whole is None:
        return
    for number, table in by_instance(whole).items():
        values = numbers(table, "accel_clipping")
        if values is None or values.ndim != 2:
            continue
        grown = np.maximum(np.diff(values.sum(axis=1), prepend=values[0].sum()), 0.0)
        if not grown.any():
            continue
        at_ns = int(table.stamp_ns[int(np.flatnonzero(grown)[0])])
        name = instance_label(table, number)
        yield Finding.warning(
            "px4.accel_clipping",
            f"The accelerometer of {name} clipped {grown.sum():.0f} samples, first at {clock.text(at_ns)}",
            (Evidence(name, "accel_clipping", at_ns),),
            "Look for an impact. Otherwise, damp the mounting: vibration exceeds the range of the sensor.",
        )


def _battery(log: Log, clock: LogClock) -> Iterator[Finding]:
    whole = log.tables.get("battery_status") if log.format == "ulog" else None
    if whole is None:
        return
    for number, table in by_instance(whole).items():
        levels = numbers(table, "warning")
        if levels is None or not (np.nan_to_num(levels) > 0.0).any():
            continue
        worst = int(np.nanmax(levels))
        row = int(np.flatnonzero(levels == worst)[0])
        at_ns, name = int(table.stamp_ns[row]), instance_label(table, number)
        volts = numbers(table, "voltage_v")
        told = "" if volts is None else f" at {volts[row]:.2f} V"
        judge = Finding.warning if worst == 1 else Finding.critical
        yield judge(
            "px4.battery",
            f"PX4 reported the battery as {_BATTERY.get(worst, f'warning {worst}')} at {clock.text(at_ns)}{told}",
            (Evidence(name, "warning", at_ns, value=str(worst)),),
            "Compare with BAT_LOW_THR, BAT_CRIT_THR and BAT_EMERGEN_THR. COM_LOW_BAT_ACT decides the reaction.",
        )


def _load(log: Log) -> Iterator[Finding]:
    table = px4.topic(log, "cpuload")
    for field, limit, what in (("load", _HIGH_LOAD, "processor load"), ("ram_usage", _HIGH_MEMORY, "memory in use")):
        values = None if table is None else numbers(table, field)
        if table is None or values is None:
            continue
        shares = _shares(values)
        if not (shares > limit).any():
            continue
        row = int(np.argmax(shares))
        yield Finding.warning(
            "px4.load",
            f"The {what} reached {100.0 * values[row]:.0f} %",
            (Evidence("cpuload", field, int(table.stamp_ns[row]), value=f"{values[row]:.3g}"),),
            "Log less (SDLOG_PROFILE), lower IMU_GYRO_RATEMAX or stop modules that are not needed.",
        )


def _dropouts(log: Log) -> Iterator[Finding]:
    table = log.tables.get("dropouts")
    lost = None if table is None else numbers(table, "duration")
    if table is None or lost is None or not lost.any():
        return
    yield Finding.warning(
        "px4.log_dropouts",
        f"The logger lost data {plural(len(lost), 'time')}, {1e-3 * lost.sum():.3g} s in all and {lost.max():.0f} ms "
        "at most",
        (Evidence("dropouts", "duration", int(table.stamp_ns[0]), int(table.stamp_ns[-1])),),
        "Use a faster card or log less (SDLOG_PROFILE). A gap here need not be one in the vehicle.",
    )
