from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from tests.golden import Golden
from tests.recorded_run import recorded_run
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.model.sections import Section, Severity
from xitl_cli.plugins.logs.analyses.parameters import analyse

S = 1_000_000_000
ARMED = MadeTable("ARM", [10 * S, 50 * S], {"ArmState": [1, 0]})


def parameters(*rows: tuple[int, str, float, float], defaults: bool = True) -> MadeTable:
    at, names, values, known = zip(*rows, strict=True)
    columns: dict[str, Any] = {"Name": names, "Value": np.array(values, np.float32)}
    if defaults:
        columns["Default"] = np.array(known, np.float32)
    return MadeTable("PARM", [second * S for second in at], columns)


def section_of(*tables: MadeTable) -> Section:
    found = analyse(MadeLog(*tables))
    assert found is not None
    return found


def facts(section: Section) -> dict[str, object]:
    return {fact.key: fact.value for fact in section.facts}


def test_changes_and_what_differs_from_the_default() -> None:
    section = section_of(
        parameters(
            (1, "WP_SPEED", 2.0, 2.0),
            (1, "CRUISE_SPEED", 3.3, 2.0),
            (1, "SCALING_FACTOR", 1.0, float("nan")),
            (5, "WP_SPEED", 2.0, 2.0),
            (7, "WP_SPEED", 4.5, 2.0),
        ),
        ARMED,
    )
    assert facts(section) == {
        "parameters": 3,
        "differ_from_default": 2,
        "changes": 1,
        "changes_by_run": 0,
        "changes_by_itself": 0,
    }
    changed, differ = section.grids
    assert changed.rows == ((7.0, "WP_SPEED", 2.0, 4.5, "not armed"),)
    assert differ.rows == (("CRUISE_SPEED", 3.3, 2.0), ("WP_SPEED", 4.5, 2.0))
    assert not section.findings


def test_a_change_while_armed(golden: Golden) -> None:
    section = section_of(parameters((1, "ATC_STR_RAT_P", 0.2, 0.2), (20, "ATC_STR_RAT_P", 0.4, 0.2)), ARMED)
    (finding,) = section.findings
    assert finding.severity is Severity.NOTICE
    golden("finding", finding.sentence, "0:20.0", "0.2", "0.4")
    assert finding.evidence[0].field == "ATC_STR_RAT_P"
    assert finding.evidence[0].at_ns == 20 * S


def test_what_the_autopilot_writes_itself_is_no_finding() -> None:
    rows = ((1, "STAT_RUNTIME", 30.0, 0.0), (20, "STAT_RUNTIME", 60.0, 0.0))
    more = ((1, "BARO1_GND_PRESS", 1e5, 0.0), (21, "BARO1_GND_PRESS", 101e3, 0.0))
    section = section_of(parameters(*rows, *more), ARMED)
    assert not section.findings
    assert facts(section)["changes_by_itself"] == 2
    assert [row[1] for row in section.grids[0].rows] == ["BARO1_GND_PRESS"]


def test_an_old_log_without_defaults_says_so() -> None:
    section = section_of(parameters((1, "WP_SPEED", 2.0, 0.0), defaults=False))
    assert "differ_from_default" not in facts(section)
    assert len(section.lacks) == 1


def test_the_ekf_check_switched_off() -> None:
    section = section_of(parameters((1, "FS_EKF_THRESH", 0.0, 0.8)), ARMED)
    assert [finding.key for finding in section.findings] == ["parameters.ekf_failsafe_off"]


def test_numbers_that_are_none_are_left_out() -> None:
    section = section_of(parameters((1, "WP_SPEED", 2.0, 2.0), (2, "WP_SPEED", float("nan"), 2.0)))
    assert facts(section)["changes"] == 0


def test_no_parameters_no_numbers() -> None:
    section = section_of(ARMED)
    assert section.lacks
    assert not section.facts


@pytest.mark.slow
def test_what_xitl_sets_for_a_run_is_no_change_by_others() -> None:
    with DataFlashLog(recorded_run() / "autopilot.bin") as log:
        section = analyse(log)
    assert section is not None
    found = facts(section)
    assert found["changes"] == 0
    assert isinstance(found["changes_by_run"], int)
    assert found["changes_by_run"] > 0
    assert any(row[-1] == "not armed, by xitl" for row in section.grids[0].rows)
