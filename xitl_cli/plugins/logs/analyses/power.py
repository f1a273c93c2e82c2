"""Power: batteries against their failsafe levels, sag and resistance, remaining charge; the supply of the board.

According to ArduPilot's page on diagnosing with logs, 0.1 to 0.15 V of change of the board's supply is normal. A larger
change needs a check.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

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
class Battery:
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


def batteries(log: Log) -> list[Battery]:
    """Every instance that ever has a voltage. For telemetry, BATTERY_STATUS, or else SYS_STATUS."""
    found: list[Battery] = []
    for kinds in (("BAT", "BAT2"), ("CURR", "CUR2"), ("BATTERY_STATUS",), ("SYS_STATUS",)):
        for table in tables_of(log, kinds):
            for number, each in by_instance(table).items():
                read = _battery_from_telemetry if kinds[0].endswith("_STATUS") else _battery_from_log
                battery = read(table, each, number)
                if battery is not None and (np.nan_to_num(battery.voltage_v) > 0.0).any():
                    found.append(battery)
        if found:
            return found
    return found


def _battery_from_log(table: Table, each: Table, number: int) -> Battery | None:
    voltage = _measured(each, "Volt")
    if voltage is None or not np.isfinite(voltage).any():
        return None
    healthy = numbers(each, "H", raw=True)
    return Battery(
        name=instance_label(table, number),
        message=table.name,
        number=number + (2 if table.name.endswith("2") else 1),
        stamp_ns=bounded_stamps(each),
        voltage_v=voltage,
        voltage_field="Volt",
        current_a=_measured(each, "Curr"),
        used_mah=numbers(each, "CurrTot", raw=True),
        remaining_percent=numbers(each, "RemPct"),
        resistance_ohm=numbers(each, "Res"),
        healthy=None if healthy is None else healthy > 0.0,
    )


def _measured(each: Table, name: str) -> Floats | None:
    """(N,) in volts or amperes.

    Before 2016 (CURR of Copter 3.4), the values were hundredths in whole numbers, which no letter of the FMT shows.
    Since then they are floating point. Source: LogStructure.h of ArduPilot's releases.
    """
    values = numbers(each, name)
    if values is None or each.columns[name].unit or each.values(name, raw=True).dtype.kind not in "iu":
        return values
    return values * _HUNDREDTHS


def _battery_from_telemetry(table: Table, each: Table, number: int) -> Battery | None:
    """Battery from MAVLink: mV with 65535 unknown, cA and % with -1 unknown."""
    name = "voltages" if "voltages" in each.columns else "voltage_battery"
    millivolts = numbers(each, name, raw=True)
    if millivolts is None:
        return None
    cells = np.where(millivolts >= _UNKNOWN_MV, np.nan, millivolts).reshape(len(millivolts), -1)
    known = np.isfinite(cells).any(axis=1)
    current = numbers(each, "current_battery", raw=True)
    used = numbers(each, "current_consumed", raw=True)
    remaining = numbers(each, "battery_remaining", raw=True)
    return Battery(
        name=instance_label(table, number),
        message=table.name,
        number=number + 1,
        stamp_ns=bounded_stamps(each),
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
        lack = "The board's own voltage is not logged (POWR): its sensor may be missing."
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
            step = "Take servos and radios off the board's supply, or fit a stronger one."
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
            "Unplug peripherals one by one, or feed them from a supply of their own.",
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
    found = batteries(log)
    parameters = parameter_values(log)
    supply = board_section(log, clock)
    if not found and supply is None and log.of_topics:
        return None
    findings = [finding for each in found for finding in _judged(each, parameters, clock)]
    lacks: list[str] = []
    if not found:
        lacks.append("No battery is logged; set BATT_MONITOR, and the bit CURRENT of LOG_BITMASK.")
    else:
        for each in found:
            if parameters and parameters.get(_prefix(each) + "LOW_VOLT", 0.0) <= 0.0:
                lacks.append(
                    f"{each.name} has no low level ({_prefix(each)}LOW_VOLT is 0): its voltage cannot be judged."
                )
            if each.current_a is None or not np.nan_to_num(each.current_a).any():
                lacks.append(f"{each.name} measures no current.")
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
                "See the voltage then and what BATT_FS_LOW_ACT and BATT_FS_CRT_ACT order.",
            )
        )
    supplied = Section(
        "power",
        _TITLE,
        _facts(found[0], parameters) if found else (),
        (*findings, *failsafes),
        (_grid(found),) if found else (),
        _plots(found),
        tuple(lacks),
    )
    return Section.joined("power", _TITLE, (supplied, supply))


def _prefix(each: Battery) -> str:
    return "BATT_" if each.number == 1 else f"BATT{each.number}_"


def _judged(each: Battery, parameters: Mapping[str, float], clock: LogClock) -> Iterator[Finding]:
    for name, severity, what in (("CRT_VOLT", Severity.CRITICAL, "critical"), ("LOW_VOLT", Severity.WARNING, "low")):
        limit = parameters.get(_prefix(each) + name, 0.0)
        span = _longest_under(each, limit) if limit > 0.0 else None
        timer_s = parameters.get(_prefix(each) + "LOW_TIMER", 10.0)
        if span is None:
            continue
        from_ns, until_ns, least = span
        length_s = (until_ns - from_ns) * 1e-9
        short = length_s < timer_s
        yield Finding(
            "power.low",
            Severity.NOTICE if short else severity,
            f"{each.name} was under its {what} level of {limit:.2f} V for {length_s:.1f} s from "
            f"{clock.text(from_ns)}, down to {least:.2f} V"
            + (f", shorter than the failsafe waits ({timer_s:.0f} s)" if short else ""),
            (Evidence(each.message, each.voltage_field, from_ns, until_ns, f"{least:.2f} V"),),
            "Charge or replace the battery, or lower what it has to give; check the level against its cells.",
        )
        break
    limit = parameters.get(_prefix(each) + "LOW_MAH", 0.0)
    capacity = parameters.get(_prefix(each) + "CAPACITY", 0.0)
    if each.used_mah is not None and limit > 0.0 and capacity > 0.0:
        under = np.flatnonzero(capacity - np.nan_to_num(each.used_mah) < limit)
        if len(under):
            at_ns = int(each.stamp_ns[under[0]])
            yield Finding.warning(
                "power.used_up",
                f"{each.name} had less than {limit:.0f} mAh of its {capacity:.0f} mAh left from {clock.text(at_ns)} on",
                (Evidence(each.message, "CurrTot", at_ns),),
                "Plan shorter runs or fit a larger battery.",
            )
    yield from _nearly_empty(each)
    if each.healthy is not None and not each.healthy.all():
        bad = np.flatnonzero(~each.healthy)
        yield Finding.warning(
            "power.unhealthy",
            f"The monitor of {each.name} was unhealthy in {len(bad)} of {len(each.healthy)} rows, first at "
            f"{clock.text(int(each.stamp_ns[bad[0]]))}",
            tuple(Evidence(each.message, "H", a, b, "0") for a, b in spells(each.stamp_ns, ~each.healthy)),
            "Check the wiring of the power module or the bus of the battery monitor.",
        )
    yield from _falls_at_end(each)


def _longest_under(each: Battery, limit_v: float) -> tuple[int, int, float] | None:
    """Begin, end and least voltage of the longest time below a level. Rows of 0 V are not measurements."""
    with np.errstate(invalid="ignore"):
        under = (each.voltage_v < limit_v) & (each.voltage_v > 0.0)
    if not under.any():
        return None
    spans = zip(held_spans(each.stamp_ns, under), runs(under), strict=True)
    (from_ns, until_ns), (begin, after) = max(spans, key=lambda span: span[0][1] - span[0][0])
    return from_ns, until_ns, float(each.voltage_v[begin:after].min())


def _nearly_empty(each: Battery) -> Iterator[Finding]:
    if each.remaining_percent is None:
        return
    known = np.flatnonzero(np.isfinite(each.remaining_percent))
    if not len(known) or not each.remaining_percent[known].any():
        return
    left = float(each.remaining_percent[known[-1]])
    if left >= _LOW_PERCENT:
        return
    at_ns = int(each.stamp_ns[known[-1]])
    yield Finding.notice(
        "power.nearly_empty",
        f"{each.name} had {left:.0f} % left at the end",
        (Evidence(each.message, "RemPct", at_ns, None, f"{left:.0f} %"),),
        "Charge it before the next run; the figure counts from what the autopilot took for full at the start.",
    )


def _falls_at_end(each: Battery) -> Iterator[Finding]:
    """A log that ends while the voltage breaks down: its writer lost power."""
    known = np.flatnonzero(np.isfinite(each.voltage_v) & (each.voltage_v > 0.0))
    if len(known) < 20:
        return
    usual, last = float(np.median(each.voltage_v[known])), float(each.voltage_v[known[-1]])
    if usual < _NO_BATTERY_V or last > _FALL_V_SHARE * usual or each.voltage_v[known[-1]] > each.voltage_v[known[-2]]:
        return
    at_ns = int(each.stamp_ns[known[-1]])
    yield Finding.critical(
        "power.breakdown",
        f"The log ends with {each.name} at {last:.2f} V and falling, where {usual:.2f} V are usual",
        (Evidence(each.message, each.voltage_field, at_ns, None, f"{last:.2f} V"),),
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


def _facts(each: Battery, parameters: Mapping[str, float]) -> tuple[Fact, ...]:
    voltage = each.voltage_v[np.isfinite(each.voltage_v) & (each.voltage_v > 0.0)]
    facts = [
        Fact("voltage_first_v", "Voltage at the start", significant(float(voltage[0])), "V"),
        Fact("voltage_last_v", "Voltage at the end", significant(float(voltage[-1])), "V"),
        Fact("voltage_least_v", "Least voltage", significant(float(voltage.min())), "V"),
    ]
    if each.current_a is not None and np.isfinite(each.current_a).any():
        facts.append(Fact("current_most_a", "Largest current", significant(float(np.nanmax(each.current_a))), "A"))
        facts.append(Fact("current_mean_a", "Mean current", significant(float(np.nanmean(each.current_a))), "A"))
        estimated = resistance_ohm(each.stamp_ns, each.voltage_v, each.current_a)
        facts.append(Fact("resistance_ohm", "Resistance from sag under load", significant(estimated, 3), "Ω"))
    used = None if each.used_mah is None else each.used_mah[np.isfinite(each.used_mah)]
    if used is not None and len(used):
        facts.append(Fact("used_mah", "Used in this log", significant(float(used[-1] - used[0])), "mAh"))
        facts.append(Fact("time_left_min", "Lasts, at the last minute's current", _left_min(each, parameters), "min"))
    return tuple(facts)


def _left_min(each: Battery, parameters: Mapping[str, float]) -> float | None:
    """Remaining minutes: capacity minus used charge, at the mean current of the last minute.

    None without a capacity or a current.
    """
    capacity = parameters.get(_prefix(each) + "CAPACITY", 0.0)
    if capacity <= 0.0 or each.used_mah is None or each.current_a is None:
        return None
    used = each.used_mah[np.isfinite(each.used_mah)]
    last = each.current_a[each.stamp_ns >= each.stamp_ns.max() - int(_END_S * 1e9)]
    last = last[np.isfinite(last)]
    if not len(used) or not len(last) or last.mean() <= 0.01:
        return None
    return significant(max(capacity - float(used[-1]), 0.0) * 1e-3 / float(last.mean()) * 60.0, 3)


def _grid(found: list[Battery]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for each in found:
        voltage = each.voltage_v[np.isfinite(each.voltage_v) & (each.voltage_v > 0.0)]
        remaining = (
            None if each.remaining_percent is None else each.remaining_percent[np.isfinite(each.remaining_percent)]
        )
        current = each.current_a if each.current_a is not None and np.isfinite(each.current_a).any() else None
        own = None if each.resistance_ohm is None else each.resistance_ohm[np.nan_to_num(each.resistance_ohm) > 0.0]
        rows.append(
            (
                each.name,
                significant(float(voltage[0])),
                significant(float(voltage.min())),
                significant(float(voltage[-1])),
                None if current is None else significant(float(np.nanmean(current))),
                None if current is None else significant(float(np.nanmax(current))),
                None if current is None else significant(resistance_ohm(each.stamp_ns, each.voltage_v, current), 3),
                significant(float(np.median(own)), 3) if own is not None and len(own) else None,
                significant(float(remaining[-1])) if remaining is not None and len(remaining) else None,
            )
        )
    columns = ("battery", "first V", "least V", "last V", "mean A", "most A", "sag Ω", "autopilot's Ω", "left %")
    return Grid("batteries", "Batteries", columns, tuple(rows))


def _plots(found: list[Battery]) -> tuple[Plot, ...]:
    voltages = tuple(Trace(f"{each.name} V", each.stamp_ns, each.voltage_v) for each in found[:4])
    currents = tuple(
        Trace(f"{each.name} A", each.stamp_ns, each.current_a) for each in found[:4] if each.current_a is not None
    )
    plots = [Plot("battery_voltage", "Battery voltage", "V", voltages)] if voltages else []
    if currents:
        plots.append(Plot("battery_current", "Battery current", "A", currents))
    return tuple(plots)
