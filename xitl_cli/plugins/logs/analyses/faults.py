"""Faults injected on purpose, takeovers, and the sections that show their effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.fit import clock_relations
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Table
from xitl_cli.logs.signals.deadlines import missed_deadlines
from xitl_cli.logs.signals.series import rounded

MOST_PROFILE = 1 << 20
AFTER_NS = 1_000_000_000

EXPECTED: Mapping[str, Mapping[str, str]] = {
    "link": {
        "cut": "no frames on the link, gaps in its sequence (links)",
        "loss": "losses by the sequence (links)",
        "duplicate": "repeated frames (links)",
        "reorder": "late frames (links)",
        "delay_s": "latencies longer by as much (links)",
        "jitter_s": "latencies that scatter (links), a clock known less well (time bases)",
    },
    "agent": {
        "cpu_load": "late starts and missed deadlines (scheduler)",
        "clock_offset_s": "a step of the node's clock, skipped cycles (time bases, scheduler)",
        "clock_skew_ppm": "a drift by as much (time bases)",
    },
    "imu": {
        "dropout": "gaps of the IMU (sensors)",
        "freeze": "an IMU whose values do not change (sensors)",
        "gyro_bias_frd_radps": "gyroscopes that do not agree with the compass, heading innovations (estimator)",
        "accel_bias_frd_mps2": "velocity innovations (estimator)",
    },
    "gnss": {
        "dropout": "no fixes (GNSS), an estimate that coasts (estimator)",
        "freeze": "a position that does not change (GNSS)",
        "position_bias_ned_m": "position innovations, a reset (estimator)",
        "velocity_bias_ned_mps": "velocity innovations (estimator)",
        "drift_mps": "a position that departs from its velocity (actuators and power)",
    },
    "magnetometer": {
        "dropout": "gaps of the compass (sensors)",
        "freeze": "a compass whose values do not change (sensors)",
        "field_bias_frd_gauss": "heading innovations (estimator)",
    },
    "barometer": {
        "dropout": "gaps of the barometer (sensors)",
        "freeze": "a barometer whose values do not change (sensors)",
        "pressure_bias_pa": "height innovations (estimator)",
    },
    "propeller": {
        "thrust_loss": "heading and speed off their demands (control)",
        "stuck": "heading and speed off their demands (control)",
        "stuck_at": "heading and speed off their demands (control)",
        "reversed": "heading and speed off their demands (control)",
    },
    "rudder": {
        "jam": "heading and speed off their demands (control)",
        "jam_angle_deg": "heading and speed off their demands (control)",
    },
    "battery": {
        "added_resistance_ohm": "a voltage that falls more with the current (actuators and power)",
        "failed_cells": "a voltage too low for the current (actuators and power)",
        "voltage_drop_v": "a voltage too low for the current (actuators and power)",
    },
}
"""By group and key of a fault in a profile: its effects in other sections."""


@dataclass(frozen=True, slots=True)
class FaultSpan:
    """A fault and its span."""

    name: str
    from_ns: int
    until_ns: int | None
    """None if it is in force until the end."""
    wrong: tuple[tuple[str, str, str], ...]
    """Group, key and value of its effects; empty if unknown."""

    @property
    def what(self) -> str:
        return ", ".join(f"{group}.{key} {value}" for group, key, value in self.wrong) or "not told"

    @property
    def expected(self) -> str:
        said = [EXPECTED.get(group, {}).get(key, "") for group, key, _ in self.wrong]
        return "; ".join(dict.fromkeys(text for text in said if text))


def analyse(log: Log) -> Section | None:
    """Section on faults; None if nothing was injected and no agent took over."""
    faults = fault_spans(log)
    takeovers = log.tables.get("/takeovers")
    handed = takeovers is not None and {"from_node", "to_node", "silent_s", "step"} <= set(takeovers.columns)
    if not faults and not handed:
        return None
    clock = LogClock(log)
    findings = [_finding(fault, clock) for fault in faults]
    grids = [_grid(log, faults, clock)] if faults else []
    if takeovers is not None and handed:
        for at_ns, one, other, silent_s, step in _rows(takeovers)[:20]:
            silent = f", which had been silent for {silent_s:.2f} s" if math.isfinite(silent_s) else ""
            stepped = f"; a motor command stepped by {step:.2f} at most" if math.isfinite(step) else ""
            findings.append(
                Finding.notice(
                    "faults.takeover",
                    f"At {clock.text(at_ns)} {other} took over from {one}{silent}{stepped}",
                    (Evidence("/takeovers", "from_node", at_ns, value=f"{silent_s:.3f} s" if silent else ""),),
                    "See in the links and the scheduler why the first one stopped sending.",
                )
            )
        grids.append(
            Grid.limited(
                "takeovers",
                "Takeovers",
                ("at (s)", "from", "to", "silent for (s)", "largest step of a motor command"),
                [
                    (clock.second(at_ns), str(one), str(other), rounded(silent_s), rounded(step))
                    for at_ns, one, other, silent_s, step in _rows(takeovers)
                ],
            )
        )
    facts = (
        Fact("faults", "Faults on purpose", len(faults)),
        Fact("takeovers", "Takeovers", len(takeovers) if takeovers is not None and handed else 0),
    )
    return Section("faults", "Faults on purpose", facts, tuple(findings), tuple(grids), _plots(log, faults))


def fault_spans(log: Log) -> list[FaultSpan]:
    """Faults in order of their beginning."""
    table = log.tables.get("/faults")
    if table is None or not {"fault", "active"} <= set(table.columns):
        return []
    told = _told(log)
    begun: dict[str, int] = {}
    found: list[FaultSpan] = []
    for at_ns, name, active in zip(
        table.stamp_ns.tolist(), table.values("fault").tolist(), table.values("active", raw=True).tolist(), strict=True
    ):
        if active:
            begun.setdefault(str(name), at_ns)
        elif str(name) in begun:
            found.append(FaultSpan(str(name), begun.pop(str(name)), at_ns, told.get(str(name), ())))
    found += [FaultSpan(name, at_ns, None, told.get(name, ())) for name, at_ns in begun.items()]
    return sorted(found, key=lambda fault: fault.from_ns)


def _told(log: Log) -> dict[str, tuple[tuple[str, str, str], ...]]:
    """Effects of each fault, from the profile inside the recording or next to it; empty without a profile."""
    text = log.attachment("profile.yaml")
    if text is None:
        try:
            with log.path.with_name("profile.yaml").open("rb") as file:
                text = file.read(MOST_PROFILE)
        except OSError:
            return {}
    import yaml

    try:
        document: Any = yaml.safe_load(text[:MOST_PROFILE])
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError):
        return {}
    faults = _faults_of(document)
    for name in (log.vessel,) if log.vessel else ():
        vessels = document.get("vessels") if isinstance(document, dict) else None
        faults = faults | _faults_of(vessels.get(name) if isinstance(vessels, dict) else None)
    return {str(name): _wrongs(fault) for name, fault in faults.items() if isinstance(fault, dict)}


def _faults_of(document: Any) -> dict[Any, Any]:
    faults = document.get("faults") if isinstance(document, dict) else None
    return faults if isinstance(faults, dict) else {}


def _wrongs(fault: Mapping[Any, Any]) -> tuple[tuple[str, str, str], ...]:
    """Group, key and value of each effect that differs from the state without the fault."""
    return tuple(
        (str(group), str(key), str(value))
        for group, keys in fault.items()
        if group in EXPECTED and isinstance(keys, dict)
        for key, value in keys.items()
        if key in EXPECTED[group] and (any(value) if isinstance(value, list) else value)
    )


def _finding(fault: FaultSpan, clock: LogClock) -> Finding:
    end = "to the end" if fault.until_ns is None else f"to {clock.text(fault.until_ns)}"
    seen = f"; expected: {fault.expected}" if fault.expected else ""
    return Finding.notice(
        "faults.injected",
        f"On purpose: {fault.name} from {clock.text(fault.from_ns)} {end} ({fault.what}){seen}",
        (Evidence("/faults", "active", fault.from_ns, fault.until_ns, fault.what),),
        "Findings of other sections in this time are its effects. Findings at other times are not.",
    )


def _rows(table: Table) -> list[tuple[int, str, str, float, float]]:
    return list(
        zip(
            table.stamp_ns.tolist(),
            table.values("from_node").tolist(),
            table.values("to_node").tolist(),
            table.values("silent_s").tolist(),
            table.values("step").tolist(),
            strict=True,
        )
    )


def _grid(log: Log, faults: Sequence[FaultSpan], clock: LogClock) -> Grid:
    steps = [
        step
        for relation in clock_relations(log)
        if relation.readings.key.startswith("clocks.")
        for step in relation.steps
    ]
    misses = missed_deadlines(log)
    rows: list[tuple[Value, ...]] = []
    for fault in faults:
        end_ns = fault.until_ns if fault.until_ns is not None else clock.end_ns
        lasting = end_ns + AFTER_NS
        late = None
        if "/misses" in log.tables or "/clocks" in log.tables:
            late = 0 if misses is None else int(np.sum((misses.due_ns >= fault.from_ns) & (misses.due_ns <= lasting)))
        leapt = [step.size_s for step in steps if fault.from_ns - AFTER_NS <= step.at_ns <= lasting and step.size_s]
        # Frames that all links counted as lost in this time.
        table = log.tables.get("/links")
        if table is None or not {"name", "lost", "gaps"} <= set(table.columns):
            missing = None
        else:
            names, stamps = np.asarray(table.values("name")), table.stamp_ns
            lost, gaps = (np.asarray(table.values(count, raw=True)).astype(np.int64) for count in ("lost", "gaps"))
            counts = np.maximum(lost, gaps)
            total = 0
            for name in dict.fromkeys(names.tolist()):
                mine = names == name
                before = counts[mine & (stamps <= fault.from_ns)]
                after = counts[mine & (stamps <= lasting)]
                if len(after):
                    total += max(int(after.max()) - (int(before.max()) if len(before) else 0), 0)
            missing = total
        rows.append(
            (
                fault.name,
                clock.second(fault.from_ns),
                None if fault.until_ns is None else clock.second(fault.until_ns),
                fault.what,
                fault.expected or None,
                missing,
                late,
                ", ".join(f"{size_s:+.3f} s" for size_s in leapt) or None,
            )
        )
    columns = (
        "fault", "from (s)", "until (s)", "what", "to be seen", "frames lost then", "deadlines missed", "clock steps",
    )  # fmt: skip
    return Grid.limited("faults", "Injected faults and their effects", columns, rows)


def _plots(log: Log, faults: Sequence[FaultSpan]) -> tuple[Plot, ...]:
    """One band per fault."""
    if not faults or log.span_ns is None:
        return ()
    end_ns = log.span_ns[1]
    traces = tuple(
        Trace(
            fault.name,
            np.array([fault.from_ns, fault.until_ns or end_ns], dtype=np.int64),
            np.array([float(row), float(row)]),
        )
        for row, fault in enumerate(faults)
    )
    marks = tuple(Mark(fault.from_ns, fault.name, fault.until_ns or end_ns, Severity.NOTICE) for fault in faults)
    return (Plot("faults", "Faults on purpose", "fault", traces, marks=marks),)
