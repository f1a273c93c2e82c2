from __future__ import annotations

import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Section, Severity
from xitl_cli.plugins.logs.analyses.modes import analyse, mode_spans

S = 1_000_000_000
ROVER = MadeTable("VER", [0], {"BU": [1], "FWS": ["ArduRover V4.5.0 (0123abcd)"]})
COPTER = MadeTable("VER", [0], {"BU": [2], "FWS": ["ArduCopter V4.5.0 (0123abcd)"]})


def modes(at_s: list[int], numbers: list[int], reasons: list[int]) -> MadeTable:
    return MadeTable("MODE", [at * S for at in at_s], {"Mode": numbers, "ModeNum": numbers, "Rsn": reasons})


def armed(from_s: int, until_s: int) -> MadeTable:
    return MadeTable("ARM", [from_s * S, until_s * S], {"ArmState": [1, 0], "ArmChecks": [1, 0]})


def end(at_s: int) -> MadeTable:
    return MadeTable("ATT", [0, at_s * S], {"Roll": [0.0, 0.0]})


def section_of(*tables: MadeTable) -> Section:
    found = analyse(MadeLog(*tables))
    assert found is not None
    return found


def test_rows_from_until_why() -> None:
    section = section_of(ROVER, modes([1, 5, 5, 20], [0, 10, 10, 4], [26, 2, 2, 8]), end(30))
    assert section.grids[0].rows == (
        (1.0, 5.0, 4.0, "MANUAL", "start-up"),
        (5.0, 20.0, 15.0, "AUTO", "ground station"),
        (20.0, 30.0, 10.0, "HOLD", "end of mission"),
    )
    assert not section.findings


def test_the_same_number_means_another_mode_to_a_copter() -> None:
    assert [span.name for span in mode_spans(MadeLog(COPTER, modes([1, 2, 3], [0, 5, 9], [26, 1, 4])))] == [
        "STABILIZE",
        "LOITER",
        "LAND",
    ]


@pytest.mark.parametrize(
    ("before", "arms", "severity"),
    [(10, armed(2, 25), Severity.CRITICAL), (0, armed(2, 25), Severity.WARNING), (0, armed(20, 25), Severity.NOTICE)],
)
def test_a_failsafe_weighs_by_what_it_interrupted(before: int, arms: MadeTable, severity: Severity) -> None:
    section = section_of(ROVER, modes([1, 10], [before, 4], [2, 6]), arms, end(30))
    (finding,) = section.findings
    assert finding.severity is severity
    assert finding.sentence.startswith("At 0:10.0 EKF failsafe changed the mode to HOLD")
    assert finding.evidence[0].at_ns == 10 * S
    assert finding.next_step


def test_without_a_reason_the_error_beside_it_is_the_reason() -> None:
    errors = MadeTable("ERR", [10 * S, 10 * S], {"Subsys": [16, 17], "ECode": [2, 1]})
    section = section_of(ROVER, modes([1, 10], [10, 4], [0, 0]), errors, armed(2, 25), end(30))
    (finding,) = section.findings
    assert "EKF failsafe changed the mode" in finding.sentence


def test_telemetry_has_modes_without_reasons() -> None:
    beats = MadeTable(
        "HEARTBEAT",
        [0, S, 2 * S, 3 * S],
        {"type": [10, 6, 10, 10], "autopilot": [3, 8, 3, 3], "custom_mode": [0, 0, 10, 10],
         "base_mode": [0, 0, 128, 128], "_sysid": [1, 255, 1, 1]},
    )  # fmt: skip
    found = analyse(MadeLog(beats, kind="tlog", base="utc"))
    assert found is not None
    assert found.lacks
    assert [row[3] for row in found.grids[0].rows] == ["MANUAL", "AUTO"]


def test_a_log_without_modes_says_so() -> None:
    section = section_of(end(5))
    assert section.lacks
    assert not section.grids
