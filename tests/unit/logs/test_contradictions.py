"""No report says that something is fine next to a finding that it is not."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from real_reports import report_of_log

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.log import LogHealth
from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.logs.report.causes import CONTRADICTED, is_contradicted, without_contradictions
from xitl_cli.logs.report.file_report import FileReport
from xitl_cli.logs.report.model import Report


def file_of(*findings: Finding) -> FileReport:
    sections = tuple(Section(each.key.split(".")[0], each.key, findings=(each,)) for each in findings)
    return FileReport("a", Path("a"), "mcap", "simulation", (0, 1), LogHealth(1, 1), {}, sections, TimeLine())


def bad(key: str) -> Finding:
    return Finding.warning(key, key, (Evidence("X", None, 0, 1),), "look")


def check(report: Report) -> None:
    worse = {each.finding.key for each in report.findings if each.finding.severity >= Severity.WARNING}
    for each in report.findings:
        assert not is_contradicted(each.finding, worse), each.finding.sentence


@pytest.mark.parametrize("key", sorted(CONTRADICTED))
def test_what_another_finding_contradicts_is_not_called_fine(key: str) -> None:
    fine = Finding.ok(key, "all is well")
    for other in CONTRADICTED[key]:
        files = without_contradictions([file_of(fine), file_of(bad(f"{other}"))])
        assert [each.finding.key for each in Report(files).findings] == [other]
    (alone,) = without_contradictions([file_of(fine, bad("power.low"))])
    assert len(Report((alone,)).findings) == 2


@pytest.mark.parametrize("seed", range(20))
def test_generated_findings_do_not_contradict_each_other(seed: int) -> None:
    rng = random.Random(seed)
    kinds = sorted({kind for kinds in CONTRADICTED.values() for kind in kinds})
    rows = [Finding.ok(key, key) for key in rng.sample(sorted(CONTRADICTED), 3)]
    rows += [bad(kind) for kind in rng.sample(kinds, 4)]
    check(Report(without_contradictions([file_of(*rows)])))


@pytest.mark.medium
@pytest.mark.parametrize(
    "name", ["boat-auto-calm", "boat-auto-gust", "boat-auto-external-ahrs", "boat-auto-linux-hal-injected"]
)
def test_real_logs_do_not_contradict_themselves(name: str) -> None:
    check(report_of_log(name))
