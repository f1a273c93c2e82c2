from __future__ import annotations

from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Section, Severity
from xitl_cli.plugins.logs.analyses.arming import analyse, arm_refusals

S = 1_000_000_000


def arm(rows: list[tuple[int, int, int, int, int]]) -> MadeTable:
    """(second, state, checks, forced, method)"""
    at, state, checks, forced, method = zip(*rows, strict=True)
    values = {"ArmState": state, "ArmChecks": checks, "Forced": forced, "Method": method}
    return MadeTable("ARM", [second * S for second in at], values)


def said(*texts: tuple[int, str]) -> MadeTable:
    return MadeTable("MSG", [at * S for at, _ in texts], {"Message": [text for _, text in texts]})


def end(at_s: int) -> MadeTable:
    return MadeTable("ATT", [0, at_s * S], {"Roll": [0.0, 0.0]})


def section_of(*tables: MadeTable) -> Section:
    found = analyse(MadeLog(*tables))
    assert found is not None
    return found


def test_intervals_and_who_did_it() -> None:
    section = section_of(arm([(10, 1, 1, 0, 1), (20, 0, 0, 0, 17), (30, 1, 1, 0, 0)]), end(60))
    assert section.grids[0].rows == (
        (10.0, 20.0, 10.0, "ground station", "disarm delay"),
        (30.0, 60.0, 30.0, "rudder stick", "armed when the log ends"),
    )
    assert not section.findings
    assert {fact.key: fact.value for fact in section.facts}["times_armed"] == 2


def test_a_log_that_begins_armed() -> None:
    section = section_of(arm([(20, 0, 0, 0, 1)]), end(60))
    assert section.grids[0].rows[0][:2] == (0.0, 20.0)


def test_only_the_sentence_says_that_it_was_armed() -> None:
    section = section_of(said((4, "Throttle armed"), (9, "Throttle disarmed")), end(12))
    assert section.grids[0].rows == ((4.0, 9.0, 5.0, "", ""),)


def test_disarmed_by_a_failsafe_is_critical() -> None:
    section = section_of(arm([(10, 1, 1, 0, 1), (20, 0, 0, 0, 6)]), end(60))
    (finding,) = section.findings
    assert finding.severity is Severity.CRITICAL
    assert "CPU failsafe" in finding.sentence


def test_by_force_and_without_checks() -> None:
    section = section_of(arm([(10, 1, 0, 1, 1)]), end(60))
    assert {finding.key: finding.severity for finding in section.findings} == {
        "arming.checks_off": Severity.NOTICE,
        "arming.forced": Severity.WARNING,
    }


def test_some_checks_left_out() -> None:
    section = section_of(arm([(10, 1, 0b1_1111_1111_1111_1111_1011_0 & ~1, 0, 1)]), end(60))
    (finding,) = section.findings
    assert finding.key == "arming.checks_partly_off"
    assert "GPS" in finding.sentence


def test_reasons_are_grouped() -> None:
    log = MadeLog(
        said((1, "PreArm: GPS 1: Bad fix"), (2, "Arm: Mode not armable"), (31, "PreArm: GPS 1: Bad fix")), end(40)
    )
    bad, mode = arm_refusals(log)
    assert (bad.reason, bad.attempt, bad.count, bad.first_ns, bad.last_ns) == (
        "GPS 1: Bad fix",
        False,
        2,
        1 * S,
        31 * S,
    )
    assert (mode.reason, mode.attempt) == ("Mode not armable", True)
    found = analyse(log)
    assert found is not None
    (finding,) = found.findings
    assert finding.key == "arming.refused"
    assert finding.severity is Severity.WARNING
    assert "Mode not armable" in finding.sentence


def test_refused_and_armed_later_is_a_notice() -> None:
    section = section_of(said((1, "Arm: Need position")), arm([(10, 1, 1, 0, 1)]), end(60))
    (finding,) = section.findings
    assert finding.key == "arming.attempts_refused"
    assert finding.severity is Severity.NOTICE


def test_never_armed_and_never_tried() -> None:
    events = MadeTable("EV", [S], {"Id": [25]})
    (finding,) = section_of(events, end(60)).findings
    assert finding.key == "arming.never"
    assert finding.severity is Severity.NOTICE


def test_from_origin_to_armed() -> None:
    section = section_of(said((7, "EKF3 IMU0 origin set")), arm([(10, 1, 1, 0, 1)]), end(60))
    assert {fact.key: fact.value for fact in section.facts}["origin_to_arm_s"] == 3.0
