"""Missions: legs, tracks and sentences from a square that is sailed by formula."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from sim_core.geodesy import LocalFrame
from xitl_cli.logs.model.sections import Evidence, Section, Severity
from xitl_cli.logs.signals.missions import mission_versions
from xitl_cli.plugins.logs.analyses.missions import (
    LegTrack,
    MissionLeg,
    analyse,
    executed_items,
    largest_m,
    leg_tracks,
    length_m,
    overall_rms_m,
    reached_at,
)

S = 1_000_000_000
HOME = LocalFrame(47.0, 8.0, 400.0)
CORNERS_M = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 50.0], [0.0, 50.0]])


def ns(at_s: Any) -> np.ndarray:
    return np.round(np.asarray(at_s, dtype=np.float64) * S).astype(np.int64)


def geodetic(places_m: Any) -> tuple[Any, Any, Any]:
    places = np.asarray(places_m, dtype=np.float64)
    return HOME.geodetic(np.column_stack([places, np.zeros(len(places))]))


def plan(at_s: float = 1.0, corners_m: Any = CORNERS_M, command: int = 16) -> MadeTable:
    latitude, longitude, _ = geodetic(corners_m)
    many = len(latitude)
    return MadeTable(
        "CMD", ns(at_s + 0.1 * np.arange(many)),
        {"CTot": np.full(many, many), "CNum": np.arange(many), "CId": np.full(many, command), "Lat": latitude,
        "Lng": longitude,
         "Alt": np.full(many, 5.0), "Frame": np.full(many, 3)},
    )  # fmt: skip


def sailed(aside_m: float = 0.0) -> MadeTable:
    """From home: 10 s at rest, then 50 s to each corner; `aside_m` beside the second leg."""
    at_s = np.arange(0.0, 170.0, 0.5)
    north = np.interp(at_s, [10, 60, 110, 160], CORNERS_M[:, 0])
    east = np.interp(at_s, [10, 60, 110, 160], CORNERS_M[:, 1])
    north += np.where((at_s > 70.0) & (at_s < 100.0), aside_m, 0.0)
    latitude, longitude, altitude = geodetic(np.column_stack([north, east]))
    return MadeTable("POS", ns(at_s), {"Lat": latitude, "Lng": longitude, "Alt": altitude})


def executed(*rows: tuple[float, int]) -> MadeTable:
    return MadeTable("MISE", ns([at for at, _ in rows]), {"CNum": [seq for _, seq in rows]})


def said(*rows: tuple[float, str]) -> MadeTable:
    return MadeTable(
        "MSG", ns([0.0, *(at for at, _ in rows)]), {"Message": ["ArduRover V4.5", *(text for _, text in rows)]}
    )


AUTO = MadeTable("MODE", ns([0.0, 10.0]), {"ModeNum": [0, 10]})
ALL = executed((10.0, 1), (60.0, 2), (110.0, 3))
REACHED = said((60.0, "Reached waypoint #1"), (110.0, "Reached waypoint #2"), (160.0, "Reached waypoint #3"))


def section_of(*tables: MadeTable) -> Section:
    section = analyse(MadeLog(*tables))
    assert section is not None
    return section


def facts(section: Section) -> dict[str, Any]:
    return {fact.key: fact.value for fact in section.facts}


def test_a_mission_that_was_sailed_to_its_end() -> None:
    section = section_of(plan(), sailed(3.0), ALL, REACHED, AUTO)
    assert section.findings == ()
    found = facts(section)
    assert (found["waypoints"], found["waypoints_reached"], found["mission_completed"]) == (3, 3, True)
    assert (found["mission_length_m"], found["mission_time_s"]) == (150.0, 150.0)
    assert found["cross_track_max_m"] == pytest.approx(3.0, abs=1e-3)
    # 59 of the 101 rows of one of three legs of equal length.
    assert found["cross_track_rms_m"] == pytest.approx(3.0 * np.sqrt(59 / 101 / 3.0), abs=2e-3)
    legs, mission = section.grids
    rows = [dict(zip(legs.columns, row, strict=True)) for row in legs.rows]
    assert [(row["item"], row["command"], row["begun (s)"], row["reached (s)"], row["took (s)"]) for row in rows] == [
        (1, "WAYPOINT", 10.0, 60.0, 50.0), (2, "WAYPOINT", 60.0, 110.0, 50.0), (3, "WAYPOINT", 110.0, 160.0, 50.0),
    ]  # fmt: skip
    assert [row["leg (m)"] for row in rows] == [100.0, 50.0, 100.0]
    assert [row["way (m)"] for row in rows] == [100.0, 55.1, 100.0]  # 49 m, and twice 3 m aside while 0.5 m on
    assert [row["mean speed (m/s)"] for row in rows][::2] == [2.0, 2.0]
    assert [row["cross track max (m)"] for row in rows] == [0.0, 3.0, 0.0]
    assert [row[:2] for row in mission.rows] == [(0, "HOME"), (1, "WAYPOINT"), (2, "WAYPOINT"), (3, "WAYPOINT")]


def test_a_leg_that_begins_anywhere_has_its_line_from_there() -> None:
    """The first leg begins off home, so its line does too."""
    (version,) = mission_versions(MadeLog(plan()))
    log = MadeLog(plan(), sailed())
    first, second = leg_tracks(
        log, version, [MissionLeg(1, 35 * S, 60 * S, True), MissionLeg(3, 60 * S, 110 * S, True)]
    )
    assert (first.length_m, first.way_m) == (pytest.approx(50.0, abs=0.01), pytest.approx(50.0, abs=0.01))
    assert first.cross_max_m == pytest.approx(0.0, abs=1e-3)
    # From (100, 0) to (0, 50), but sailed to (100, 50): that corner is 100 x 50 / |(100, 50)| off.
    assert second.length_m == pytest.approx(np.hypot(100.0, 50.0), abs=0.01)
    assert second.cross_max_m == pytest.approx(100.0 * 50.0 / np.hypot(100.0, 50.0), abs=0.05)
    assert leg_tracks(log, None, [MissionLeg(1, 0, S, True)]) == [LegTrack()]
    assert leg_tracks(log, version, [MissionLeg(9, 0, 50 * S, True)]) == [LegTrack()]
    assert length_m(version) == pytest.approx(150.0, abs=0.01)


def test_figures_of_all_legs_are_weighted_by_time() -> None:
    legs = [MissionLeg(1, 0, 10 * S, True), MissionLeg(2, 10 * S, 40 * S, True), MissionLeg(3, 40 * S, 50 * S, False)]
    tracks = [LegTrack(1.0, 1.0, 2.0, 5.0), LegTrack(1.0, 1.0, 4.0, 7.0), LegTrack()]
    assert overall_rms_m(legs, tracks) == pytest.approx(np.sqrt((10 * 4 + 30 * 16) / 40), abs=1e-3)
    assert largest_m(tracks) == 7.0
    assert (overall_rms_m(legs, [LegTrack()] * 3), largest_m([])) == (None, None)


def test_items_by_both_kinds_of_rows() -> None:
    assert executed_items(MadeLog(executed((5.0, 2), (3.0, 1), (6.0, 2), (1.0, 0)))) == [
        (3 * S, 1),
        (5 * S, 2),
        (6 * S, 2),
    ]
    current = MadeTable("MISSION_CURRENT", ns([1, 2, 3, 4, 5]), {"seq": [0, 1, 1, 2, 1]})
    assert executed_items(MadeLog(current, kind="tlog")) == [(2 * S, 1), (4 * S, 2), (5 * S, 1)]


def test_a_waypoint_reported_twice_counts_once() -> None:
    texts = said((10.0, "Reached waypoint #1"), (11.0, "Reached command #2"), (30.0, "reached waypoint 1"))
    reached = MadeTable("MISSION_ITEM_REACHED", ns([10.5, 15.0, 17.0]), {"seq": [1, 1, 1]})
    # 15 s is within five seconds of 10 s.
    assert reached_at(MadeLog(texts, reached)) == [(10 * S, 1), (11 * S, 2), (17 * S, 1), (30 * S, 1)]


@pytest.mark.parametrize(
    ("tables", "key", "severity", "why", "at_s"),
    [
        ([], "missions.log_ended", Severity.NOTICE, "the log ends at 2:49.5, under way to item 2", 169.5),
        (
            [MadeTable("ARM", ns([5.0, 80.0]), {"ArmState": [1, 0]})], "missions.unfinished", Severity.WARNING,
            "it was disarmed at 1:20.0", 80.0,
        ),
    ],
)  # fmt: skip
def test_a_mission_that_was_not_completed(
    tables: list[MadeTable], key: str, severity: Severity, why: str, at_s: float
) -> None:
    section = section_of(
        plan(), sailed(), executed((10.0, 1), (60.0, 2)), said((60.0, "Reached waypoint #1")), AUTO, *tables
    )
    (finding,) = section.findings
    assert (finding.key, finding.severity) == (key, severity)
    assert finding.sentence == f"The mission was not completed: 1 of 3 waypoints reached; {why}"
    assert finding.evidence == (Evidence("MISE", None, round(at_s * S)),)
    assert facts(section)["mission_completed"] is False


def test_a_mode_that_ends_a_mission() -> None:
    modes = MadeTable("MODE", ns([0.0, 10.0, 90.0]), {"ModeNum": [0, 10, 4]})
    section = section_of(plan(), sailed(), executed((10.0, 1), (60.0, 2)), said((60.0, "Reached waypoint #1")), modes)
    (finding,) = section.findings
    assert finding.sentence == "The mission was not completed: 1 of 3 waypoints reached; the mode became HOLD at 1:30.0"
    legs = section.grids[0]
    assert dict(zip(legs.columns, legs.rows[1], strict=True))["took (s)"] == 30.0


@pytest.mark.parametrize(
    "tables",
    [
        [said((60.0, "Reached waypoint #1"), (120.0, "Mission complete"))],
        [said((60.0, "Reached waypoint #3"))],  # the last one
        [MadeTable("MISSION_CURRENT", ns([50.0, 120.0]), {"seq": [1, 2], "mission_state": [3, 5]})],
    ],
)
def test_a_mission_is_complete_by_what_the_autopilot_says(tables: list[MadeTable]) -> None:
    section = section_of(plan(), sailed(), executed((10.0, 1), (60.0, 3)), AUTO, *tables)
    assert facts(section)["mission_completed"] is True
    assert section.findings == ()


def test_a_leg_begins_in_auto_while_armed() -> None:
    modes = MadeTable("MODE", ns([0.0, 20.0, 100.0, 120.0]), {"ModeNum": [0, 10, 0, 10]})
    armed = MadeTable("ARM", ns([0.0, 25.0]), {"ArmState": [0, 1]})
    section = section_of(plan(), sailed(), executed((1.0, 1), (60.0, 2), (105.0, 3)), REACHED, modes, armed)
    rows = [dict(zip(section.grids[0].columns, row, strict=True)) for row in section.grids[0].rows]
    assert [(row["item"], row["begun (s)"], row["reached (s)"], row["took (s)"]) for row in rows] == [
        (1, 25.0, 60.0, 35.0),
        (2, 60.0, None, 40.0),  # AUTO ended
        (3, 120.0, 160.0, 40.0),
    ]


def test_a_mission_that_changed_under_way() -> None:
    again = plan(80.0, CORNERS_M + np.array([0.0, 1.0]))
    first = plan()
    both = MadeTable(
        "CMD",
        np.concatenate([first.stamp_ns, again.stamp_ns]),
        {name: np.concatenate([first.values(name), again.values(name)]) for name in first.columns},
    )
    section = section_of(both, sailed(), ALL, REACHED, AUTO)
    (finding,) = section.findings
    assert finding.sentence == "The mission was changed 1 times while it was carried out, first 70.0 s after it began"
    assert finding.evidence == (Evidence("CMD", None, 80 * S, value="4 items"),)


def test_what_a_log_does_not_show() -> None:
    assert analyse(MadeLog(sailed())) is None
    nothing = section_of(plan(), sailed(), AUTO, said())
    assert nothing.lacks == ("The log does not show which items were executed: it has no MISE and no MISSION_CURRENT.",)
    assert facts(nothing) == {"waypoints": 3, "mission_length_m": 150.0}
    unseen = section_of(plan(), sailed(), ALL, AUTO, said())
    assert unseen.lacks == ("The log does not show when waypoints were reached, only when the next one was started.",)
