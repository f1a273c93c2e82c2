"""Events, texts, modes, parameters and sags of a battery: sentences and evidence at each limit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.plugins.logs.analyses import actuation, events, modes, parameters
from xitl_cli.plugins.logs.analyses.actuation import battery_sags
from xitl_cli.plugins.logs.analyses.events import ErrorSpan, error_spans, reported_troubles
from xitl_cli.plugins.logs.analyses.parameters import ParameterChange, parameter_changes

S = 1_000_000_000
END = MadeTable("ATT", [0, 100 * S], {"Roll": [0.0, 0.0]})
VERSION = MadeTable("VER", [0], {"BU": [1]})


def ns(at_s: Any) -> np.ndarray:
    return np.round(np.asarray(at_s, dtype=np.float64) * S).astype(np.int64)


def errors(*rows: tuple[float, int, int]) -> MadeTable:
    at, subsystem, code = zip(*rows, strict=True)
    return MadeTable("ERR", ns(at), {"Subsys": subsystem, "ECode": code})


def said(*rows: tuple[float, str]) -> MadeTable:
    return MadeTable("MSG", ns([at for at, _ in rows]), {"Message": [text for _, text in rows]})


def armed(*at_s: float) -> MadeTable:
    return MadeTable("ARM", ns(at_s), {"ArmState": [(place + 1) % 2 for place in range(len(at_s))]})


def told(analyse: Any, *tables: MadeTable, **of: Any) -> Section:
    section = analyse(MadeLog(*tables, END, VERSION, **of))
    assert section is not None
    return section  # type: ignore[no-any-return]


def found(*tables: MadeTable) -> dict[str, Finding]:
    return {one.key: one for one in told(events.analyse, *tables).findings}


# Errors


def test_errors_last_until_their_zero() -> None:
    rows = [(1, 16, 0), (2, 16, 2), (3, 16, 1), (5, 16, 0), (6, 17, 1), (7, 12, 1), (8, 12, 1)]
    assert error_spans(rows) == [
        ErrorSpan(16, 2, 2, 5), ErrorSpan(17, 1, 6, None), ErrorSpan(12, 1, 7, None), ErrorSpan(12, 1, 8, None),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("rows", "arm", "severity", "ending"),
    [
        ([(30, 16, 2)], True, Severity.WARNING, " at 0:30.0, armed, and never cleared"),
        ([(30, 16, 2)], False, Severity.WARNING, " at 0:30.0, not armed, and never cleared"),
        ([(30, 16, 2), (30.4, 16, 0)], True, Severity.WARNING, " at 0:30.0, armed, cleared after 0.40 s"),
        ([(30, 16, 2), (32, 16, 0)], False, Severity.NOTICE, " at 0:30.0, not armed, cleared after 2.0 s"),
        ([(30, 17, 1), (32, 17, 0)], True, Severity.WARNING, " at 0:30.0, armed, cleared after 2.0 s"),
        ([(30, 17, 1)], True, Severity.CRITICAL, " at 0:30.0, armed, and never cleared"),
        ([(30, 16, 2), (32, 16, 0), (40, 16, 2)], True, Severity.WARNING,
         " at 0:40.0, armed, and never cleared, 2 times in all"),
        ([(30, 12, 1), (31, 12, 1)], False, Severity.CRITICAL, " at 0:30.0, not armed, 2 times in all"),
    ],
)  # fmt: skip
def test_an_error_has_its_time_state_and_number(
    rows: list[tuple[float, int, int]], arm: bool, severity: Severity, ending: str
) -> None:
    (finding,) = found(errors(*rows), *([armed(10.0, 90.0)] if arm else [])).values()
    assert finding.sentence.endswith(ending)
    assert finding.severity is severity
    assert finding.evidence[0] == Evidence(
        "ERR", "ECode", round(rows[0][0] * S), finding.evidence[0].until_ns, f"{rows[0][1]}/{rows[0][2]}"
    )


def test_figures_of_events_and_errors() -> None:
    section = told(
        events.analyse,
        errors((30, 16, 2), (32, 16, 0), (40, 17, 1)),
        said((1.0, "hello")),
        MadeTable("EV", ns([5.0, 6.0]), {"Id": [10, 11]}),
    )
    assert {fact.key: fact.value for fact in section.facts} == {"events": 2, "errors": 2, "errors_open": 1, "texts": 1}
    assert [row[:3] for row in section.grids[0].rows] == [
        (1.0, "MSG", ""), (5.0, "EV", ""), (6.0, "EV", ""), (30.0, "ERR", "error"), (32.0, "ERR", ""),
        (40.0, "ERR", "error"),
    ]  # fmt: skip


def test_levels_of_texts_have_words() -> None:
    texts = MadeTable("STATUSTEXT", ns([1, 2, 3, 4]), {"text": ["a", "b", "c", "d"], "severity": [0, 4, 7, 8]})
    section = told(events.analyse, texts, kind="tlog")
    assert [row[2] for row in section.grids[0].rows] == ["emergency", "warning", "debug", ""]


# Troubles that texts report


@pytest.mark.parametrize(
    ("text", "key", "severity"),
    [
        ("Crash: Disarming: AngErr=33", "crash", Severity.CRITICAL), ("WDG: T3 SL10", "watchdog", Severity.CRITICAL),
        ("Internal Errors 0x100", "internal_error", Severity.CRITICAL),
        ("Radio Failsafe - Disarming", "radio_failsafe", Severity.WARNING),
        ("GCS Failsafe", "gcs_failsafe", Severity.WARNING), ("EKF Failsafe", "ekf_failsafe", Severity.WARNING),
        ("Battery 1 is low 10.2V used 5 mAh", "battery", Severity.WARNING),
        ("Fence Breached", "fence", Severity.WARNING),
        ("Terrain failsafe", "failsafe", Severity.WARNING), ("EKF variance", "ekf_variance", Severity.WARNING),
        ("Potential Thrust Loss (3)", "flight", Severity.WARNING), ("GPS 1 Glitch", "sensor", Severity.WARNING),
        ("No logging: disk full", "logging", Severity.WARNING),
    ],
)  # fmt: skip
def test_kinds_of_trouble(text: str, key: str, severity: Severity) -> None:
    finding = found(said((30.0, text)), armed(10.0, 90.0))[f"events.said.{key}"]
    assert finding.severity is severity
    assert finding.sentence == f'"{text}" at 0:30.0, armed'
    assert finding.evidence == (Evidence("MSG", "Message", 30 * S, None, text),)
    disarmed = found(said((30.0, text)))[f"events.said.{key}"]
    assert disarmed.severity is (severity if severity is Severity.CRITICAL else Severity.NOTICE)


def test_troubles_are_counted_until_they_are_over() -> None:
    log = MadeLog(
        said(
            (1, "GCS Failsafe"),
            (2, "GCS Failsafe"),
            (5, "GCS Failsafe Cleared"),
            (6, "GCS failsafe cleared"),
            (9, "GCS Failsafe"),
        )
    )
    from xitl_cli.logs.signals import texts

    troubles = [(one.text.at_ns / S, one.count, one.until_ns) for one in reported_troubles(texts(log))]
    assert troubles == [(1.0, 2, 5 * S), (9.0, 1, None)]
    finding = found(said((1, "GCS Failsafe"), (2, "GCS Failsafe"), (5, "GCS Failsafe Cleared")))[
        "events.said.gcs_failsafe"
    ]
    assert finding.sentence == '"GCS Failsafe" (2 times) at 0:01.0, not armed; over at 0:05.0'


@pytest.mark.parametrize(("at_s", "told_again"), [(28.0, False), (32.0, False), (27.9, True), (32.1, True)])
def test_a_text_within_two_seconds_of_an_error_is_told_by_it(at_s: float, told_again: bool) -> None:
    assert ("events.said.ekf_failsafe" in found(said((at_s, "EKF Failsafe")), errors((30.0, 17, 1)))) is told_again
    assert "events.said.crash" in found(said((at_s, "Crash: Disarming")), errors((30.0, 17, 1)))


# Errors of the firmware


@pytest.mark.parametrize(
    ("bits", "names", "step"),
    [
        ([0, 1 << 24, 1 << 27], "IMU reset, DMA failed", "Report it to ArduPilot with this log."),
        ([0, 1 << 11, 0], "watchdog reset", "The board was reset by its watchdog: look at WDOG."),
    ],
)
def test_internal_errors_by_name(bits: list[int], names: str, step: str) -> None:
    finding = found(MadeTable("PM", ns([10, 20, 30]), {"InE": np.array(bits)}))["events.internal_errors"]
    assert finding.sentence == f"Internal errors of the firmware, first at 0:20.0: {names}"
    mask = sum(bits)
    last = 30 if bits[2] else 20
    assert finding.evidence == (Evidence("PM", "InE", 20 * S, last * S, f"0x{mask:x}"),)
    assert finding.next_step == step


def test_bits_without_a_meaning_and_other_columns_are_no_internal_error() -> None:
    assert found(MadeTable("PM", ns([10]), {"InE": np.array([1 << 40])})) == {}
    assert found(MadeTable("PM", ns([10]), {"InE": np.array([1.0])})) == {}
    assert found(MadeTable("PM", ns([10]), {"InE": np.array(["x"])})) == {}


def test_a_loop_that_stopped_and_a_watchdog() -> None:
    findings = found(MadeTable("MON", ns([10, 20]), {"Dly": [300, 700]}), MadeTable("WDOG", ns([1]), {"Tsk": [4]}))
    assert findings["events.main_loop_stuck"].sentence == (
        "The main loop stopped long enough to be logged 2 times, for up to 700 ms"
    )
    assert [one.at_ns for one in findings["events.main_loop_stuck"].evidence] == [10 * S, 20 * S]
    assert findings["events.watchdog"].sentence == (
        "The watchdog reset the board before this log began, in scheduler task 4"
    )


def test_a_run_that_failed() -> None:
    log = MadeTable(
        "/log",
        ns([5, 6, 7, 8]),
        {"level": [4, 4, 5, 2], "name": ["run", "agent", "run", "run"], "message": ["a", "b", "c", "d"]},
    )
    section = told(events.analyse, log, kind="mcap", base="simulation")
    (finding,) = [one for one in section.findings if one.key == "events.run_failed"]
    assert finding.sentence == "The run failed at 0:07.0: c"
    assert finding.evidence == (Evidence("/log", "message", 7 * S, value="c"),)


# Modes


def mode(*rows: tuple[float, int, int]) -> MadeTable:
    at, number, reason = zip(*rows, strict=True)
    return MadeTable("MODE", ns(at), {"ModeNum": number, "Rsn": reason})


def test_modes_with_their_causes() -> None:
    section = told(modes.analyse, mode((0, 0, 1), (20, 10, 2), (25, 10, 2), (50, 4, 3)), armed(10.0, 90.0))
    assert [row[:4] for row in section.grids[0].rows] == [
        (0.0, 20.0, 20.0, "MANUAL"), (20.0, 50.0, 30.0, "AUTO"), (50.0, 100.0, 50.0, "HOLD"),
    ]  # fmt: skip
    assert {fact.key: fact.value for fact in section.facts} == {
        "mode_changes": 2, "in_hold_s": 50.0, "in_auto_s": 30.0, "in_manual_s": 20.0,
    }  # fmt: skip
    (finding,) = section.findings
    assert finding.key == "modes.failsafe.link"
    assert finding.severity is Severity.CRITICAL  # it ended a mission
    assert finding.sentence.startswith("At 0:50.0 ")
    assert finding.sentence.endswith(" changed the mode to HOLD out of AUTO, armed")
    assert finding.evidence == (Evidence("MODE", "Rsn", 50 * S, value="3"),)


@pytest.mark.parametrize(
    ("before", "arm", "severity"),
    [(10, True, Severity.CRITICAL), (0, True, Severity.WARNING), (10, False, Severity.NOTICE)],
)
def test_a_failsafe_by_what_it_ended(before: int, arm: bool, severity: Severity) -> None:
    section = told(modes.analyse, mode((0, before, 1), (50, 4, 4)), *([armed(10.0, 90.0)] if arm else []))
    (finding,) = section.findings
    assert (finding.key, finding.severity) == ("modes.failsafe.battery", severity)


@pytest.mark.parametrize(("at_s", "failsafe"), [(49.0, True), (48.9, False), (51.1, False)])
def test_an_error_with_a_mode_change_without_reason_is_its_cause(at_s: float, failsafe: bool) -> None:
    section = told(modes.analyse, mode((0, 10, 0), (50, 4, 0)), errors((at_s, 17, 1)))
    assert bool(section.findings) is failsafe


@pytest.mark.parametrize(("at_s", "cause"), [(47.0, "radio lost"), (53.0, "radio lost"), (46.9, ""), (53.1, "")])
def test_a_run_records_the_cause_of_a_mode(at_s: float, cause: str) -> None:
    beats = MadeTable(
        "/link/agent/rx:HEARTBEAT",
        ns([0, 50]),
        {"autopilot": [3, 3], "type": [11, 11], "custom_mode": [10, 4], "base_mode": [0, 0]},
    )
    recorded = MadeTable(
        "/autopilot/events", ns([at_s]), {"event": ["mode"], "mode": ["HOLD"], "reason": ["radio lost"]}
    )
    section = told(modes.analyse, beats, recorded, kind="mcap", base="simulation")
    assert section.grids[0].rows[1][4] == cause
    assert [one.evidence[0] for one in section.findings] == (
        [Evidence("/autopilot/events", "reason", 50 * S, value="radio lost")] if cause else []
    )


# Parameters


def parm(*rows: tuple[float, str, float, float]) -> MadeTable:
    at, name, value, default = zip(*rows, strict=True)
    return MadeTable("PARM", ns(at), {"Name": name, "Value": value, "Default": default})


def test_parameters_that_change_and_differ() -> None:
    table = parm(
        (0, "A", 1.0, 1.0), (0, "B", 2.0, 3.0), (0, "C", 5.0, np.nan), (0, "STAT_RUNTIME", 1.0, 0.0),
        (20, "A", 1.5, 1.0), (30, "A", 1.5, 1.0),
        (40, "B", 7.0, 3.0), (50, "STAT_RUNTIME", 9.0, 0.0),
    )  # fmt: skip
    section = told(parameters.analyse, table, armed(10.0, 90.0))
    facts = {fact.key: fact.value for fact in section.facts}
    assert (facts["parameters"], facts["differ_from_default"], facts["changes"], facts["changes_by_itself"]) == (
        4,
        2,
        2,
        1,
    )
    (finding,) = section.findings
    assert finding.sentence == "A and 1 more changed while armed, first at 0:20.0 from 1 to 1.5"
    assert finding.evidence == (
        Evidence("PARM", "A", 20 * S, value="1 to 1.5"), Evidence("PARM", "B", 40 * S, value="2 to 7"),
    )  # fmt: skip
    assert section.grids[0].rows[:2] == ((20.0, "A", 1.0, 1.5, "armed"), (40.0, "B", 2.0, 7.0, "armed"))
    assert section.grids[1].rows == (("A", 1.5, 1.0), ("B", 7.0, 3.0))


def test_values_that_xitl_set_are_its_own(tmp_path: Path) -> None:
    link = MadeTable("/link/agent/tx", [0], {"frame": [0]})
    given = MadeTable("/link/agent/tx:PARAM_SET", [0, 0], {"param_id": ["A", "B"], "param_value": [1.5, 9.0]})
    told_ = MadeTable(
        "PARAM_VALUE", ns([0, 0, 5, 6]), {"param_id": ["A", "B", "A", "B"], "param_value": [1.0, 2.0, 1.5, 7.0]}
    )
    log = MadeLog(link, given, told_, END, kind="mcap", base="simulation", path=str(tmp_path / "run.mcap"))
    from xitl_cli.logs.signals.states import parameter_rows

    assert parameter_changes(log, parameter_rows(log)) == [
        ParameterChange(5 * S, "A", 1.0, 1.5, False, False, "PARAM_VALUE", True),
        ParameterChange(6 * S, "B", 2.0, 7.0, False, False, "PARAM_VALUE", False),
    ]
    section = parameters.analyse(log)
    assert section is not None
    assert {fact.key: fact.value for fact in section.facts}["changes_by_run"] == 1
    assert section.grids[0].rows[0][4] == "not armed, by xitl"


@pytest.mark.parametrize(("value", "arm", "off"), [(0.0, True, True), (0.1, True, False), (0.0, False, False)])
def test_an_estimator_check_that_is_off(value: float, arm: bool, off: bool) -> None:
    section = told(parameters.analyse, parm((0, "FS_EKF_THRESH", value, 0.8)), *([armed(10.0)] if arm else []))
    assert [one.key for one in section.findings] == (["parameters.ekf_failsafe_off"] if off else [])


# Sags of a battery


def battery(drop_v: float, at_s: float = 60.0, rows: int = 480, noise_v: float = 0.004) -> tuple[Any, Any, Any]:
    """At 4 Hz: 12.6 V at rest, 40 mohm, a slow discharge; the voltage falls by `drop_v`."""
    rng = np.random.default_rng(1)
    at = np.arange(rows) / 4.0
    current = 5.0 + 3.0 * np.sin(at / 3.0)
    volts = 12.6 - 0.04 * current - 2e-4 * at - np.where(at >= at_s, drop_v, 0.0) + noise_v * rng.normal(size=rows)
    return ns(at), volts, current


@pytest.mark.parametrize("drop_v", [0.3, 1.0])
def test_a_lasting_fall_of_the_voltage_has_its_instant_and_size(drop_v: float) -> None:
    (sag,) = battery_sags(*battery(drop_v))
    assert sag.from_ns == pytest.approx(60 * S, abs=0.5 * S)
    assert sag.until_ns == round(119.75 * S)
    assert sag.drop_v == pytest.approx(drop_v, abs=0.02)


@pytest.mark.parametrize("drop_v", [0.0, 0.12, -0.5])
def test_no_fall_within_the_noise_and_no_rise(drop_v: float) -> None:
    """1.5 % of 12.4 V are 0.19 V."""
    assert battery_sags(*battery(drop_v)) == []
    stamps, volts, current = battery(1.0, 4.0, rows=39)
    assert battery_sags(stamps, volts, current) == []


def test_a_sag_is_told_of_measured_and_simulated_batteries() -> None:
    stamps, volts, current = battery(0.5)
    measured = MadeTable("BAT", stamps, {"Volt": volts, "Curr": current})
    simulated = MadeTable("/battery", stamps, {"voltage_v": volts, "current_a": current})
    for table, kind in ((measured, "dataflash"), (simulated, "mcap")):
        (finding,) = told(actuation.analyse, table, kind=kind).findings
        assert finding.sentence.startswith("At 1:00.0 the voltage of the battery falls by 0.5")
        assert finding.sentence.endswith(" V more than its current explains")
        assert finding.evidence[0].message == table.name
