"""Power: sentences, evidence and figures at each limit, and batteries of every kind of log."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.plugins.logs.analyses.power import analyse, batteries, resistance_ohm

S = 1_000_000_000
ROWS = 100
STAMPS = np.arange(ROWS) * S


def bat(name: str = "BAT", /, **columns: Any) -> MadeTable:
    every = {"Volt": 12.0, "Curr": 5.0} | columns
    return MadeTable(name, STAMPS, {key: np.broadcast_to(value, ROWS) for key, value in every.items()})


def parameters(**values: float) -> MadeTable:
    return MadeTable(
        "PARM", np.zeros(len(values), int), {"Name": np.array(list(values)), "Value": list(values.values())}
    )


def section_of(*tables: MadeTable, kind: Any = "dataflash") -> Section:
    section = analyse(MadeLog(*tables, kind=kind))
    assert section is not None
    return section


def found(*tables: MadeTable, kind: Any = "dataflash") -> dict[str, Finding]:
    return {one.key: one for one in section_of(*tables, kind=kind).findings}


def at(from_row: int, until_row: int, inside: float, outside: float = 12.0) -> np.ndarray:
    values = np.full(ROWS, outside)
    values[from_row:until_row] = inside
    return values


# Batteries by kind of log


def test_batteries_of_ardupilot() -> None:
    tables = [
        bat(CurrTot=np.arange(ROWS), RemPct=50.0, Res=0.02, H=at(5, 6, 0, 1)), bat("BAT2", Volt=24.0),
        bat("CURR", Volt=1.0),
    ]  # fmt: skip
    first, second = batteries(MadeLog(*tables))
    assert (first.name, first.number, first.message, first.voltage_field) == ("BAT", 1, "BAT", "Volt")
    assert (second.name, second.number) == ("BAT2", 2)
    assert first.healthy is not None
    assert np.flatnonzero(~first.healthy).tolist() == [5]
    assert batteries(MadeLog(bat(Volt=0.0))) == []


def test_hundredths_of_old_logs() -> None:
    (old,) = batteries(
        MadeLog(MadeTable("CURR", [1, 2], {"Volt": np.array([1200, 1190]), "Curr": np.array([550, 560])}))
    )
    assert old.voltage_v == pytest.approx([12.0, 11.9])
    assert old.current_a == pytest.approx([5.5, 5.6])
    stated = MadeTable(
        "CURR", [1, 2], {"Volt": np.array([12, 11]), "Curr": np.array([5, 6])}, units={"Volt": "V", "Curr": "A"}
    )
    assert batteries(MadeLog(stated))[0].voltage_v.tolist() == [12, 11]


def test_batteries_of_telemetry() -> None:
    cells = np.array([[4000, 4100, 65535], [65535, 65535, 65535], [3900, 65535, 65534]])
    status = MadeTable(
        "BATTERY_STATUS", [1, 2, 3],
        {"voltages": cells, "current_battery": [-1, 250, 0], "current_consumed": [-1, 70, 0],
        "battery_remaining": [-1, 0, 99]},
    )  # fmt: skip
    (one,) = batteries(MadeLog(status, kind="tlog"))
    np.testing.assert_allclose(one.voltage_v, [8.1, np.nan, 69.434])
    np.testing.assert_array_equal(one.current_a, [np.nan, 2.5, 0.0])
    np.testing.assert_array_equal(one.used_mah, [np.nan, 70, 0])
    np.testing.assert_array_equal(one.remaining_percent, [np.nan, 0, 99])
    (sys,) = batteries(MadeLog(MadeTable("SYS_STATUS", [1, 2], {"voltage_battery": [12_000, 65_535]}), kind="tlog"))
    np.testing.assert_array_equal(sys.voltage_v, [12.0, np.nan])
    assert (sys.number, sys.current_a, sys.voltage_field) == (1, None, "voltage_battery")


# Levels


LEVELS = {"BATT_LOW_VOLT": 10.5, "BATT_CRT_VOLT": 10.0, "BATT_LOW_TIMER": 10.0}


@pytest.mark.parametrize(
    ("volts", "severity", "sentence"),
    [
        (
            at(40, 50, 10.2), Severity.WARNING,
            "BAT was under its low level of 10.50 V for 10.0 s from 0:40.0, down to 10.20 V",
        ),
        (
            at(40, 49, 10.2), Severity.NOTICE,
            "BAT was under its low level of 10.50 V for 9.0 s from 0:40.0, down to 10.20 V, shorter than the failsafe "
            "waits (10 s)",
        ),
        (
            at(40, 50, 9.9), Severity.CRITICAL,
            "BAT was under its critical level of 10.00 V for 10.0 s from 0:40.0, down to 9.90 V",
        ),
        (at(40, 50, 10.0), Severity.WARNING,
         "BAT was under its low level of 10.50 V for 10.0 s from 0:40.0, down to 10.00 V"),
        (at(40, 50, 10.5), None, ""),
        (at(40, 50, 0.0), None, ""),
    ],
)  # fmt: skip
def test_a_voltage_under_a_level(volts: np.ndarray, severity: Severity | None, sentence: str) -> None:
    finding = found(bat(Volt=volts), parameters(**LEVELS)).get("power.low")
    assert (finding is None) == (severity is None)
    if finding is not None:
        assert (finding.severity, finding.sentence) == (severity, sentence)
        assert finding.evidence[0].at_ns == 40 * S


def test_the_longest_time_under_a_level_is_told() -> None:
    volts = np.minimum(at(10, 22, 10.2), at(60, 75, 10.3))
    finding = found(bat(Volt=volts), parameters(**LEVELS))["power.low"]
    assert finding.evidence == (Evidence("BAT", "Volt", 60 * S, 75 * S, "10.30 V"),)


def test_each_battery_has_its_own_levels() -> None:
    second = {"BATT2_LOW_VOLT": 11.0}
    finding = found(bat(), bat("BAT2", Volt=at(40, 60, 10.9)), parameters(**LEVELS, **second))["power.low"]
    assert finding.sentence.startswith("BAT2 was under its low level of 11.00 V for 20.0 s")
    lacks = section_of(bat(), bat("BAT2", Curr=0.0), parameters(**LEVELS)).lacks
    assert lacks[:2] == (
        "BAT2 has no low level (BATT2_LOW_VOLT is 0): its voltage cannot be judged.", "BAT2 measures no current.",
    )  # fmt: skip


@pytest.mark.parametrize(("capacity", "told"), [(1098.0, True), (1099.0, False)])
def test_a_charge_that_is_used_up(capacity: float, told: bool) -> None:
    finding = found(
        bat(CurrTot=np.arange(ROWS) * 10.0), parameters(BATT_LOW_VOLT=1.0, BATT_LOW_MAH=109.0, BATT_CAPACITY=capacity)
    ).get("power.used_up")
    assert (finding is not None) is told
    if finding is not None:
        assert finding.sentence == "BAT had less than 109 mAh of its 1098 mAh left from 1:39.0 on"
        assert finding.evidence == (Evidence("BAT", "CurrTot", 99 * S),)


@pytest.mark.parametrize(("last", "told"), [(19.9, True), (20.0, False), (np.nan, False)])
def test_a_battery_nearly_empty(last: float, told: bool) -> None:
    remaining = np.append(np.full(ROWS - 1, 50.0), last)
    finding = found(bat(RemPct=remaining)).get("power.nearly_empty")
    assert (finding is not None) is told
    if finding is not None:
        assert finding.sentence == "BAT had 20 % left at the end"
        assert finding.evidence == (Evidence("BAT", "RemPct", 99 * S, None, "20 %"),)
    assert "power.nearly_empty" not in found(bat(RemPct=0.0))  # never known


@pytest.mark.parametrize(
    ("ends", "usual", "told"),
    [
        ([9.7, 9.6], 12.0, True),
        ([9.5, 9.61], 12.0, False),
        ([9.5, 9.6], 12.0, False),  # it rises
        ([9.6, 9.6], 12.0, True),
        ([9.7, 0.0], 12.0, False),
        ([2.0, 1.0], 2.9, False),  # no battery
    ],
)
def test_a_log_that_ends_in_a_breakdown(ends: list[float], usual: float, told: bool) -> None:
    finding = found(bat(Volt=np.append(np.full(ROWS - 2, usual), ends))).get("power.breakdown")
    assert (finding is not None) is told
    if finding is not None:
        assert finding.sentence == "The log ends with BAT at 9.60 V and falling, where 12.00 V are usual"


def test_a_monitor_that_fails() -> None:
    finding = found(bat(H=at(30, 34, 0.0, 1.0)))["power.unhealthy"]
    assert finding.sentence == "The monitor of BAT was unhealthy in 4 of 100 rows, first at 0:30.0"
    assert finding.evidence == (Evidence("BAT", "H", 30 * S, 33 * S, "0"),)


def test_the_failsafe_that_acted() -> None:
    errors = MadeTable("ERR", S * np.array([20, 40, 50]), {"Subsys": [6, 6, 5], "ECode": [0, 2, 1]})
    finding = found(bat(), errors)["power.failsafe"]
    assert finding.sentence == "The battery failsafe acted, first at 0:40.0"
    assert finding.evidence == (Evidence("ERR", "ECode", 40 * S, None, "2"),)


# Figures


def test_figures_of_a_battery() -> None:
    current = np.where(np.arange(ROWS) % 20 < 10, 2.0, 6.0)
    volts = 12.6 - 0.05 * current
    volts[0] = 0.0
    volts[-1] = np.nan
    used = np.append(100.0 + np.arange(ROWS - 1), np.nan)
    section = section_of(
        bat(
            Volt=volts,
            Curr=current,
            CurrTot=used,
            RemPct=np.append(np.full(99, 77.0), np.nan),
            Res=at(0, 50, 0.0, 0.04),
        ),
        parameters(BATT_LOW_VOLT=1.0, BATT_CAPACITY=1198.0),
    )
    assert {fact.key: fact.value for fact in section.facts} == {
        "voltage_first_v": 12.5, "voltage_last_v": 12.3, "voltage_least_v": 12.3, "current_most_a": 6.0,
        "current_mean_a": 4.0, "resistance_ohm": 0.05, "used_mah": 98.0,
        # 1 Ah at the mean of the last 61 rows: 30 of 2 A, and 31 of 6 A.
        "time_left_min": pytest.approx(60.0 / ((30 * 6.0 + 31 * 2.0) / 61.0), rel=0.05),
    }  # fmt: skip
    (row,) = section.grids[0].rows
    assert row == ("BAT", 12.5, 12.3, 12.3, 4.0, 6.0, 0.05, 0.04, 77.0)
    voltage, amperes = section.plots
    assert (voltage.y_label, amperes.y_label, amperes.traces[0].y.tolist()) == ("V", "A", current.tolist())


@pytest.mark.parametrize(
    ("capacity", "current", "known"), [(0.0, 5.0, False), (1000.0, 0.009, False), (1000.0, 0.02, True)]
)
def test_a_time_left_needs_a_capacity_and_a_current(capacity: float, current: float, known: bool) -> None:
    section = section_of(bat(CurrTot=100.0, Curr=current), parameters(BATT_LOW_VOLT=1.0, BATT_CAPACITY=capacity))
    value = {fact.key: fact.value for fact in section.facts}["time_left_min"]
    assert (value is not None) is known
    assert value in (None, 2700.0)  # 0.9 Ah at 20 mA


def test_a_resistance_is_that_of_neighbouring_seconds() -> None:
    stamps = np.repeat(np.arange(30), 2) * S + np.tile([0, S // 2], 30)
    current = np.repeat(np.where(np.arange(30) % 2, 3.0, 1.0), 2)
    volts = 12.0 - 0.1 * current - 0.001 * np.arange(60)
    assert resistance_ohm(stamps, volts, current) == pytest.approx(0.1, rel=0.01)
    assert resistance_ohm(stamps, -volts + 24.0, current) is None  # a voltage that rises with the current
    assert resistance_ohm(stamps, volts, 1.0 + 0.24 * (current - 1.0)) is None  # 0.48 A
    assert resistance_ohm(stamps, volts, 1.0 + 0.25 * (current - 1.0)) is not None
    assert resistance_ohm(stamps[:19], volts[:19], current[:19]) is None
    assert resistance_ohm(stamps[:20], volts[:20], current[:20]) is not None
    assert resistance_ohm(stamps * 4, volts, current) is None  # no neighbouring seconds


# The board


def board(vcc: Any, flags: Any = None, name: str = "POWR", **more: Any) -> MadeTable:
    columns = {"Vcc": np.broadcast_to(vcc, ROWS)} | ({} if flags is None else {"Flags": np.broadcast_to(flags, ROWS)})
    return MadeTable(name, STAMPS, columns | more)


@pytest.mark.parametrize(
    ("vcc", "key", "sentence"),
    [
        (at(40, 41, 4.59, 5.0), "power.brown_out",
         "The board's supply fell to 4.59 V at 0:40.0; under 4.6 V a brown-out is near"),
        (at(40, 41, 4.6, 5.0), "power.supply_changes", "The board's supply changed by 0.40 V, from 4.60 to 5.00 V"),
        (at(40, 41, 4.75, 5.0), None, ""),
        (at(40, 41, 0.9, 5.0), None, ""),  # no measurement
        (at(40, 41, 4590, 5000), "power.brown_out",
         "The board's supply fell to 4.59 V at 0:40.0; under 4.6 V a brown-out is near"),
    ],
)  # fmt: skip
def test_the_supply_of_the_board(vcc: np.ndarray, key: str | None, sentence: str) -> None:
    findings = found(bat(), board(vcc))
    assert {key: one.sentence for key, one in findings.items()} == ({key: sentence} if key else {})
    if key:
        assert findings[key].evidence[0].at_ns == 40 * S


def test_a_supply_without_its_voltage_is_not_judged() -> None:
    section = section_of(bat(), MadeTable("POWR", STAMPS, {"VServo": np.full(ROWS, 5.0)}))
    assert (section.findings, "board_least_v" in {fact.key for fact in section.facts}) == ((), False)


def test_flags_of_the_supply() -> None:
    flags = np.ones(ROWS, dtype=int)
    flags[20:23] = 1 | 16
    flags[50:60] = 2
    flags[70:] = 0
    findings = found(bat(), board(5.0, flags))
    assert (
        findings["power.overcurrent"].sentence == "The board's supply for peripherals was overloaded, first at 0:20.0"
    )
    assert findings["power.overcurrent"].evidence == (Evidence("POWR", "Flags", 20 * S, 22 * S, "17"),)
    assert findings["power.input_lost"].sentence == "The main supply of the board failed 2 times, first at 0:50.0"
    assert [one.at_ns for one in findings["power.input_lost"].evidence] == [50 * S, 70 * S]
    only = found(bat(), board(0.0, flags))
    assert set(only) == {"power.overcurrent", "power.input_lost"}


@pytest.mark.parametrize(("degc", "hot"), [(85.0, False), (85.1, True)])
def test_a_hot_processor(degc: float, hot: bool) -> None:
    section = section_of(bat(), MadeTable("MCU", STAMPS, {"MTemp": at(30, 31, degc, 40.0)}))
    assert {fact.key: fact.value for fact in section.facts}["processor_hottest_degc"] == degc
    assert [one.sentence for one in section.findings] == (
        ["The processor of the board was at 85 °C at 0:30.0"] if hot else []
    )
