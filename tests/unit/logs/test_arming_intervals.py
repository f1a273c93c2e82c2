from __future__ import annotations

import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Evidence, Section, Severity
from xitl_cli.plugins.logs.analyses.arming import ArmSwitch, analyse, arm_refusals, arm_switches

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


def facts_of(section: Section) -> dict[str, object]:
    return {fact.key: fact.value for fact in section.facts}


def ready(*rows: tuple[float, int, int]) -> MadeTable:
    """SYS_STATUS: second, present, health."""
    at, present, health = zip(*rows, strict=True)
    values = {"onboard_control_sensors_present": present, "onboard_control_sensors_health": health}
    return MadeTable("SYS_STATUS", [round(second * S) for second in at], values)


@pytest.mark.parametrize(
    ("rows", "waited_s"),
    [
        ([(2, 1 << 28, 0), (4, 0, 1 << 28), (6.5, 1 << 28 | 1, 1 << 28 | 2), (8, 1 << 28, 1 << 28)], 3.5),
        ([(10, 1 << 28, 1 << 28)], 0.0),
        ([(10.1, 1 << 28, 1 << 28)], None),  # it was armed before
        ([(2, 1 << 27, 1 << 27)], None),
    ],
)
def test_how_long_it_was_ready_before_it_was_armed(rows, waited_s) -> None:
    section = section_of(ready(*rows), arm([(10, 1, 1, 0, 1), (25, 0, 0, 0, 1), (30, 1, 1, 0, 1)]), end(60))
    found = facts_of(section)
    assert found.get("ready_to_arm_s") == waited_s
    assert (found["times_armed"], found["armed_s"], found["first_armed_s"]) == (2, 45.0, 10.0)


@pytest.mark.parametrize(("at_s", "waited_s"), [(1.0, None), (1.1, 8.9), (10.0, 0.0), (10.1, None)])
def test_the_origin_of_the_estimator_by_its_own_message(at_s: float, waited_s: float | None) -> None:
    """A row at the very start of a log repeats an earlier one; the origin of the home (type 1) does not count."""
    origin = MadeTable("ORGN", [2 * S, round(at_s * S)], {"Type": [1, 0]})
    found = facts_of(section_of(origin, arm([(10, 1, 1, 0, 1)]), end(60)))
    assert found.get("origin_to_arm_s") == waited_s


def test_the_row_of_a_switch_is_within_a_second_of_it() -> None:
    """The sentence and the row tell of the same switch, up to a second apart; the nearest of several counts."""
    texts = said((10, "Throttle armed"), (20, "Throttle disarmed"), (40, "Throttle armed"), (50, "Throttle disarmed"))
    at_ns = [9_000_000_000, 21_000_000_000, 38_900_000_000, 50_500_000_000, 50_900_000_000]
    values = {"ArmState": [1, 0, 1, 0, 0], "ArmChecks": [1] * 5, "Forced": [0, 0, 0, 0, 0], "Method": [0, 1, 2, 3, 1]}
    switches = MadeTable("ARM", at_ns, values)
    intervals = section_of(texts, switches, end(60)).grids[0].rows
    assert ("rudder stick", "ground station") in [row[3:] for row in intervals]
    forced = section_of(arm([(10, 1, 1, 1, 1), (20, 0, 0, 0, 0)]), end(60))
    assert forced.grids[0].rows[0][3:] == ("ground station, forced", "rudder stick")
    assert [(each.key, each.sentence) for each in forced.findings] == [
        ("arming.forced", "It was armed by force at 0:10.0, whatever the checks reported")
    ]
    assert forced.findings[0].evidence == (Evidence("ARM", "Forced", 10 * S, value="1"),)


def test_old_versions_do_not_tell_who_armed() -> None:
    old = MadeTable("ARM", [10 * S, 20 * S], {"ArmState": [1, 0], "ArmChecks": [1, 0]})
    section = section_of(old, end(60))
    assert section.grids[0].rows == ((10.0, 20.0, 10.0, "", ""),)
    assert section.findings == ()
    assert [(each.method, each.forced, each.checks) for each in arm_switches(MadeLog(old))] == [
        (None, None, 1), (None, None, 0),
    ]  # fmt: skip
    assert arm_switches(MadeLog(end(60))) == []


def test_switches_are_in_order_of_time() -> None:
    rows = arm_switches(MadeLog(arm([(20, 0, 0, 0, 6), (10, 1, 7, 1, 1)])))
    assert rows == [ArmSwitch(10 * S, True, 1, True, 7), ArmSwitch(20 * S, False, 6, False, 0)]


@pytest.mark.parametrize(
    ("checks", "names"),
    [
        (0b1_1111_1111_1111_1111_0000, "barometer, compass, GPS"),  # bit 0 stands for all
        (0b0_1111_1111_1111_1111_1110, "OSD"),
        (0b1_1111_1111_1111_1000_0000, "barometer, compass, GPS, INS, parameters, RC"),
        (0b1_1111_1111_1111_0000_0000, "barometer, compass, GPS, INS, parameters, RC and 1 more"),
        (0b1_0000_0000_0000_0000_0000, "barometer, compass, GPS, INS, parameters, RC and 13 more"),
        (0b1_1111_1111_1111_1111_1110, None),
        (1, None),
    ],
)
def test_checks_that_were_left_out(checks: int, names: str | None) -> None:
    section = section_of(arm([(5, 1, 1, 0, 1), (7, 0, 0, 0, 1), (10, 1, checks, 0, 1)]), end(60))
    if names is None:
        assert section.findings == ()
        return
    (finding,) = section.findings
    assert finding.sentence == f"It was armed at 0:10.0 without the checks of {names}"
    assert finding.evidence == (Evidence("ARM", "ArmChecks", 10 * S, value=str(checks)),)


def test_all_checks_off_is_told_once_with_each_time() -> None:
    section = section_of(arm([(10, 1, 0, 0, 1), (20, 0, 0, 0, 1), (30, 1, 6, 0, 1), (50, 1, 0, 0, 1)]), end(60))
    (finding,) = section.findings
    assert finding.sentence == "It was armed at 0:10.0 with all arming checks switched off"
    assert [each.at_ns for each in finding.evidence] == [10 * S, 50 * S]


def test_a_failsafe_by_its_method() -> None:
    section = section_of(arm([(10, 1, 1, 0, 6), (20, 0, 0, 0, 5), (30, 1, 1, 0, 1), (40, 0, 0, 0, 6)]), end(60))
    other, cpu = section.findings  # arming by such a method is none
    assert other.next_step == "Look at the events just before."
    assert cpu.next_step == "The main loop stopped: see the scheduler section."
    assert [each.evidence for each in section.findings] == [
        (Evidence("ARM", "Method", 20 * S, value="5"),), (Evidence("ARM", "Method", 40 * S, value="6"),),
    ]  # fmt: skip
    assert other.sentence.startswith("At 0:20.0 the autopilot disarmed by itself: ")


def test_refusals_have_their_counts_and_the_last_attempt_is_told() -> None:
    log = said(
        (1, "PreArm: Compass not healthy"), (2, "arm :  Rudder  "), (3, "Arm: Mode not armable"), (4, "Arm: Rudder"),
        (5, "PreArm: Compass not healthy"), (6, "Armoury: x"), (50, "PreArm: Late"),
    )  # fmt: skip
    section = section_of(log, end(60))
    assert section.grids[0].rows == (
        ("Compass not healthy", "before", 2, 1.0, 5.0),
        ("Rudder", "at an attempt", 2, 2.0, 4.0),
        ("Mode not armable", "at an attempt", 1, 3.0, 3.0),
        ("Late", "before", 1, 50.0, 50.0),
    )
    assert facts_of(section) == {"times_armed": 0, "armed_s": 0.0, "refusals": 4}
    (finding,) = section.findings
    assert finding.sentence == 'It was never armed; the last reason given was "Rudder" (2 times, until 0:04.0)'
    assert finding.evidence[0] == Evidence("MSG", "Message", S, 5 * S, "Compass not healthy (2)")
    later = section_of(log, arm([(55, 1, 1, 0, 1)]), end(60))
    assert [each.sentence for each in later.findings] == ['Arming was refused 3 times, first for "Rudder"']
    assert len(later.findings[0].evidence) == 2
    before = section_of(said((1, "PreArm: Late")), arm([(55, 1, 1, 0, 1)]), end(60))
    assert before.findings == ()


def test_a_log_without_any_word_of_arming() -> None:
    section = section_of(end(60))
    assert section.findings == ()
    assert section.lacks == ("The log does not show whether it was armed: it has no ARM, EV, MSG or heartbeat.",)
    never = section_of(said((1, "ArduRover V4.5.7")), MadeTable("ATT", [S, 60_400_000_000], {"Roll": [0.0, 0.0]}))
    assert [each.sentence for each in never.findings] == [
        "It was not armed in the 59 s of this log, and no attempt is logged"
    ]
    assert never.lacks == ()
