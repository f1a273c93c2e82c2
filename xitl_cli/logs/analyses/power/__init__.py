"""Power: batteries against their failsafe levels, sag and resistance, what is left; the supply of the board."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.analyses.power.board import board
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.sensing.batteries import Battery, batteries
from xitl_cli.logs.sensing.columns import numbers, told
from xitl_cli.logs.sensing.settings import settings

_TITLE = "Power"
_ERR_BATTERY = 6
_LEAST_LOAD_A = 0.5  # spread of the current that a resistance can be told from
_LOW_PERCENT = 20.0
_FALL_V_SHARE = 0.8
_END_S = 60.0


def analyse(log: Log) -> Section | None:
    """None for a recording without batteries; a vehicle's log without them is told so."""
    instants = Instants(log)
    found = batteries(log)
    parameters = settings(log)
    supply = board(log, instants)
    if not found and supply is None and log.format == "mcap":
        return None
    findings = [finding for each in found for finding in _judged(each, parameters, instants)]
    findings += _failsafes(log, instants)
    facts: tuple[Fact, ...] = ()
    if found:
        facts = _facts(found[0], parameters)
    lacks = _lacks(found, parameters)
    plots: tuple[Plot, ...] = _plots(found)
    if supply is not None:
        findings += supply.findings
        facts, plots, lacks = (*facts, *supply.facts), (*plots, *supply.plots), [*lacks, *supply.lacks]
    return Section(
        "power",
        _TITLE,
        facts=facts,
        findings=tuple(findings),
        grids=(_grid(found),) if found else (),
        plots=plots,
        lacks=tuple(lacks),
    )


def _prefix(each: Battery) -> str:
    return "BATT_" if each.number == 1 else f"BATT{each.number}_"


def _judged(each: Battery, parameters: Mapping[str, float], instants: Instants) -> list[Finding]:
    findings: list[Finding] = []
    for name, severity, what in (("CRT_VOLT", Severity.CRITICAL, "critical"), ("LOW_VOLT", Severity.WARNING, "low")):
        limit = parameters.get(_prefix(each) + name, 0.0)
        span = _longest_under(each, limit) if limit > 0.0 else None
        timer_s = parameters.get(_prefix(each) + "LOW_TIMER", 10.0)
        if span is None:
            continue
        from_ns, until_ns, least = span
        length_s = (until_ns - from_ns) * 1e-9
        short = length_s < timer_s
        findings.append(
            Finding(
                "power.low",
                Severity.NOTICE if short else severity,
                f"{each.name} was under its {what} level of {limit:.2f} V for {length_s:.1f} s from "
                f"{instants.text(from_ns)}, down to {least:.2f} V"
                + (f", shorter than the failsafe waits ({timer_s:.0f} s)" if short else ""),
                (Evidence(each.message, each.voltage_field, from_ns, until_ns, f"{least:.2f} V"),),
                "Charge or replace the battery, or lower what it has to give; check the level against its cells.",
            )
        )
        break
    limit = parameters.get(_prefix(each) + "LOW_MAH", 0.0)
    capacity = parameters.get(_prefix(each) + "CAPACITY", 0.0)
    if each.used_mah is not None and limit > 0.0 and capacity > 0.0:
        under = np.flatnonzero(capacity - np.nan_to_num(each.used_mah) < limit)
        if len(under):
            at_ns = int(each.stamp_ns[under[0]])
            findings.append(
                Finding(
                    "power.used_up",
                    Severity.WARNING,
                    f"{each.name} had less than {limit:.0f} mAh of its {capacity:.0f} mAh left "
                    f"from {instants.text(at_ns)} on",
                    (Evidence(each.message, "CurrTot", at_ns),),
                    "Plan shorter runs or fit a larger battery.",
                )
            )
    findings += _nearly_empty(each)
    if each.healthy is not None and not each.healthy.all():
        bad = np.flatnonzero(~each.healthy)
        findings.append(
            Finding(
                "power.unhealthy",
                Severity.WARNING,
                f"The monitor of {each.name} was unhealthy in {len(bad)} of {len(each.healthy)} rows, first at "
                f"{instants.text(int(each.stamp_ns[bad[0]]))}",
                (Evidence(each.message, "H", int(each.stamp_ns[bad[0]]), int(each.stamp_ns[bad[-1]]), "0"),),
                "Check the wiring of the power module or the bus of the battery monitor.",
            )
        )
    findings += _falls_at_end(each)
    return findings


def _longest_under(each: Battery, limit_v: float) -> tuple[int, int, float] | None:
    """From, until and least voltage of the longest time under a level; rows of 0 V are no measurement."""
    with np.errstate(invalid="ignore"):
        under = (each.voltage_v < limit_v) & (each.voltage_v > 0.0)
    if not under.any():
        return None
    edges = np.flatnonzero(np.diff(np.concatenate(([False], under, [False])).astype(np.int8)))
    spans = [
        (int(each.stamp_ns[a]), int(each.stamp_ns[min(b, len(under) - 1)]), float(each.voltage_v[a:b].min()))
        for a, b in zip(edges[0::2], edges[1::2], strict=True)
    ]
    return max(spans, key=lambda span: span[1] - span[0])


def _nearly_empty(each: Battery) -> list[Finding]:
    if each.remaining_percent is None:
        return []
    known = np.flatnonzero(np.isfinite(each.remaining_percent))
    if not len(known) or not each.remaining_percent[known].any():
        return []
    left = float(each.remaining_percent[known[-1]])
    if left >= _LOW_PERCENT:
        return []
    at_ns = int(each.stamp_ns[known[-1]])
    return [
        Finding(
            "power.nearly_empty",
            Severity.NOTICE,
            f"{each.name} had {left:.0f} % left at the end",
            (Evidence(each.message, "RemPct", at_ns, None, f"{left:.0f} %"),),
            "Charge it before the next run; the figure counts from what the autopilot took for full at the start.",
        )
    ]


def _falls_at_end(each: Battery) -> list[Finding]:
    """A log that ends while the voltage breaks down: whoever wrote it went out with it."""
    known = np.flatnonzero(np.isfinite(each.voltage_v) & (each.voltage_v > 0.0))
    if len(known) < 20:
        return []
    usual, last = float(np.median(each.voltage_v[known])), float(each.voltage_v[known[-1]])
    if last > _FALL_V_SHARE * usual or each.voltage_v[known[-1]] > each.voltage_v[known[-2]]:
        return []
    at_ns = int(each.stamp_ns[known[-1]])
    return [
        Finding(
            "power.breakdown",
            Severity.CRITICAL,
            f"The log ends with {each.name} at {last:.2f} V and falling, where {usual:.2f} V are usual",
            (Evidence(each.message, each.voltage_field, at_ns, None, f"{last:.2f} V"),),
            "Check connectors and the battery: the supply broke down, and the log with it.",
        )
    ]


def _failsafes(log: Log, instants: Instants) -> list[Finding]:
    table = log.tables.get("ERR")
    if table is None:
        return []
    subsystems, codes = numbers(table, "Subsys", raw=True), numbers(table, "ECode", raw=True)
    if subsystems is None or codes is None:
        return []
    rows = np.flatnonzero((subsystems == _ERR_BATTERY) & (codes > 0))
    if not len(rows):
        return []
    at_ns = int(table.stamp_ns[rows[0]])
    return [
        Finding(
            "power.failsafe",
            Severity.WARNING,
            f"The battery failsafe acted, first at {instants.text(at_ns)}",
            tuple(Evidence("ERR", "ECode", int(table.stamp_ns[row]), None, str(int(codes[row]))) for row in rows[:8]),
            "See the voltage then and what BATT_FS_LOW_ACT and BATT_FS_CRT_ACT order.",
        )
    ]


def resistance_ohm(
    stamp_ns: NDArray[np.int64], voltage_v: NDArray[np.float64], current_a: NDArray[np.float64]
) -> float | None:
    """Slope of voltage over current between means of neighbouring seconds: differences, so that discharge cancels.

    None when the current hardly changes, or the voltage does not fall with it.
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
        Fact("voltage_first_v", "Voltage at the start", told(float(voltage[0])), "V"),
        Fact("voltage_last_v", "Voltage at the end", told(float(voltage[-1])), "V"),
        Fact("voltage_least_v", "Least voltage", told(float(voltage.min())), "V"),
    ]
    if each.current_a is not None and np.isfinite(each.current_a).any():
        facts.append(Fact("current_most_a", "Largest current", told(float(np.nanmax(each.current_a))), "A"))
        facts.append(Fact("current_mean_a", "Mean current", told(float(np.nanmean(each.current_a))), "A"))
        estimated = resistance_ohm(each.stamp_ns, each.voltage_v, each.current_a)
        facts.append(Fact("resistance_ohm", "Resistance from sag under load", told(estimated, 3), "Ω"))
    used = None if each.used_mah is None else each.used_mah[np.isfinite(each.used_mah)]
    if used is not None and len(used):
        facts.append(Fact("used_mah", "Used in this log", told(float(used[-1] - used[0])), "mAh"))
        facts.append(Fact("time_left_min", "Lasts, at the last minute's current", _left_min(each, parameters), "min"))
    return tuple(facts)


def _left_min(each: Battery, parameters: Mapping[str, float]) -> float | None:
    """Capacity less what is used, at the mean current of the last minute; None without a capacity or a current."""
    capacity = parameters.get(_prefix(each) + "CAPACITY", 0.0)
    if capacity <= 0.0 or each.used_mah is None or each.current_a is None:
        return None
    used = each.used_mah[np.isfinite(each.used_mah)]
    last = each.current_a[each.stamp_ns >= each.stamp_ns.max() - int(_END_S * 1e9)]
    last = last[np.isfinite(last)]
    if not len(used) or not len(last) or last.mean() <= 0.01:
        return None
    return told(max(capacity - float(used[-1]), 0.0) * 1e-3 / float(last.mean()) * 60.0, 3)


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
                told(float(voltage[0])),
                told(float(voltage.min())),
                told(float(voltage[-1])),
                None if current is None else told(float(np.nanmean(current))),
                None if current is None else told(float(np.nanmax(current))),
                None if current is None else told(resistance_ohm(each.stamp_ns, each.voltage_v, current), 3),
                told(float(np.median(own)), 3) if own is not None and len(own) else None,
                told(float(remaining[-1])) if remaining is not None and len(remaining) else None,
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


def _lacks(found: list[Battery], parameters: Mapping[str, float]) -> list[str]:
    if not found:
        return ["No battery is logged; set BATT_MONITOR, and the bit CURRENT of LOG_BITMASK."]
    lacks = []
    for each in found:
        if parameters and parameters.get(_prefix(each) + "LOW_VOLT", 0.0) <= 0.0:
            lacks.append(f"{each.name} has no low level ({_prefix(each)}LOW_VOLT is 0): its voltage cannot be judged.")
        if each.current_a is None or not np.nan_to_num(each.current_a).any():
            lacks.append(f"{each.name} measures no current.")
    return lacks
