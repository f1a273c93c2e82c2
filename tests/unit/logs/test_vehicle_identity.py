from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Section, Severity
from xitl_cli.plugins.logs.analyses.vehicle import analyse

S = 1_000_000_000


def version(board: int = 10) -> MadeTable:
    row: dict[str, Any] = {
        "BT": [board],
        "BST": [5009],
        "Maj": [4],
        "Min": [5],
        "Pat": [7],
        "FWT": [255],
        "GH": [0x2A3DC4B7],
        "FWS": ["ArduCopter V4.5.7 (2a3dc4b7)"],
        "BU": [2],
    }
    return MadeTable("VER", [S], row)


def section_of(*tables: MadeTable) -> Section:
    found = analyse(MadeLog(*tables))
    assert found is not None
    return found


def facts(section: Section) -> dict[str, object]:
    return {fact.key: fact.value for fact in section.facts}


def keys(section: Section) -> set[str]:
    return {finding.key for finding in section.findings}


def test_who_it_is_is_read_from_ver() -> None:
    found = facts(section_of(version(), MadeTable("ATT", np.arange(1, 101) * S, {"Roll": np.zeros(100)})))
    assert found["vehicle"] == "copter"
    assert found["firmware_version"] == "4.5.7"
    assert found["firmware_commit"] == "2a3dc4b7"
    assert found["firmware_release"] == "official release"
    assert found["board"] == "ChibiOS generic"
    assert found["duration_s"] == 99.0
    assert found["uptime_start_s"] == 1.0


def test_before_ver_was_logged_the_sentence_tells() -> None:
    section = section_of(MadeTable("MSG", [0, S], {"Message": ["APM:Copter V3.6.1 (1f2e3d4c)", "Frame: QUAD"]}))
    found = facts(section)
    assert found["vehicle"] == "copter"
    assert found["firmware"] == "APM:Copter V3.6.1 (1f2e3d4c)"
    assert found["firmware_commit"] == "1f2e3d4c"
    assert not section.lacks


def test_a_log_that_does_not_say_says_so() -> None:
    section = section_of(MadeTable("ATT", [0, S], {"Roll": [0.0, 1.0]}))
    assert "firmware" not in facts(section)
    assert len(section.lacks) == 1


def test_utc_at_the_start_from_gps_week_and_time() -> None:
    # GPS week 2200 began on 2022-03-06 00:00:00 GPS time, 18 s before 00:00:00 UTC.
    gps = MadeTable(
        "GPS",
        np.array([10, 11, 12]) * S,
        {"GWk": [2200, 2200, 2200], "GMS": [28_000, 29_000, 30_000], "Status": [3, 3, 3]},
    )
    section = section_of(gps, MadeTable("ATT", np.array([5, 60]) * S, {"Roll": [0.0, 0.0]}))
    assert facts(section)["utc_start"] == "2022-03-06 00:00:05"


def test_no_utc_from_a_receiver_without_a_fix() -> None:
    gps = MadeTable("GPS", [0, S], {"GWk": [2200, 2200], "GMS": [1, 2], "Status": [1, 1]})
    assert "utc_start" not in facts(section_of(gps))


@pytest.mark.parametrize(
    ("table", "told"),
    [
        (version(board=3), True),
        (version(board=10), False),
        (MadeTable("SIM", [0, S], {"Roll": [0.0, 0.0]}), True),
        (MadeTable("PARM", [0], {"Name": ["SIM_SPEEDUP"], "Value": [1.0]}), True),
    ],
)
def test_a_simulator_is_told(table: MadeTable, told: bool) -> None:
    assert ("vehicle.simulated" in keys(section_of(table))) is told


def test_records_that_the_logger_dropped() -> None:
    drops = MadeTable("DSF", np.arange(5) * S, {"Dp": [0, 0, 3, 3, 10]})
    section = section_of(drops)
    (finding,) = section.findings
    assert finding.severity is Severity.WARNING
    assert finding.sentence.startswith("10 records")
    assert finding.evidence[0].at_ns == 2 * S
    assert finding.evidence[0].until_ns == 4 * S


def test_a_reboot_inside_the_log() -> None:
    stamps = np.concatenate([np.arange(10, 40), np.arange(2, 30)]) * S
    tables = [MadeTable(name, stamps, {"x": np.zeros(len(stamps))}) for name in ("ATT", "IMU", "GPS")]
    (finding,) = section_of(*tables).findings
    assert finding.key == "vehicle.reboots"
    assert finding.severity is Severity.CRITICAL
    assert "once" in finding.sentence
    assert "39.0 s" in finding.sentence


def test_one_damaged_stamp_is_no_reboot() -> None:
    stamps = np.arange(10, 60) * S
    stamps[20] = 9_000_000 * S
    stamps[40] = 1
    tables = [MadeTable(name, stamps, {"x": np.zeros(len(stamps))}) for name in ("ATT", "IMU", "GPS")]
    assert "vehicle.reboots" not in keys(section_of(*tables))
