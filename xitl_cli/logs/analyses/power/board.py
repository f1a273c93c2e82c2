"""The supply of the board itself: its voltage, flags of the power inputs, the processor's own monitor.

ArduPilot's page on diagnosing with logs takes 0.1 to 0.15 V of change for normal and more for a reason to look.
"""

from __future__ import annotations

import numpy as np

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Plot, Section, Severity, Trace
from xitl_cli.logs.sensing.columns import numbers, tables_of, told

LEAST_V = 4.6
CHANGE_V = 0.25
HOT_DEGC = 85.0
_BRICK, _OVERCURRENT = 1, 8 | 16
_MEASURED_V = 1.0


def board(log: Log, instants: Instants) -> Section | None:
    """None where nothing of the board's supply is logged."""
    parts = [part for part in (_supply(log, instants), _processor(log, instants)) if part is not None]
    if not parts:
        if log.format != "dataflash":
            return None
        return Section(
            "power", "Power", lacks=("The board's own voltage is not logged (POWR): its sensor may be missing.",)
        )
    return Section(
        "power",
        "Power",
        facts=tuple(fact for part in parts for fact in part.facts),
        findings=tuple(finding for part in parts for finding in part.findings),
        plots=tuple(plot for part in parts for plot in part.plots),
    )


def _supply(log: Log, instants: Instants) -> Section | None:
    for table in tables_of(log, ("POWR", "POWER_STATUS")):
        told_mv = numbers(table, "Vcc", raw=True)
        if told_mv is None or not len(table):
            continue
        # POWER_STATUS is in whole millivolts, as POWR once was; since then POWR is in volts.
        voltage = told_mv * 1e-3 if np.nanmax(np.nan_to_num(told_mv)) > 100.0 else told_mv
        findings: list[Finding] = []
        flags = numbers(table, "Flags", raw=True) if "Flags" in table.columns else numbers(table, "flags", raw=True)
        if flags is not None:
            bits = np.nan_to_num(flags).astype(np.int64)
            field = "Flags" if "Flags" in table.columns else "flags"
            over = np.flatnonzero((bits & _OVERCURRENT) != 0)
            if len(over):
                at_ns = int(table.stamp_ns[over[0]])
                findings.append(
                    Finding(
                        "power.overcurrent",
                        Severity.WARNING,
                        f"The board's supply for peripherals was overloaded, first at {instants.text(at_ns)}",
                        (Evidence(table.name, field, at_ns, int(table.stamp_ns[over[-1]]), str(int(bits[over[0]]))),),
                        "Unplug peripherals one by one, or feed them from a supply of their own.",
                    )
                )
            lost = np.flatnonzero(((bits[:-1] & _BRICK) != 0) & ((bits[1:] & _BRICK) == 0)) + 1
            if len(lost):
                at_ns = int(table.stamp_ns[lost[0]])
                findings.append(
                    Finding(
                        "power.input_lost",
                        Severity.WARNING,
                        f"The main supply of the board failed {len(lost)} times, first at {instants.text(at_ns)}",
                        tuple(Evidence(table.name, field, int(table.stamp_ns[row])) for row in lost[:8]),
                        "Check the power module and its plug; something else fed the board meanwhile.",
                    )
                )
        measured = np.nan_to_num(voltage) > _MEASURED_V
        if not measured.any():
            return Section("power", "Power", findings=tuple(findings)) if findings else None
        levels, stamps = voltage[measured], table.stamp_ns[measured]
        lowest = int(np.argmin(levels))
        least, most = float(levels.min()), float(levels.max())
        if least < LEAST_V:
            findings.append(
                Finding(
                    "power.brown_out",
                    Severity.WARNING,
                    f"The board's supply fell to {least:.2f} V at {instants.text(int(stamps[lowest]))}; "
                    f"under {LEAST_V} V a brown-out is near",
                    (Evidence(table.name, "Vcc", int(stamps[lowest]), None, f"{least:.2f} V"),),
                    "Take servos and radios off the board's supply, or fit a stronger one.",
                )
            )
        elif most - least > CHANGE_V:
            findings.append(
                Finding(
                    "power.supply_changes",
                    Severity.NOTICE,
                    f"The board's supply changed by {most - least:.2f} V, from {least:.2f} to {most:.2f} V",
                    (Evidence(table.name, "Vcc", int(stamps[lowest]), None, f"{least:.2f} V"),),
                    "See whether it follows the throttle or the servos: the supply is weak or shared.",
                )
            )
        return Section(
            "power",
            "Power",
            facts=(
                Fact("board_least_v", "Board supply, least", told(least), "V"),
                Fact("board_most_v", "Board supply, most", told(most), "V"),
            ),
            findings=tuple(findings),
            plots=(Plot("board_voltage", "Supply of the board", "V", (Trace("Vcc", stamps, levels),)),),
        )
    return None


def _processor(log: Log, instants: Instants) -> Section | None:
    table = log.tables.get("MCU")
    warmth = None if table is None else numbers(table, "MTemp")
    if table is None or warmth is None or not np.isfinite(warmth).any():
        return None
    hottest = int(np.nanargmax(warmth))
    findings = []
    if warmth[hottest] > HOT_DEGC:
        findings.append(
            Finding(
                "power.hot",
                Severity.NOTICE,
                f"The processor of the board was at {warmth[hottest]:.0f} °C "
                f"at {instants.text(int(table.stamp_ns[hottest]))}",
                (Evidence("MCU", "MTemp", int(table.stamp_ns[hottest]), None, f"{warmth[hottest]:.0f} °C"),),
                "Shade or cool the case: sensors drift with it.",
            )
        )
    fact = Fact("processor_hottest_degc", "Processor of the board, hottest", told(float(warmth[hottest])), "°C")
    return Section("power", "Power", facts=(fact,), findings=tuple(findings))
