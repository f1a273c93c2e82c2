from __future__ import annotations

import pytest
from made_log import MadeLog, MadeTable

import xitl_cli.logs.signals as signals
from tests.golden import Golden
from xitl_cli.logs.model.sections import Finding, Section, Severity
from xitl_cli.plugins.logs.analyses.events import analyse

S = 1_000_000_000
ROVER = MadeTable("VER", [0], {"BU": [1], "FWS": ["ArduRover V4.5.0 (0123abcd)"]})


def errors(*rows: tuple[int, int, int]) -> MadeTable:
    at, subsystem, code = zip(*rows, strict=True)
    return MadeTable("ERR", [second * S for second in at], {"Subsys": subsystem, "ECode": code})


def said(*texts: tuple[int, str]) -> MadeTable:
    return MadeTable("MSG", [at * S for at, _ in texts], {"Message": [text for _, text in texts]})


def armed(from_s: int, until_s: int) -> MadeTable:
    return MadeTable("ARM", [from_s * S, until_s * S], {"ArmState": [1, 0]})


END = MadeTable("ATT", [0, 100 * S], {"Roll": [0.0, 0.0]})


def section_of(*tables: MadeTable) -> Section:
    found = analyse(MadeLog(*tables, END, ROVER))
    assert found is not None
    return found


def only(*tables: MadeTable) -> Finding:
    (finding,) = section_of(*tables).findings
    return finding


def test_everything_in_words_in_the_order_of_time() -> None:
    section = section_of(
        MadeTable("EV", [20 * S, 40 * S], {"Id": [10, 62]}),
        errors((30, 16, 2), (35, 16, 0)),
        said((10, "ArduRover V4.5.0 (0123abcd)")),
        MadeTable("MODE", [25 * S], {"Mode": [10], "ModeNum": [10], "Rsn": [2]}),
        MadeTable("AUXF", [50 * S], {"function": [153], "pos": [2], "source": [1]}),
    )
    assert [(row[0], row[1], row[3]) for row in section.grids[0].rows] == [
        (10.0, "MSG", "ArduRover V4.5.0 (0123abcd)"),
        (20.0, "EV", "armed"),
        (25.0, "MODE", "mode AUTO (ground station)"),
        (30.0, "ERR", "EKF check: bad variance"),
        (35.0, "ERR", "EKF check: resolved"),
        (40.0, "EV", "EKF yaw reset"),
        (50.0, "AUXF", "switch arm and disarm high (RC)"),
    ]


def test_an_error_that_was_never_cleared() -> None:
    finding = only(errors((30, 16, 2)), armed(10, 90))
    assert finding.severity is Severity.WARNING
    assert finding.sentence == "EKF check: bad variance at 0:30.0, armed, and never cleared"
    assert finding.evidence[0].at_ns == 30 * S
    assert finding.evidence[0].until_ns is None


def test_a_failsafe_that_stays_while_armed_is_critical() -> None:
    assert only(errors((30, 17, 1)), armed(10, 90)).severity is Severity.CRITICAL


def test_cleared_errors_are_one_finding_with_their_time(golden: Golden) -> None:
    finding = only(errors((30, 16, 2), (32, 16, 0), (50, 16, 2), (53, 16, 0)), armed(10, 90))
    golden("finding", finding.sentence, "0:30.0", "5.0 s", "2 times")


def test_the_zero_of_a_healthy_start_is_no_error() -> None:
    assert section_of(errors((1, 3, 0))).findings == ()


@pytest.mark.parametrize(("subsystem", "code"), [(12, 1), (30, 1), (19, 1)])
def test_crash_internal_error_and_cpu_are_critical(subsystem: int, code: int) -> None:
    assert only(errors((30, subsystem, code)), armed(10, 90)).severity is Severity.CRITICAL


def test_a_refused_mode_is_a_notice_by_the_vehicles_name() -> None:
    finding = only(errors((30, 10, 10)))
    assert finding.severity is Severity.NOTICE
    assert "AUTO refused" in finding.sentence


def test_start_up_sentences_are_no_trouble() -> None:
    section = section_of(
        said(
            (1, "ArduRover V4.7.0-dev (2598e9d4)"),
            (1, "Param space used: 222/3840"),
            (2, "New fence"),
            (3, "EKF3 IMU0 origin set"),
            (4, "PreArm: Radio failsafe on"),
            (5, "Warning: Arming Checks Disabled"),
        )
    )
    assert section.findings == ()


def test_a_failsafe_that_only_a_sentence_tells() -> None:
    finding = only(said((30, "Radio Failsafe"), (40, "Radio Failsafe Cleared")), armed(10, 90))
    assert finding.key == "events.said.radio_failsafe"
    assert finding.severity is Severity.WARNING
    assert finding.evidence[0].until_ns == 40 * S


def test_a_sentence_that_an_error_tells_already_is_told_once() -> None:
    assert only(said((30, "EKF failsafe")), errors((30, 17, 1)), armed(10, 90)).key == "events.error.17.1"


def test_the_watchdog() -> None:
    findings = section_of(MadeTable("WDOG", [S], {"Task": [7], "IErr": [1 << 15]})).findings
    assert [finding.key for finding in findings] == ["events.watchdog", "events.internal_errors"]
    assert all(finding.severity is Severity.CRITICAL for finding in findings)
    assert "task 7" in findings[0].sentence
    assert "main loop stuck" in findings[1].sentence


def test_internal_errors_of_pm() -> None:
    finding = only(MadeTable("PM", [10 * S, 20 * S], {"InE": [0, 1 << 24]}))
    assert "IMU reset" in finding.sentence
    assert finding.evidence[0].at_ns == 20 * S


def test_a_log_with_nothing_to_tell_says_so() -> None:
    found = analyse(MadeLog(END))
    assert found is not None
    assert found.lacks


def test_messages_of_a_run_have_the_severity_of_their_level() -> None:
    """foxglove.Log: 1 debug, 2 info, 3 warning, 4 error, 5 fatal; 0 is unknown."""
    table = MadeTable("/log", [level * S for level in range(6)], {"message": list("abcdef"), "level": range(6)})
    found = signals.texts(MadeLog(table, kind="mcap", base="simulation"))
    assert [text.severity for text in found] == [None, 7, 6, 4, 3, 2]  # MAV_SEVERITY
