"""One cause, one finding: what follows from another is folded under it, and nothing is lost."""

from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from xitl_cli.log_analyses import OWN
from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.log import LogHealth
from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.logs.report import terminal
from xitl_cli.logs.report.causes import (
    CAUSES,
    FindingGroup,
    group_findings,
    is_contradicted,
    is_kind,
    without_contradictions,
)
from xitl_cli.logs.report.file_report import FileReport
from xitl_cli.logs.report.html import html
from xitl_cli.logs.report.json import document
from xitl_cli.logs.report.model import Report
from xitl_cli.logs.report.page import report_page

S = 1_000_000_000
NOTICE, WARNING, CRITICAL = Severity.NOTICE, Severity.WARNING, Severity.CRITICAL


def finding(key: str, *spans_s: float | tuple[float, float], severity: Severity = WARNING) -> Finding:
    spans = [span if isinstance(span, tuple) else (span, span) for span in spans_s]
    evidence = tuple(Evidence("X", None, round(begin * S), round(end * S)) for begin, end in spans)
    return Finding(key, severity, f"what {key} says", evidence, "look")


def log(*findings: Finding, name: str = "one.bin", zero_s: float = 0.0) -> FileReport:
    sections: dict[str, list[Finding]] = {}
    for each in findings:
        sections.setdefault(each.key.split(".")[0], []).append(each)
    made = tuple(Section(key, key.capitalize(), findings=tuple(rows)) for key, rows in sections.items())
    health, line = LogHealth(1, 1), TimeLine(round(zero_s * S))
    return FileReport(name, Path(name), "dataflash", "boot", (0, 100 * S), health, {}, made, line)


def shape(groups: list[FindingGroup]) -> list[tuple[str, list[str]]]:
    return [(group.cause.finding.key, [each.finding.key for each in group.consequences]) for group in groups]


CUT = (
    finding("faults.injected", (40.0, 45.0), severity=NOTICE),
    finding("links.loss", (40.0, 46.0), severity=NOTICE),
    finding("gnss.silent", (39.9, 45.1)),
    finding("sensors.gap", (40.0, 45.0)),
    finding("events.error.26.1", (40.3, 45.0)),
    finding("events.error.16.2", (45.0, 45.3)),
    finding("estimator.position_lost", (45.0, 45.2), severity=CRITICAL),
    finding("modes.failsafe", 45.4, severity=CRITICAL),
    finding("missions.unfinished", (30.0, 45.4)),
)


@pytest.mark.parametrize(("severity", "explains"), [(NOTICE, False), (WARNING, True)])
@pytest.mark.parametrize(
    "key", ["sensors.gyro_bias", "sensors.unhealthy", "actuation.reversed", "estimator.position_lost"]
)
def test_only_many_missing_samples_explain_more_than_gaps(key: str, severity: Severity, explains: bool) -> None:
    missing = finding("sensors.missing", (10.0, 50.0), severity=severity)
    groups = dict(shape(group_findings(Report((log(missing, finding(key, (46.0, 90.0))),)))))
    assert groups["sensors.missing"] == ([key] if explains else [])
    (gap,) = group_findings(Report((log(missing, finding("sensors.gap", 45.0)),)))
    assert shape([gap]) == [("sensors.missing", ["sensors.gap"])]


def test_a_wrong_velocity_explains_a_bias_that_is_measured_by_it() -> None:
    wrong, bias = finding("gnss.velocity_off", (28.7, 40.0)), finding("sensors.accel_bias", (30.2, 60.0))
    assert shape(group_findings(Report((log(bias, wrong),)))) == [("gnss.velocity_off", ["sensors.accel_bias"])]


def test_thrust_that_seems_lost_from_a_collision_on_is_its_consequence() -> None:
    hit = finding("attitude.contact", 64.9, severity=CRITICAL)
    lost = finding("actuation.thrust_loss", (64.8, 89.0))
    assert shape(group_findings(Report((log(lost, hit),)))) == [("attitude.contact", ["actuation.thrust_loss"])]
    before = finding("actuation.thrust_loss", (55.0, 89.0))
    assert shape(group_findings(Report((log(before, hit),)))) == [("actuation.thrust_loss", ["attitude.contact"])]


def test_a_notice_explains_a_worse_finding_only_if_nothing_worse_does() -> None:
    shaken = finding("vibration.high", 16.0, 40.0, 57.0, severity=NOTICE)
    refused = finding("estimator.position_refused", (58.0, 68.0), severity=CRITICAL)
    jump = finding("gnss.jump", 57.9)
    assert shape(group_findings(Report((log(shaken, refused),)))) == [("vibration.high", [refused.key])]
    assert shape(group_findings(Report((log(shaken, jump, refused),)))) == [
        ("gnss.jump", [refused.key]),
        ("vibration.high", []),
    ]
    on_purpose = finding("faults.injected", (57.0, 70.0), severity=NOTICE)
    groups = shape(group_findings(Report((log(on_purpose, jump, refused),))))
    assert groups == [("faults.injected", ["gnss.jump", refused.key])]


def test_a_stuck_sensor_explains_an_attitude_that_only_the_estimate_has() -> None:
    stuck, doubtful = finding("sensors.stuck", (31.7, 37.7)), finding("attitude.doubtful", (35.3, 51.3))
    assert shape(group_findings(Report((log(stuck, doubtful),)))) == [("sensors.stuck", ["attitude.doubtful"])]


def test_an_error_against_the_truth_causes_nothing() -> None:
    error = finding("estimator.position_error", 16.7, severity=NOTICE)
    step, yaw = finding("sensors.field_step", (23.2, 43.2)), finding("estimator.yaw_error", 27.0)
    groups = shape(group_findings(Report((log(error, step, yaw),))))
    assert groups == [("sensors.field_step", ["estimator.yaw_error"]), ("estimator.position_error", [])]


def test_a_receiver_with_a_poor_accuracy_explains_errors_of_the_position_at_any_time() -> None:
    poor, error = finding("gnss.poor", (0.0, 100.0), severity=NOTICE), finding("estimator.position_error", 70.0)
    lost = finding("actuation.thrust_loss", (70.0, 90.0))
    groups = shape(group_findings(Report((log(poor), log(error, lost, name="two.mcap")))))
    assert groups == [("gnss.poor", ["estimator.position_error"]), ("actuation.thrust_loss", [])]


def test_a_main_loop_that_stopped_explains_what_the_autopilot_did_then() -> None:
    pause, disarmed = finding("sensors.recording_pauses", (56.6, 60.6)), finding("arming.disarmed_by_failsafe", 56.8)
    glitch = finding("gnss.glitch", (62.0, 76.9))
    groups = shape(group_findings(Report((log(pause, disarmed, glitch),))))
    assert groups == [("sensors.recording_pauses", ["arming.disarmed_by_failsafe", "gnss.glitch"])]


def test_missing_samples_of_one_sensor_do_not_stop_another() -> None:
    missing, stuck = finding("sensors.missing", (35.7, 88.1), severity=NOTICE), finding("sensors.stuck", (61.5, 67.5))
    failsafe = finding("modes.failsafe.position", 63.9, severity=CRITICAL)
    groups = shape(group_findings(Report((log(missing, stuck, failsafe),))))
    assert ("sensors.stuck", []) in groups or ("sensors.stuck", ["modes.failsafe.position"]) in groups
    assert all("sensors.stuck" not in follow for _, follow in groups)


def test_a_biased_gyroscope_explains_an_accelerometer_that_leaves_the_velocity() -> None:
    gyro, accel = finding("sensors.gyro_bias", (20.0, 100.0)), finding("sensors.accel_bias", (68.0, 100.0))
    assert shape(group_findings(Report((log(gyro, accel),)))) == [("sensors.gyro_bias", ["sensors.accel_bias"])]


def test_a_turn_against_the_commands_follows_from_a_stuck_actuator_of_another_file() -> None:
    stuck, turn = finding("actuation.stuck", (27.6, 48.4)), finding("actuation.unanswered", (38.5, 48.7))
    groups = shape(group_findings(Report((log(turn), log(stuck, name="two.bin")))))
    assert groups == [("actuation.stuck", ["actuation.unanswered"])]


def test_a_cut_link_is_one_finding() -> None:
    (group,) = group_findings(Report((log(*CUT[:8]),)))
    assert group.cause.finding.key == "faults.injected"
    assert [each.finding.key for each in group.consequences] == [
        "gnss.silent", "links.loss", "sensors.gap", "events.error.26.1", "estimator.position_lost", "events.error.16.2",
        "modes.failsafe",
    ]  # fmt: skip
    assert group.worst == CRITICAL


def test_without_the_fault_the_earliest_is_the_cause() -> None:
    assert shape(group_findings(Report((log(*CUT[3:8]),))))[0][0] == "sensors.gap"


def test_a_crash_is_one_critical() -> None:
    rows = (
        finding("events.error.12.1", 61.0, severity=CRITICAL),
        finding("attitude.overturned", (60.4, 77.0), severity=CRITICAL),
        finding("attitude.impact", 60.2, severity=CRITICAL),
        finding("arming.disarmed_by_failsafe", 61.0, severity=CRITICAL),
        finding("events.said.crash", 61.0, severity=CRITICAL),
    )
    ((cause, follow),) = shape(group_findings(Report((log(*rows),))))
    assert cause == "attitude.impact"
    assert len(follow) == 4


def test_what_came_before_or_long_after_stands_for_itself() -> None:
    rows = (
        finding("gnss.fix_lost", (40.0, 42.0)),
        finding("estimator.refused.velocity", (10.0, 11.0)),
        finding("modes.failsafe", 95.0, severity=CRITICAL),
    )
    assert all(not follow for _, follow in shape(group_findings(Report((log(*rows),)))))


def test_what_is_mostly_elsewhere_is_not_explained() -> None:
    rows = (finding("gnss.fix_lost", (40.0, 42.0)), finding("estimator.refused.velocity", 41.0, 80.0, 85.0, 90.0))
    assert len(group_findings(Report((log(*rows),)))) == 2


def test_an_event_explains_before_a_state_does() -> None:
    rows = (
        finding("sensors.field_changes", (0.0, 100.0)),
        finding("gnss.fix_lost", (40.0, 42.0)),
        finding("estimator.position_lost", (43.0, 44.0)),
    )
    assert ("gnss.fix_lost", ["estimator.position_lost"]) in shape(group_findings(Report((log(*rows),))))


def test_two_files_of_one_run_tell_a_finding_once_on_the_reports_time() -> None:
    first = log(finding("missions.unfinished", (30.0, 45.4)), name="run.mcap")
    second = log(finding("missions.unfinished", (130.0, 145.5)), name="autopilot.bin", zero_s=100.0)
    (group,) = group_findings(Report((first, second)))
    assert [each.file.name for each in group.consequences] == ["autopilot.bin"]
    far = log(finding("missions.unfinished", (230.0, 245.5)), name="autopilot.bin", zero_s=100.0)
    assert len(group_findings(Report((first, far)))) == 2


@pytest.mark.medium
def test_every_finding_is_shown_once_whatever_the_times_are() -> None:
    """Causes that come within a second of each other, each able to follow from the next."""
    keys = sorted({kind for rule in CAUSES for kind in (*rule.causes, *rule.consequences)})
    rows = [finding(key, 10.0 + 0.7 * (place % 7)) for place, key in enumerate(keys)]
    groups = group_findings(Report((log(*rows),)))
    told = [found.finding.key for group in groups for found in (group.cause, *group.consequences)]
    assert sorted(told) == keys


def test_the_table_names_kinds_that_exist() -> None:
    assert {kind.split(".")[0] for rule in CAUSES for kind in (*rule.causes, *rule.consequences)} <= set(OWN)


def test_json_says_from_what_each_follows() -> None:
    report = document(Report((log(*CUT),)))
    assert len(report["findings"]) == len(CUT)
    assert report["causes"]["critical"] == 1
    assert report["counts"] == {"critical": 2, "warning": 5, "notice": 2, "fine": 0}
    of = {each["key"]: each["follows_from"] for each in report["findings"]}
    assert of["faults.injected"] is None
    assert of["sensors.gap"] == {"file": "one.bin", "key": "faults.injected", "sentence": "what faults.injected says"}


def test_the_terminal_shows_them_below_their_cause() -> None:
    out = StringIO()
    terminal.show(Console(file=out, width=80, color_system=None), Report((log(*CUT[:8]),)))
    lines = [line.strip() for line in out.getvalue().splitlines()]
    assert "1 critical (7 findings follow from these)" in lines
    cause, follow = lines.index("NOTICE    What faults.injected says"), lines.index("What follows from it:")
    assert cause < follow < lines.index("WARNING   What sensors.gap says")
    assert out.getvalue().count("says\n") == 8
    assert max(len(line) for line in out.getvalue().splitlines()) <= 80


def test_the_page_holds_them_below_their_cause() -> None:
    page = html(report_page(Report((log(*CUT[:8]),))))
    assert page.count('class="finding ') == 8
    assert page.count("<details class=") == 1
    head = page[page.index('<ol class="findings">') :]
    assert head.startswith('<ol class="findings"><li class="finding critical" data-find><span class="badge critical">')
    assert '<details class="follows" open><summary>What follows from it: 2 critical, 4 warnings, 1 notice' in page


def test_a_state_of_the_whole_log_explains_nothing_critical() -> None:
    rows = (
        finding("gnss.poor", (0.0, 100.0), severity=NOTICE),
        finding("estimator.refused.velocity", (40.0, 48.0)),
        finding("control.attitude_lost", (49.0, 52.0), severity=CRITICAL),
        finding("estimator.position_lost", (70.0, 72.0), severity=CRITICAL),
    )
    groups = shape(group_findings(Report((log(*rows),))))
    assert ("control.attitude_lost", []) in groups
    assert ("estimator.position_lost", []) in groups
    assert ("gnss.poor", []) in groups


def test_all_sensors_that_fall_silent_at_once_are_one_outage() -> None:
    ((cause, follow),) = shape(group_findings(Report((log(*CUT[2:7]),))))
    assert cause == "sensors.gap"
    assert len(follow) == 4


@pytest.mark.parametrize(
    ("cause", "effect", "follows"),
    [
        # Reach: five seconds after the end of the fault.
        (finding("faults.injected", (40.0, 45.0)), finding("power.low", 50.0), True),
        (finding("faults.injected", (40.0, 45.0)), finding("power.low", 50.01), False),
        # Both began together: up to a second, or three for what must last.
        (finding("faults.injected", (40.0, 45.0)), finding("power.low", 39.0), True),
        (finding("faults.injected", (40.0, 45.0)), finding("power.low", 38.99), False),
        (finding("faults.injected", (40.0, 45.0)), finding("control.off", (37.0, 60.0)), True),
        (finding("faults.injected", (40.0, 45.0)), finding("control.off", (36.99, 60.0)), False),
        # The order of kinds decides within a second, the time does beyond.
        (finding("gnss.silent", (40.0, 41.0)), finding("sensors.gap", (39.5, 41.0)), False),
        (finding("sensors.gap", (40.0, 41.0)), finding("gnss.silent", (39.5, 41.0)), True),
        # Half of the effect's spans.
        (finding("faults.injected", (40.0, 45.0)), finding("power.low", 41.0, 90.0), True),
        (finding("faults.injected", (40.0, 45.0)), finding("power.low", 41.0, 80.0, 90.0), False),
        (finding("faults.injected", (10.0, 11.0), (80.0, 81.0)), finding("power.low", 12.0, 82.0, 60.0), True),
        # A finding without an instant has no cause, but for those of the whole log.
        (finding("faults.injected", (40.0, 45.0)), finding("power.low"), False),
        (finding("gnss.no_fix"), finding("arming.refused"), True),
        # A state explains what begins soon after it: a minute, if its own beginning was seen.
        (finding("gnss.drift", (11.0, 90.0)), finding("control.off", (71.0, 80.0)), True),
        (finding("gnss.drift", (11.0, 90.0)), finding("control.off", (71.1, 80.0)), False),
        (finding("gnss.drift", (10.0, 90.0)), finding("control.off", (40.0, 80.0)), True),
        (finding("gnss.drift", (10.0, 90.0)), finding("control.off", (40.1, 80.0)), False),
        (finding("gnss.drift", (11.0, 71.0)), finding("control.off", (90.0, 95.0)), True),  # a minute is an event
    ],
)
def test_how_far_a_cause_reaches(cause: Finding, effect: Finding, follows: bool) -> None:
    groups = {each.cause.finding.key: each for each in group_findings(Report((log(effect, cause),)))}
    assert (effect.key not in groups) is follows
    told = [each.finding.key for group in groups.values() for each in group.consequences]
    assert (effect.key in told) is follows


@pytest.mark.parametrize(
    ("first", "again", "once"),
    [
        ((40.0, 45.0), (47.0, 50.0), True),
        ((40.0, 45.0), (47.1, 50.0), False),
        ((40.0, 45.0), (39.0, 39.5), True),
        ((40.0, 45.0), (38.9, 50.0), False),  # a finding is not under a later one
    ],
)
def test_two_files_of_one_run_tell_of_a_finding_once(first, again, once: bool) -> None:
    files = (log(finding("missions.unfinished", first)), log(finding("missions.unfinished", again), name="two.bin"))
    groups = group_findings(Report(files))
    assert len(groups) == (1 if once else 2)
    if once:
        assert groups[0].cause.file.name == "one.bin"
        assert groups[0].consequences[0].file.name == "two.bin"
    same = group_findings(Report((log(finding("missions.unfinished", first), finding("missions.unfinished", again)),)))
    assert len(same) == 2  # of one file they are two


def test_good_findings_are_contradicted_by_warnings_only() -> None:
    good = finding("control.followed", 5.0, severity=Severity.OK)
    followed = {
        key: [
            each.key
            for file in without_contradictions((log(good), log(finding(key, 50.0, severity=severity), name="two")))
            for section in file.sections
            for each in section.findings
        ]
        for key, severity in (
            ("control.off", WARNING), ("control.late", NOTICE), ("actuation.stuck", CRITICAL), ("gnss.drift", WARNING),
        )
    }  # fmt: skip
    assert followed == {
        "control.off": ["control.off"],
        "control.late": ["control.followed", "control.late"],
        "actuation.stuck": ["actuation.stuck"],
        "gnss.drift": ["control.followed", "gnss.drift"],
    }
    assert is_contradicted(good, ["control.off"])
    assert not is_contradicted(finding("control.followed", 5.0, severity=NOTICE), ["control.off"])
    assert is_kind("events.error.5", ("events.error",))
    assert not is_kind("events.error_5", ("events.error",))
