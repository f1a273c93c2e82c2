"""Batteries and the supply of the board with troubles that were put there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Section, Severity
from xitl_cli.plugins.logs.analyses.power import analyse

S = 1_000_000_000
ROWS = 1200
STAMPS = np.arange(ROWS) * S // 10
RESISTANCE = 0.05


def load() -> np.ndarray:
    """Amperes: on for three seconds in six."""
    return np.where(np.arange(ROWS) // 30 % 2, 20.0, 2.0)


def bat(**changed: Any) -> MadeTable:
    current = load()
    columns = {"Volt": 12.6 - 0.002 * np.arange(ROWS) / 10.0 - RESISTANCE * current, "Curr": current,
               "CurrTot": np.cumsum(current) / 36.0, "RemPct": np.linspace(100.0, 90.0, ROWS)} | changed  # fmt: skip
    return MadeTable("BAT", STAMPS, columns)


def parameters(**values: float) -> MadeTable:
    return MadeTable("PARM", np.zeros(len(values)), {"Name": list(values), "Value": list(values.values())})


def report(*tables: MadeTable) -> Section:
    section = analyse(MadeLog(*tables))
    assert section is not None
    return section


def found(section: Section) -> dict[str, Severity]:
    return {finding.key: finding.severity for finding in section.findings}


def facts(section: Section) -> dict[str, Any]:
    return {fact.key: fact.value for fact in section.facts}


def test_a_healthy_battery_and_its_figures():
    section = report(bat(), parameters(BATT_LOW_VOLT=10.5, BATT_CAPACITY=3300.0))
    assert found(section) == {}
    told = facts(section)
    # Means of whole seconds leave the steps whole; the discharge of 2 mV a second is a hundredth of a step's 0.9 V.
    assert told["resistance_ohm"] == pytest.approx(RESISTANCE, rel=0.02)
    assert told["current_mean_a"] == pytest.approx(11.0)
    assert told["used_mah"] == pytest.approx(11.0 * 119.9 / 3.6, rel=1e-3)
    used_mah = 11.0 * 120.0 / 3.6
    assert told["time_left_min"] == pytest.approx((3300.0 - used_mah) * 60e-3 / 11.0, rel=0.02)


@pytest.mark.parametrize(
    ("least", "rows", "expected"),
    [
        (10.6, 300, {}),
        (10.2, 300, {"power.low": Severity.WARNING}),
        (10.2, 50, {"power.low": Severity.NOTICE}),
        (9.5, 300, {"power.low": Severity.CRITICAL}),
    ],
)
def test_voltage_under_a_failsafe_level(least, rows, expected):
    voltage = np.full(ROWS, 12.0)
    voltage[400 : 400 + rows] = least
    levels = parameters(BATT_LOW_VOLT=10.5, BATT_CRT_VOLT=10.0, BATT_LOW_TIMER=10.0)
    section = report(bat(Volt=voltage), levels)
    assert found(section) == expected
    if expected:
        evidence = section.findings[0].evidence[0]
        assert (evidence.at_ns, evidence.until_ns) == (40 * S, (40 + rows // 10) * S)


def test_rows_of_no_voltage_are_no_measurement():
    voltage = np.full(ROWS, 12.0)
    voltage[:300] = 0.0
    section = report(bat(Volt=voltage), parameters(BATT_LOW_VOLT=10.5))
    assert found(section) == {}
    assert facts(section)["voltage_least_v"] == 12.0


def test_a_log_that_ends_with_the_voltage_breaking_down():
    voltage = np.full(ROWS, 12.0)
    voltage[-3:] = (11.0, 9.0, 6.0)
    assert found(report(bat(Volt=voltage))) == {"power.breakdown": Severity.CRITICAL}


def test_a_monitor_that_fails_and_a_battery_nearly_empty():
    health = np.ones(ROWS)
    health[700:] = 0
    section = report(bat(H=health, RemPct=np.linspace(40.0, 10.0, ROWS)))
    assert found(section) == {"power.unhealthy": Severity.WARNING, "power.nearly_empty": Severity.NOTICE}


def test_the_failsafe_of_the_autopilot():
    errors = MadeTable("ERR", [50 * S], {"Subsys": [6], "ECode": [1]})
    section = report(bat(), errors)
    assert found(section) == {"power.failsafe": Severity.WARNING}
    assert section.findings[0].evidence[0].at_ns == 50 * S


def powr(voltage: np.ndarray, flags: np.ndarray | None = None) -> MadeTable:
    return MadeTable("POWR", STAMPS, {"Vcc": voltage, "Flags": np.ones(ROWS, int) if flags is None else flags})


def test_the_board_s_supply():
    steady = 5.1 + 0.03 * np.sin(np.arange(ROWS))
    assert found(report(bat(), powr(steady))) == {}
    sagging = steady.copy()
    sagging[600:620] = 4.75
    assert found(report(bat(), powr(sagging))) == {"power.supply_changes": Severity.NOTICE}
    sagging[610] = 4.3
    section = report(bat(), powr(sagging))
    assert found(section) == {"power.brown_out": Severity.WARNING}
    assert section.findings[0].evidence[0].at_ns == 61 * S
    flags = np.ones(ROWS, dtype=int)
    flags[300:310] = 1 | 8
    flags[800:] = 4
    found_flags = found(report(bat(), powr(steady, flags)))
    assert found_flags == {"power.overcurrent": Severity.WARNING, "power.input_lost": Severity.WARNING}


def test_telemetry_in_millivolts():
    cells = np.full((ROWS, 10), 65535)
    cells[:, 0] = 12_500
    table = MadeTable(
        "BATTERY_STATUS",
        STAMPS,
        {"voltages": cells, "current_battery": np.full(ROWS, 490), "current_consumed": np.full(ROWS, -1),
         "battery_remaining": np.full(ROWS, -1)},
    )  # fmt: skip
    section = analyse(MadeLog(table, MadeTable("POWER_STATUS", STAMPS, {"Vcc": np.full(ROWS, 5000)}), kind="tlog"))
    assert section is not None
    assert found(section) == {}
    told = facts(section)
    assert (told["voltage_first_v"], told["current_mean_a"], told["board_least_v"]) == (12.5, 4.9, 5.0)
    assert "used_mah" not in told


def test_what_is_not_logged_is_said():
    assert "BATT_MONITOR" in report().lacks[0]
    assert any("LOW_VOLT" in lack for lack in report(bat(), parameters(BATT_CAPACITY=1.0)).lacks)
    assert analyse(MadeLog(kind="mcap")) is None
