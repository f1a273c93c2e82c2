"""A cause comes before what follows from it and is near it in time, in real logs and in generated findings."""

import random
from pathlib import Path

import numpy as np
import pytest
from real_reports import report_of_log

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.log import LogHealth
from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.logs.report.causes import CAUSES, WHOLE_LOG, group_findings
from xitl_cli.logs.report.file_report import FileFinding, FileReport
from xitl_cli.logs.report.model import Report
from xitl_cli.logs.signals.spans import spells

S = 1_000_000_000
TOGETHER_S, SLOW_TOGETHER_S = 1.0, 3.0
KINDS = sorted({kind for rule in CAUSES for kind in (*rule.causes, *rule.consequences)})
WHOLE_LOG_CAUSES = {kind for rule in CAUSES if rule.after_s == WHOLE_LOG for kind in rule.causes}


def finding(key: str, *spans_s: tuple[float, float]) -> Finding:
    evidence = tuple(Evidence("X", None, round(begin * S), round(end * S)) for begin, end in spans_s)
    return Finding(key, Severity.WARNING, key, evidence, "look")


def report_of(findings: list[Finding]) -> Report:
    sections = tuple(Section(each.key.split(".")[0], each.key, findings=(each,)) for each in findings)
    file = FileReport(
        "a.bin", Path("a.bin"), "dataflash", "boot", (0, 400 * S), LogHealth(1, 1), {}, sections, TimeLine()
    )
    return Report((file,))


def begin_s(found: FileFinding) -> float | None:
    begins = [each.at_ns for each in found.finding.evidence if each.at_ns is not None]
    return found.file.time_line.second(min(begins)) if begins else None


def check(report: Report) -> None:
    groups = group_findings(report)
    shown = [id(each.finding) for group in groups for each in (group.cause, *group.consequences)]
    assert sorted(shown) == sorted(id(each.finding) for each in report.findings)
    for group in groups:
        cause_s = begin_s(group.cause)
        for each in group.consequences:
            assert each.finding.key != "missions.log_ended"
            if group.cause.finding.key in WHOLE_LOG_CAUSES or cause_s is None:
                continue
            at_s = begin_s(each)
            assert at_s is not None
            slow = each.finding.key.split(".")[0] in ("control", "radio")
            assert cause_s <= at_s + (SLOW_TOGETHER_S if slow else TOGETHER_S)


def test_rows_at_both_ends_are_two_spells() -> None:
    stamps = np.arange(4000, dtype=np.int64) * (S // 10)
    bad = np.zeros(4000, dtype=np.bool_)
    bad[:12], bad[-620:] = True, True
    bad[-300:-295] = False
    assert spells(stamps, bad) == [(0, 11 * S // 10), (338 * S, int(stamps[-1]))]


def test_a_turn_just_before_a_fault_begins_the_spell_that_the_fault_keeps() -> None:
    """A speed counts as too low after 15 s. A reversed propeller kept it low for 17 s of these 18 s."""
    reversed_propeller = finding("actuation.reversed", (30.4, 45.6))
    for key, begin_s, count in (("control.too_slow", 29.0, 1), ("control.too_slow", 20.0, 2)):
        groups = group_findings(report_of([finding(key, (begin_s, 47.0)), reversed_propeller]))
        assert len(groups) == count
    assert groups[0].cause.finding.key == "control.too_slow"


def test_what_comes_between_two_spells_has_another_cause() -> None:
    unhealthy = finding("sensors.unhealthy", (0.0, 1.1), (338.0, 399.9))
    between = [finding("control.rate_lost", (100.0, 103.0)), finding("modes.failsafe", (200.0, 200.0))]
    after = finding("estimator.yaw_reset", (340.0, 340.0))
    groups = {group.cause.finding.key: group for group in group_findings(report_of([unhealthy, *between, after]))}
    assert set(groups) == {"sensors.unhealthy", "control.rate_lost", "modes.failsafe"}
    assert [each.finding.key for each in groups["sensors.unhealthy"].consequences] == ["estimator.yaw_reset"]


def test_a_state_that_held_from_the_start_explains_nothing_later() -> None:
    rows = [finding("sensors.unhealthy", (0.5, 399.0)), finding("estimator.refused.velocity", (300.0, 310.0))]
    assert len(group_findings(report_of(rows))) == 2


@pytest.mark.parametrize("seed", range(40))
def test_generated_findings_keep_the_order_of_time(seed: int) -> None:
    rng = random.Random(seed)
    rows = []
    for key in rng.sample(KINDS, 25):
        begins = sorted(rng.uniform(0.0, 380.0) for _ in range(rng.randint(1, 3)))
        rows.append(finding(key, *((begin, begin + rng.choice((0.0, 0.4, 5.0, 100.0))) for begin in begins)))
    check(report_of(rows))


@pytest.mark.medium
@pytest.mark.parametrize("name", ["boat-auto-calm", "boat-auto-external-ahrs", "boat-auto-linux-hal-injected"])
def test_real_logs_keep_the_order_of_time(name: str) -> None:
    report = report_of_log(name)
    check(report)
    unhealthy = [group for group in group_findings(report) if group.cause.finding.key == "sensors.unhealthy"]
    for group in unhealthy:  # barometers without a source, from the first row to the last
        assert not [each for each in group.consequences if each.finding.key.startswith(("missions", "gnss"))]


def test_a_failsafe_of_the_radio_has_no_barometer_as_its_cause() -> None:
    barometer = finding("sensors.unhealthy", (9.6, 9.8))
    failsafe = finding("modes.failsafe.link", (10.6, 10.6))
    heard = finding("events.said.radio_failsafe", (10.5, 10.5))
    groups = {group.cause.finding.key for group in group_findings(report_of([barometer, failsafe]))}
    assert groups == {"sensors.unhealthy", "modes.failsafe.link"}
    groups = {group.cause.finding.key for group in group_findings(report_of([barometer, failsafe, heard]))}
    assert groups == {"sensors.unhealthy", "events.said.radio_failsafe"}


@pytest.mark.medium
def test_a_radio_failsafe_of_a_real_log_follows_no_sensor() -> None:
    report = report_of_log("boat-auto-linux-hal-injected")
    for group in group_findings(report):
        below = [each.finding.key for each in group.consequences]
        assert not (group.cause.finding.key.startswith("sensors") and "modes.failsafe.link" in below)
