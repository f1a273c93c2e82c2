from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Section, Severity
from xitl_cli.plugins.logs.analyses.missions import analyse, mission_versions

S = 1_000_000_000
METRE_DEG = 1.0 / 110_574.3  # of latitude at the equator on WGS 84 (6 378 137 m, 1/298.257: M(0) = 6 335 439 m)
EAST_DEG = 1.0 / 111_319.49  # of longitude there
ROVER = MadeTable("VER", [0], {"BU": [1], "FWS": ["ArduRover V4.5.0 (0123abcd)"]})
SQUARE = [(0.0, 0.0), (100.0, 0.0), (100.0, 50.0)]
"""Home, then two waypoints: metres north and east."""


def commands(at_s: int, places: list[tuple[float, float]]) -> dict[str, list[Any]]:
    return {
        "at": [at_s * S] * len(places),
        "CTot": [len(places)] * len(places),
        "CNum": list(range(len(places))),
        "CId": [16] * len(places),
        "Lat": [north * METRE_DEG for north, _ in places],
        "Lng": [1.0 + east * EAST_DEG for _, east in places],
        "Alt": [0.0] * len(places),
        "Frame": [3] * len(places),
    }


def loaded(*uploads: dict[str, list[Any]]) -> MadeTable:
    rows: dict[str, list[Any]] = {name: [each for upload in uploads for each in upload[name]] for name in uploads[0]}
    return MadeTable("CMD", rows.pop("at"), rows)


def taken_up(*rows: tuple[int, int]) -> MadeTable:
    return MadeTable("MISE", [at * S for at, _ in rows], {"CNum": [seq for _, seq in rows]})


def said(*texts: tuple[int, str]) -> MadeTable:
    return MadeTable("MSG", [at * S for at, _ in texts], {"Message": [text for _, text in texts]})


def auto(from_s: int, until_s: int, reason: int = 8) -> MadeTable:
    values = {"Mode": [0, 10, 4], "ModeNum": [0, 10, 4], "Rsn": [26, 2, reason]}
    return MadeTable("MODE", [0, from_s * S, until_s * S], values)


def disarmed(at_s: int, method: int) -> MadeTable:
    return MadeTable("ARM", [9 * S, at_s * S], {"ArmState": [1, 0], "Method": [1, method]})


def sailed(offset_m: float = 0.0) -> MadeTable:
    """North to 100 m from 10 to 60 s at 2 m/s, `offset_m` east of the line; then east to 50 m until 85 s."""
    at_s = np.arange(0, 100, 1.0)
    north = np.clip((at_s - 10.0) * 2.0, 0.0, 100.0)
    east = np.clip((at_s - 60.0) * 2.0, 0.0, 50.0)
    east = np.where(at_s <= 60.0, offset_m, east)
    values = {"Lat": north * METRE_DEG, "Lng": 1.0 + east * EAST_DEG, "Alt": np.full(len(at_s), 5.0)}
    return MadeTable("POS", (at_s * S).astype(np.int64), values)


def section_of(*tables: MadeTable) -> Section:
    found = analyse(MadeLog(ROVER, *tables))
    assert found is not None
    return found


def facts(section: Section) -> dict[str, Any]:
    return {fact.key: fact.value for fact in section.facts}


def whole_mission(offset_m: float = 0.0) -> Section:
    return section_of(
        loaded(commands(1, SQUARE)),
        taken_up((10, 1), (60, 2)),
        auto(10, 85),
        sailed(offset_m),
        said((60, "Reached waypoint #1"), (85, "Reached waypoint #2"), (85, "Mission Complete")),
    )


def test_a_completed_mission() -> None:
    section = whole_mission()
    found = facts(section)
    assert (found["waypoints"], found["waypoints_reached"], found["mission_completed"]) == (2, 2, True)
    # Only between waypoints: home is no waypoint.
    assert found["mission_length_m"] == pytest.approx(50.0, abs=0.1)
    assert found["mission_time_s"] == 75.0
    assert not section.findings


def test_each_leg_with_its_way_and_speed() -> None:
    first, second = (
        dict(zip(grid.columns, row, strict=True)) for grid in [whole_mission().grids[0]] for row in grid.rows
    )
    assert (first["item"], first["begun (s)"], first["reached (s)"]) == (1, 10.0, 60.0)
    # 100 m in 50 s, on the line: positions are exact but for degrees of metres rounded nowhere.
    assert first["way (m)"] == pytest.approx(100.0, abs=0.1)
    assert first["mean speed (m/s)"] == pytest.approx(2.0, abs=0.01)
    assert first["cross track max (m)"] == pytest.approx(0.0, abs=0.01)
    assert second["leg (m)"] == pytest.approx(50.0, abs=0.1)


def test_a_waypoint_that_is_told_just_after_the_next_was_taken_up_is_reached() -> None:
    section = section_of(
        loaded(commands(1, SQUARE)),
        taken_up((10, 1), (60, 2)),
        said((61, "Reached waypoint 1"), (86, "Reached waypoint 2")),
        auto(10, 90),
        sailed(),
    )
    assert facts(section)["waypoints_reached"] == 2
    reached = section.grids[0].columns.index("reached (s)")
    assert [row[reached] for row in section.grids[0].rows] == [60.0, 86.0]


def test_cross_track_against_a_straight_line() -> None:
    """The first leg begins where the vessel is, so an offset start is on the line; one that grows is not."""
    at_s = np.arange(0, 61, 1.0)
    east = 3.0 * np.sin(np.pi * np.clip(at_s - 10.0, 0.0, 50.0) / 50.0)
    north = np.clip((at_s - 10.0) * 2.0, 0.0, 100.0)
    position = MadeTable(
        "POS",
        (at_s * S).astype(np.int64),
        {"Lat": north * METRE_DEG, "Lng": 1.0 + east * EAST_DEG, "Alt": np.zeros(len(at_s))},
    )
    section = section_of(
        loaded(commands(1, SQUARE)),
        taken_up((10, 1), (60, 2)),
        auto(10, 85),
        position,
        said((60, "Reached waypoint #1")),
    )
    # A half sine of amplitude 3: the largest is 3, the root mean square over 51 samples is 3 sqrt(25 / 51).
    row = dict(zip(section.grids[0].columns, section.grids[0].rows[0], strict=True))
    assert row["cross track max (m)"] == pytest.approx(3.0, abs=0.01)
    assert row["cross track RMS (m)"] == pytest.approx(3.0 * math.sqrt(25 / 51), abs=0.01)


@pytest.mark.parametrize(
    ("extra", "why"),
    [
        ((auto(10, 40),), "the mode became HOLD at 0:40.0 (end of mission)"),
        (
            (auto(10, 95), MadeTable("ARM", [9 * S, 50 * S], {"ArmState": [1, 0]})),
            "it was disarmed at 0:50.0",
        ),
    ],
)
def test_why_a_mission_was_not_completed(extra: tuple[MadeTable, ...], why: str) -> None:
    section = section_of(loaded(commands(1, SQUARE)), taken_up((10, 1)), sailed(), said((1, "x")), *extra)
    (finding,) = section.findings
    assert finding.severity is Severity.WARNING
    assert finding.sentence == f"The mission was not completed: 0 of 2 waypoints reached; {why}"


@pytest.mark.parametrize(
    ("extra", "why", "severity"),
    [
        ((auto(10, 40, reason=2),), "the mode became HOLD at 0:40.0 (ground station)", Severity.NOTICE),
        ((auto(10, 40, reason=6),), "the mode became HOLD at 0:40.0 (EKF failsafe)", Severity.WARNING),
        ((auto(10, 95), disarmed(50, method=1)), "it was disarmed at 0:50.0 (ground station)", Severity.NOTICE),
        ((auto(10, 95), disarmed(50, method=12)), "it was disarmed at 0:50.0 (crash check)", Severity.WARNING),
    ],
)
def test_a_mission_that_a_person_ended_is_a_notice(extra: tuple[MadeTable, ...], why: str, severity: Severity) -> None:
    section = section_of(loaded(commands(1, SQUARE)), taken_up((10, 1)), sailed(), said((1, "x")), *extra)
    (finding,) = section.findings
    assert finding.severity is severity
    assert finding.sentence == f"The mission was not completed: 0 of 2 waypoints reached; {why}"


def test_a_mission_loaded_again_is_one_version_and_a_changed_one_is_two() -> None:
    other = [SQUARE[0], SQUARE[1], (100.0, 80.0)]
    log = MadeLog(loaded(commands(1, SQUARE), commands(5, SQUARE), commands(30, other)))
    assert [version.at_ns for version in mission_versions(log)] == [1 * S, 30 * S]


@pytest.mark.parametrize(("message", "scale"), [("MISSION_ITEM_INT", 1e7), ("MISSION_ITEM", 1.0)])
def test_the_mission_of_a_telemetry_log_is_in_degrees(message: str, scale: float) -> None:
    """Home, two waypoints, a change of speed, a waypoint without a place, a damaged row, and the first item again."""
    lat_deg, lon_deg = [52.5, 52.6, -33.0, 0.0, 0.0, 99.0, 52.5], [13.0, 13.1, 151.2, 0.0, 0.0, 99.0, 13.0]
    columns = {
        "seq": [0, 1, 2, 3, 4, 60_000, 0],
        "command": [16, 16, 21, 178, 16, 16, 16],
        "x": np.round(np.array(lat_deg) * scale, 6),
        "y": np.round(np.array(lon_deg) * scale, 6),
        "z": [30.0, 1.0, 2.0, 0.0, 0.0, 0.0, 30.0],
        "frame": [0, 3, 6, 2, 3, 3, 0],
    }
    log = MadeLog(MadeTable(message, np.arange(7) * S, columns), kind="tlog")
    first, again = mission_versions(log)
    assert (first.at_ns, again.at_ns, list(again.items)) == (0, 6 * S, [0])
    assert list(first.items) == [0, 1, 2, 3, 4]
    assert [(item.seq, item.command, item.altitude_m, item.frame) for item in first.places] == [
        (1, 16, 1.0, 3),
        (2, 21, 2.0, 6),
    ]
    assert [(item.latitude_deg, item.longitude_deg) for item in first.places] == [
        pytest.approx((52.6, 13.1)),
        pytest.approx((-33.0, 151.2)),
    ]


def test_a_mission_that_was_changed_under_way() -> None:
    other = [SQUARE[0], SQUARE[1], (100.0, 80.0)]
    section = section_of(
        loaded(commands(1, SQUARE), commands(30, other)),
        taken_up((10, 1), (60, 2)),
        auto(10, 85),
        sailed(),
        said((60, "Reached waypoint #1"), (85, "Reached waypoint #2")),
    )
    assert [finding.key for finding in section.findings] == ["missions.changed"]
    assert "20.0 s after it began" in section.findings[0].sentence


def test_waypoints_that_were_taken_up_before_auto_are_no_leg() -> None:
    section = section_of(
        loaded(commands(1, SQUARE)), taken_up((2, 1)), auto(10, 85), sailed(), said((60, "Reached waypoint #1"))
    )
    assert section.grids[0].rows[0][2] == 10.0


def test_no_mission_no_section() -> None:
    assert analyse(MadeLog(ROVER, sailed())) is None
