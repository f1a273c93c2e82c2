"""What four logs of a real ArduRover say, against what pymavlink reads of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.recorded import LOGS, MISSION_TLOG
from xitl_cli.log_analyses import log_analyses
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.formats.tlog.file import TelemetryLog
from xitl_cli.logs.model.sections import Section, Severity

ANALYSES = ("vehicle", "modes", "arming", "events", "missions", "parameters", "estimator")
SENTENCES = {"calm": 18, "gust": 18, "external-ahrs": 34, "linux-hal-injected": 28}


@pytest.fixture(scope="module")
def sections() -> dict[str, dict[str, Section]]:
    found: dict[str, dict[str, Section]] = {}
    for name in SENTENCES:
        with DataFlashLog(path_of(name)) as log:
            found[name] = {analysis.name: analysis.analyse(log) for analysis in log_analyses(ANALYSES)}
    return found


def path_of(name: str) -> Path:
    return LOGS / f"boat-auto-{name}.bin"


def facts(section: Section) -> dict[str, Any]:
    return {fact.key: fact.value for fact in section.facts}


def findings(sections: dict[str, Section]) -> dict[str, Severity]:
    return {finding.key: finding.severity for section in sections.values() for finding in section.findings}


@pytest.mark.medium
def test_a_healthy_log_is_worth_one_notice(sections: dict[str, dict[str, Section]]) -> None:
    for name in ("calm", "gust"):
        assert findings(sections[name]) == {"vehicle.simulated": Severity.NOTICE}


@pytest.mark.parametrize("name", SENTENCES)
def test_everything_that_pymavlink_reads_is_in_the_table(sections: dict[str, dict[str, Section]], name: str) -> None:
    from pymavlink import DFReader  # type: ignore[import-untyped]

    reader = DFReader.DFReader_binary(str(path_of(name)))
    said, waypoints, armed, errors = [], [], [], []
    while (row := reader.recv_match(type=["MSG", "MISE", "ARM", "ERR"])) is not None:
        kind = row.get_type()
        if kind == "MSG":
            said.append((round(row.TimeUS * 1e-6, 3), row.Message))
        elif kind == "MISE":
            waypoints.append((row.CNum, row.TimeUS))
        elif kind == "ARM":
            armed.append((bool(row.ArmState), row.TimeUS))
        else:
            errors.append((row.Subsys, row.ECode))
    reader.close()
    table = sections[name]["events"].grids[0]
    assert [(row[0], row[3]) for row in table.rows if row[1] == "MSG"] == sorted(said, key=lambda one: one[0])
    assert len(said) == SENTENCES[name]
    assert sum(1 for row in table.rows if row[1] == "ERR") == len(errors)
    assert [row[0] for row in sections[name]["missions"].grids[0].rows] == [seq for seq, _ in waypoints]
    if armed:
        assert facts(sections[name]["arming"])["first_armed_s"] == round(armed[0][1] * 1e-6, 3)


def test_who_made_them(sections: dict[str, dict[str, Section]]) -> None:
    for name, board in (("calm", "SITL (a simulator)"), ("linux-hal-injected", "Linux")):
        found = facts(sections[name]["vehicle"])
        assert found["vehicle"] == "rover"
        assert found["firmware"] == "ArduRover V4.7.0-dev (2598e9d4)"
        assert found["firmware_commit"] == "2598e9d4"
        assert found["board"] == board


def test_the_square_that_was_sailed(sections: dict[str, dict[str, Section]]) -> None:
    found = facts(sections["calm"]["missions"])
    assert (found["waypoints"], found["waypoints_reached"], found["mission_completed"]) == (4, 4, True)
    # Sides of 60, 40, 60 and 40 m (0.000539 and 0.0003637 degrees at 8.8 S); of the first there is no waypoint before.
    assert found["mission_length_m"] == pytest.approx(139.6, abs=0.1)


def test_what_went_wrong_on_the_linux_board(sections: dict[str, dict[str, Section]]) -> None:
    found = findings(sections["linux-hal-injected"])
    assert found["arming.disarmed_by_failsafe"] is Severity.CRITICAL
    assert found["missions.unfinished"] is Severity.WARNING
    assert found["events.error.18.4"] is Severity.WARNING
    assert found["modes.failsafe.link"] is Severity.NOTICE
    assert "vehicle.simulated" not in found


def test_sensors_from_outside_leave_the_simulated_vehicle_behind(sections: dict[str, dict[str, Section]]) -> None:
    found = findings(sections["external-ahrs"])
    assert found["estimator.truth_of_another"] is Severity.NOTICE
    assert "estimator.position_error" not in found
    # The second core is fed by the simulator's own IMU.
    assert found["estimator.cores_apart.position"] is Severity.NOTICE
    assert found["events.error.3.4"] is Severity.WARNING


def test_the_estimator_of_a_simulated_boat_against_its_truth(sections: dict[str, dict[str, Section]]) -> None:
    found = facts(sections["calm"]["estimator"])
    # The receiver's noise and the filter's lag are decimetres; the yaw begins 2.4 degrees off (27.9 for 30.3).
    assert 0.01 < found["position_error_rms_m"] < 0.3
    assert found["yaw_error_max_deg"] == pytest.approx(2.42, abs=0.05)
    assert facts(sections["external-ahrs"]["estimator"])["origin_set"] == 14.643


def test_telemetry_of_the_same_mission() -> None:
    with TelemetryLog(MISSION_TLOG) as log:
        found = {analysis.name: analysis.analyse(log) for analysis in log_analyses(ANALYSES)}
    assert facts(found["vehicle"])["vehicle"] == "rover"
    assert facts(found["vehicle"])["vehicle_type"] == "surface boat"
    assert [row[3] for row in found["modes"].grids[0].rows] == ["MANUAL", "AUTO"]
    assert facts(found["missions"])["waypoints_reached"] == 4
    assert facts(found["missions"])["mission_completed"] is True
    assert all(section.worst <= Severity.NOTICE for section in found.values())
