"""Power: batteries against their failsafe levels, sag and resistance, remaining charge; the supply of the board.

According to ArduPilot's page on diagnosing with logs, 0.1 to 0.15 V of change of the board's supply is normal. A larger
change needs a check.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import ERR_BATTERY_FAILSAFE
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Flags, Floats, Stamps, Table, by_instance
from xitl_cli.logs.signals.series import bounded_stamps, instance_label, numbers, significant, tables_of
from xitl_cli.logs.signals.spans import held_spans, runs, spells
from xitl_cli.logs.signals.states import error_rows, parameter_values

_TITLE = "Power"
_UNKNOWN_MV = 65535.0
_HUNDREDTHS = 0.01


@dataclass(frozen=True, slots=True)
class BatteryLog:
    """One battery; each array is (N,), NaN if unknown, None if not logged."""

    name: str
    message: str
    number: int
    """From 1, as in BATT2_…."""
    stamp_ns: Stamps
    voltage_v: Floats
    voltage_field: str
    current_a: Floats | None
    used_mah: Floats | None
    remaining_percent: Floats | None
    resistance_ohm: Floats | None
    healthy: Flags | None


def batteries(log: Log) -> list[BatteryLog]:
    """Every instance that ever has a voltage. For telemetry, BATTERY_STATUS, or else SYS_STATUS."""
    packs: list[BatteryLog] = []
    for kinds in (("BAT", "BAT2"), ("CURR", "CUR2"), ("BATTERY_STATUS",), ("SYS_STATUS",)):
        for table in tables_of(log, kinds):
            for number, rows in by_instance(table).items():
                read = _battery_from_telemetry if kinds[0].endswith("_STATUS") else _battery_from_log
                battery = read(table, rows, number)
                if battery is not None and (np.nan_to_num(battery.voltage_v) > 0.0).any():
                    packs.append(battery)
        if packs:
            return packs
    return packs


def _battery_from_log(table: Table, rows: Table, number: int) -> BatteryLog | None:
    voltage = _measured(rows, "Volt")
    if voltage is None or not np.isfinite(voltage).any():
        return None
    healthy = numbers(rows, "H", raw=True)
    return BatteryLog(
        name=instance_label(table, number),
        message=table.name,
        number=number + (2 if table.name.endswith("2") else 1),
        stamp_ns=bounded_stamps(rows),
        voltage_v=voltage,
        voltage_field="Volt",
        current_a=_measured(rows, "Curr"),
        used_mah=numbers(rows, "CurrTot", raw=True),
        remaining_percent=numbers(rows, "RemPct"),
        resistance_ohm=numbers(rows, "Res"),
        healthy=None if healthy is None else healthy > 0.0,
    )


def _measured(table: Table, name: str) -> Floats | None:
    """(N,) in volts or amperes.

    Before 2016 (CURR of Copter 3.4), the values were hundredths in whole numbers, which no letter of the FMT shows.
    Since then they are floating point. Source: LogStructure.h of ArduPilot's releases.
    """
    values = numbers(table, name)
    if values is None or table.columns[name].unit or table.values(name, raw=True).dtype.kind not in "iu":
        return values
    return values * _HUNDREDTHS


def _battery_from_telemetry(table: Table, rows: Table, number: int) -> BatteryLog | None:
    """Battery from MAVLink: mV with 65535 unknown, cA and % with -1 unknown."""
    name = "voltages" if "voltages" in rows.columns else "voltage_battery"
    millivolts = numbers(rows, name, raw=True)
    if millivolts is None:
        return None
    cells = np.where(millivolts >= _UNKNOWN_MV, np.nan, millivolts).reshape(len(millivolts), -1)
    known = np.isfinite(cells).any(axis=1)
    current = numbers(rows, "current_battery", raw=True)
    used = numbers(rows, "current_consumed", raw=True)
    remaining = numbers(rows, "battery_remaining", raw=True)
    return BatteryLog(
        name=instance_label(table, number),
        message=table.name,
        number=number + 1,
        stamp_ns=bounded_stamps(rows),
        voltage_v=np.where(known, np.nansum(cells, axis=1) * 1e-3, np.nan),
        voltage_field=name,
        current_a=None if current is None else np.where(current < 0.0, np.nan, current * 1e-2),
        used_mah=None if used is None else np.where(used < 0.0, np.nan, used),
        remaining_percent=None if remaining is None else np.where(remaining < 0.0, np.nan, remaining),
        resistance_ohm=None,
        healthy=None,
    )


LEAST_V = 4.6
CHANGE_V = 0.25
HOT_DEGC = 85.0
_BRICK, _OVERCURRENT = 1, 8 | 16
_MEASURED_V = 1.0


def board_section(log: Log, clock: LogClock) -> Section | None:
    """Section on the board's supply; None if nothing of it is logged."""
    parts = [part for part in (_supply(log, clock), _processor(log, clock)) if part is not None]
    if not parts and log.format == "dataflash":
        lack = "The voltage of the board is not logged (POWR). Its sensor may be missing."
        return Section("power", _TITLE, lacks=(lack,))
    return Section.joined("power", _TITLE, parts) if parts else None


def _supply(log: Log, clock: LogClock) -> Section | None:
    for table in tables_of(log, ("POWR", "POWER_STATUS")):
        told_mv = numbers(table, "Vcc", raw=True)
        if told_mv is None or not len(table):
            continue
        # POWER_STATUS is in whole millivolts, and so was POWR in old versions; since then POWR is in volts.
        voltage = told_mv * 1e-3 if np.nanmax(np.nan_to_num(told_mv)) > 100.0 else told_mv
        findings = list(_flag_findings(table, clock))
        measured = np.nan_to_num(voltage) > _MEASURED_V
        if not measured.any():
            return Section("power", _TITLE, findings=tuple(findings)) if findings else None
        levels, stamps = voltage[measured], table.stamp_ns[measured]
        lowest_ns, least, most = int(stamps[np.argmin(levels)]), float(levels.min()), float(levels.max())
        evidence = (Evidence(table.name, "Vcc", lowest_ns, None, f"{least:.2f} V"),)
        if least < LEAST_V:
            sentence = (
                f"The board's supply fell to {least:.2f} V at {clock.text(lowest_ns)}; "
                f"under {LEAST_V} V a brown-out is near"
            )
            step = "Power servos and radios from another supply, or fit a stronger one."
            findings.append(Finding.warning("power.brown_out", sentence, evidence, step))
        elif most - least > CHANGE_V:
            sentence = f"The board's supply changed by {most - least:.2f} V, from {least:.2f} to {most:.2f} V"
            step = "See whether it follows the throttle or the servos: the supply is weak or shared."
            findings.append(Finding.notice("power.supply_changes", sentence, evidence, step))
        facts = (
            Fact("board_least_v", "Board supply, least", significant(least), "V"),
            Fact("board_most_v", "Board supply, most", significant(most), "V"),
        )
        plot = Plot("board_voltage", "Supply of the board", "V", (Trace("Vcc", stamps, levels),))
        return Section("power", _TITLE, facts, tuple(findings), plots=(plot,))
    return None


def _flag_findings(table: Table, clock: LogClock) -> Iterator[Finding]:
    field = "Flags" if "Flags" in table.columns else "flags"
    flags = numbers(table, field, raw=True)
    if flags is None:
        return
    bits = np.nan_to_num(flags).astype(np.int64)
    over = np.flatnonzero((bits & _OVERCURRENT) != 0)
    if len(over):
        at_ns = int(table.stamp_ns[over[0]])
        yield Finding.warning(
            "power.overcurrent",
            f"The board's supply for peripherals was overloaded, first at {clock.text(at_ns)}",
            tuple(
                Evidence(table.name, field, begin, end, str(int(bits[over[0]])))
                for begin, end in spells(table.stamp_ns, (bits & _OVERCURRENT) != 0)
            ),
            "Unplug peripherals one by one, or power them from a separate supply.",
        )
    lost = np.flatnonzero(((bits[:-1] & _BRICK) != 0) & ((bits[1:] & _BRICK) == 0)) + 1
    if len(lost):
        at_ns = int(table.stamp_ns[lost[0]])
        yield Finding.warning(
            "power.input_lost",
            f"The main supply of the board failed {len(lost)} times, first at {clock.text(at_ns)}",
            tuple(Evidence(table.name, field, int(table.stamp_ns[row])) for row in lost[:8]),
            "Check the power module and its plug; something else fed the board meanwhile.",
        )


def _processor(log: Log, clock: LogClock) -> Section | None:
    table = log.tables.get("MCU")
    warmth = None if table is None else numbers(table, "MTemp")
    if table is None or warmth is None or not np.isfinite(warmth).any():
        return None
    at_ns, hottest_degc = int(table.stamp_ns[np.nanargmax(warmth)]), float(np.nanmax(warmth))
    findings: tuple[Finding, ...] = ()
    if hottest_degc > HOT_DEGC:
        sentence = f"The processor of the board was at {hottest_degc:.0f} °C at {clock.text(at_ns)}"
        evidence = Evidence("MCU", "MTemp", at_ns, None, f"{hottest_degc:.0f} °C")
        step = "Shade or cool the case: sensors drift with it."
        findings = (Finding.notice("power.hot", sentence, (evidence,), step),)
    fact = Fact("processor_hottest_degc", "Processor of the board, hottest", significant(hottest_degc), "°C")
    return Section("power", _TITLE, (fact,), findings)


_LEAST_LOAD_A = 0.5  # least spread of the current to determine a resistance
_LOW_PERCENT = 20.0
_FALL_V_SHARE = 0.8
_END_S = 60.0
_NO_BATTERY_V = 3.0  # below one cell: a monitor without a battery


def analyse(log: Log) -> Section | None:
    """Section on power; None for a recording without batteries. For a vehicle's log, the lack is reported."""
    clock = LogClock(log)
    packs = batteries(log)
    parameters = parameter_values(log)
    supply = board_section(log, clock)
    if not packs and supply is None and log.of_topics:
        return None
    findings = [finding for battery in packs for finding in _judged(battery, parameters, clock)]
    lacks: list[str] = []
    if not packs:
        lacks.append("No battery is logged; set BATT_MONITOR, and the bit CURRENT of LOG_BITMASK.")
    else:
        for battery in packs:
            if parameters and parameters.get(_prefix(battery) + "LOW_VOLT", 0.0) <= 0.0:
                lacks.append(
                    f"{battery.name} has no low level ({_prefix(battery)}LOW_VOLT is 0): its voltage cannot be judged."
                )
            if battery.current_a is None or not np.nan_to_num(battery.current_a).any():
                lacks.append(f"{battery.name} measures no current.")
    failsafes: list[Finding] = []
    acted = [
        (at_ns, code) for at_ns, subsystem, code in error_rows(log) if subsystem == ERR_BATTERY_FAILSAFE and code > 0
    ]
    if acted:
        failsafes.append(
            Finding.warning(
                "power.failsafe",
                f"The battery failsafe acted, first at {clock.text(acted[0][0])}",
                tuple(Evidence("ERR", "ECode", at_ns, None, str(code)) for at_ns, code in acted[:8]),
                "Look at the voltage then, and at BATT_FS_LOW_ACT and BATT_FS_CRT_ACT.",
            )
        )
    supplied = Section(
        "power",
        _TITLE,
        _facts(packs[0], parameters) if packs else (),
        (*findings, *failsafes),
        (_grid(packs),) if packs else (),
        _plots(packs),
        tuple(lacks),
    )
    return Section.joined("power", _TITLE, (supplied, supply))


def _prefix(battery: BatteryLog) -> str:
    return "BATT_" if battery.number == 1 else f"BATT{battery.number}_"


def _judged(battery: BatteryLog, parameters: Mapping[str, float], clock: LogClock) -> Iterator[Finding]:
    for name, severity, what in (("CRT_VOLT", Severity.CRITICAL, "critical"), ("LOW_VOLT", Severity.WARNING, "low")):
        limit = parameters.get(_prefix(battery) + name, 0.0)
        span = _longest_under(battery, limit) if limit > 0.0 else None
        timer_s = parameters.get(_prefix(battery) + "LOW_TIMER", 10.0)
        if span is None:
            continue
        from_ns, until_ns, least = span
        length_s = (until_ns - from_ns) * 1e-9
        short = length_s < timer_s
        yield Finding(
            "power.low",
            Severity.NOTICE if short else severity,
            f"{battery.name} was under its {what} level of {limit:.2f} V for {length_s:.1f} s from "
            f"{clock.text(from_ns)}, down to {least:.2f} V"
            + (f", shorter than the failsafe waits ({timer_s:.0f} s)" if short else ""),
            (Evidence(battery.message, battery.voltage_field, from_ns, until_ns, f"{least:.2f} V"),),
            "Charge or replace the battery, or reduce its load. Check the level against its cells.",
        )
        break
    limit = parameters.get(_prefix(battery) + "LOW_MAH", 0.0)
    capacity = parameters.get(_prefix(battery) + "CAPACITY", 0.0)
    if battery.used_mah is not None and limit > 0.0 and capacity > 0.0:
        under = np.flatnonzero(capacity - np.nan_to_num(battery.used_mah) < limit)
        if len(under):
            at_ns = int(battery.stamp_ns[under[0]])
            yield Finding.warning(
                "power.used_up",
                f"{battery.name} had less than {limit:.0f} mAh of its {capacity:.0f} mAh left from "
                f"{clock.text(at_ns)} on",
                (Evidence(battery.message, "CurrTot", at_ns),),
                "Plan shorter runs or fit a larger battery.",
            )
    yield from _nearly_empty(battery)
    if battery.healthy is not None and not battery.healthy.all():
        bad = np.flatnonzero(~battery.healthy)
        yield Finding.warning(
            "power.unhealthy",
            f"The monitor of {battery.name} was unhealthy in {len(bad)} of {len(battery.healthy)} rows, first at "
            f"{clock.text(int(battery.stamp_ns[bad[0]]))}",
            tuple(Evidence(battery.message, "H", a, b, "0") for a, b in spells(battery.stamp_ns, ~battery.healthy)),
            "Check the wiring of the power module or the bus of the battery monitor.",
        )
    yield from _falls_at_end(battery)


def _longest_under(battery: BatteryLog, limit_v: float) -> tuple[int, int, float] | None:
    """Begin, end and least voltage of the longest time below a level. Rows of 0 V are not measurements."""
    with np.errstate(invalid="ignore"):
        under = (battery.voltage_v < limit_v) & (battery.voltage_v > 0.0)
    if not under.any():
        return None
    spans = zip(held_spans(battery.stamp_ns, under), runs(under), strict=True)
    (from_ns, until_ns), (begin, after) = max(spans, key=lambda span: span[0][1] - span[0][0])
    return from_ns, until_ns, float(battery.voltage_v[begin:after].min())


def _nearly_empty(battery: BatteryLog) -> Iterator[Finding]:
    if battery.remaining_percent is None:
        return
    known = np.flatnonzero(np.isfinite(battery.remaining_percent))
    if not len(known) or not battery.remaining_percent[known].any():
        return
    left = float(battery.remaining_percent[known[-1]])
    if left >= _LOW_PERCENT:
        return
    at_ns = int(battery.stamp_ns[known[-1]])
    yield Finding.notice(
        "power.nearly_empty",
        f"{battery.name} had {left:.0f} % left at the end",
        (Evidence(battery.message, "RemPct", at_ns, None, f"{left:.0f} %"),),
        "Charge it before the next run. The figure assumes a full battery at the start.",
    )


def _falls_at_end(battery: BatteryLog) -> Iterator[Finding]:
    """A log that ends while the voltage breaks down: its writer lost power."""
    known = np.flatnonzero(np.isfinite(battery.voltage_v) & (battery.voltage_v > 0.0))
    if len(known) < 20:
        return
    usual, last = float(np.median(battery.voltage_v[known])), float(battery.voltage_v[known[-1]])
    if (
        usual < _NO_BATTERY_V
        or last > _FALL_V_SHARE * usual
        or battery.voltage_v[known[-1]] > battery.voltage_v[known[-2]]
    ):
        return
    at_ns = int(battery.stamp_ns[known[-1]])
    yield Finding.critical(
        "power.breakdown",
        f"The log ends with {battery.name} at {last:.2f} V and falling, where {usual:.2f} V are usual",
        (Evidence(battery.message, battery.voltage_field, at_ns, None, f"{last:.2f} V"),),
        "Check connectors and the battery: the supply broke down, and the log with it.",
    )


def resistance_ohm(stamp_ns: Stamps, voltage_v: Floats, current_a: Floats) -> float | None:
    """Slope of voltage over current between means of neighbouring seconds: differences cancel the discharge.

    None if the current hardly changes, or the voltage does not fall with it.
    """
    good = np.isfinite(voltage_v) & np.isfinite(current_a) & (voltage_v > 0.0)
    if np.count_nonzero(good) < 20:
        return None
    numbers_, place, count = np.unique(stamp_ns[good] // 1_000_000_000, return_inverse=True, return_counts=True)
    voltage = np.bincount(place, voltage_v[good]) / count
    current = np.bincount(place, current_a[good]) / count
    follow = np.diff(numbers_) == 1
    dv, di = np.diff(voltage)[follow], np.diff(current)[follow]
    if len(di) < 5 or float(np.abs(di).max()) < _LEAST_LOAD_A:
        return None
    slope = float(dv @ di) / float(di @ di)
    return -slope if slope < 0.0 else None


def _facts(battery: BatteryLog, parameters: Mapping[str, float]) -> tuple[Fact, ...]:
    voltage = battery.voltage_v[np.isfinite(battery.voltage_v) & (battery.voltage_v > 0.0)]
    facts = [
        Fact("voltage_first_v", "Voltage at the start", significant(float(voltage[0])), "V"),
        Fact("voltage_last_v", "Voltage at the end", significant(float(voltage[-1])), "V"),
        Fact("voltage_least_v", "Least voltage", significant(float(voltage.min())), "V"),
    ]
    if battery.current_a is not None and np.isfinite(battery.current_a).any():
        facts.append(Fact("current_most_a", "Largest current", significant(float(np.nanmax(battery.current_a))), "A"))
        facts.append(Fact("current_mean_a", "Mean current", significant(float(np.nanmean(battery.current_a))), "A"))
        estimated = resistance_ohm(battery.stamp_ns, battery.voltage_v, battery.current_a)
        facts.append(Fact("resistance_ohm", "Resistance from sag under load", significant(estimated, 3), "Ω"))
    used = None if battery.used_mah is None else battery.used_mah[np.isfinite(battery.used_mah)]
    if used is not None and len(used):
        facts.append(Fact("used_mah", "Used in this log", significant(float(used[-1] - used[0])), "mAh"))
        facts.append(
            Fact("time_left_min", "Lasts, at the last minute's current", _left_min(battery, parameters), "min")
        )
    return tuple(facts)


def _left_min(battery: BatteryLog, parameters: Mapping[str, float]) -> float | None:
    """Remaining minutes: capacity minus used charge, at the mean current of the last minute.

    None without a capacity or a current.
    """
    capacity = parameters.get(_prefix(battery) + "CAPACITY", 0.0)
    if capacity <= 0.0 or battery.used_mah is None or battery.current_a is None:
        return None
    used = battery.used_mah[np.isfinite(battery.used_mah)]
    last = battery.current_a[battery.stamp_ns >= battery.stamp_ns.max() - int(_END_S * 1e9)]
    last = last[np.isfinite(last)]
    if not len(used) or not len(last) or last.mean() <= 0.01:
        return None
    return significant(max(capacity - float(used[-1]), 0.0) * 1e-3 / float(last.mean()) * 60.0, 3)


def _grid(packs: list[BatteryLog]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for battery in packs:
        voltage = battery.voltage_v[np.isfinite(battery.voltage_v) & (battery.voltage_v > 0.0)]
        remaining = (
            None
            if battery.remaining_percent is None
            else battery.remaining_percent[np.isfinite(battery.remaining_percent)]
        )
        current = battery.current_a if battery.current_a is not None and np.isfinite(battery.current_a).any() else None
        own = (
            None
            if battery.resistance_ohm is None
            else battery.resistance_ohm[np.nan_to_num(battery.resistance_ohm) > 0.0]
        )
        rows.append(
            (
                battery.name,
                significant(float(voltage[0])),
                significant(float(voltage.min())),
                significant(float(voltage[-1])),
                None if current is None else significant(float(np.nanmean(current))),
                None if current is None else significant(float(np.nanmax(current))),
                None
                if current is None
                else significant(resistance_ohm(battery.stamp_ns, battery.voltage_v, current), 3),
                significant(float(np.median(own)), 3) if own is not None and len(own) else None,
                significant(float(remaining[-1])) if remaining is not None and len(remaining) else None,
            )
        )
    columns = ("battery", "first V", "least V", "last V", "mean A", "most A", "sag Ω", "autopilot's Ω", "left %")
    return Grid("batteries", "Batteries", columns, tuple(rows))


def _plots(packs: list[BatteryLog]) -> tuple[Plot, ...]:
    voltages = tuple(Trace(f"{battery.name} V", battery.stamp_ns, battery.voltage_v) for battery in packs[:4])
    currents = tuple(
        Trace(f"{battery.name} A", battery.stamp_ns, battery.current_a)
        for battery in packs[:4]
        if battery.current_a is not None
    )
    plots = [Plot("battery_voltage", "Battery voltage", "V", voltages)] if voltages else []
    if currents:
        plots.append(Plot("battery_current", "Battery current", "A", currents))
    return tuple(plots)
