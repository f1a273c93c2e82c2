"""Missions: home first, what is refused, and how one is sailed through."""

from __future__ import annotations

import math

import pytest

from agent.fcu.guidance import GuidanceGains
from agent.fcu.local_frame import LocalFrame
from agent.fcu.mission import MOST_ITEMS, Mission, MissionError, MissionItem, change_speed, mission, waypoint
from agent.fcu.parameters import Parameters
from agent.fcu.pilot import COMPLETE, Pilot

FRAME = LocalFrame(-8.8, -63.95, 50.0)
GAINS = GuidanceGains.of(Parameters())


def at(north_m: float, east_m: float) -> MissionItem:
    return waypoint(*FRAME.to_geodetic(north_m, east_m))


@pytest.mark.parametrize(
    ("item", "words"),
    [
        (waypoint(91.0, 0.0), "mission item 1: position 91, 0 is not on Earth"),
        (waypoint(math.nan, 5.0), "not on Earth"),
        (waypoint(0.0, 0.0), "position 0, 0 is not set"),
        (waypoint(1.0, 1.0, math.inf), "altitude"),
        (change_speed(0.0), "speed 0 m/s"),
        (change_speed(math.nan), "speed nan m/s"),
        (MissionItem(21), "command 21 is not supported"),
    ],
)
def test_a_bad_item_is_named(item: MissionItem, words: str) -> None:
    with pytest.raises(MissionError, match=words):
        mission([at(0.0, 0.0), item])
    mission([item, at(1.0, 1.0)])  # as home it is never sailed to


def test_too_many_items() -> None:
    with pytest.raises(MissionError, match="at most"):
        mission([at(0.0, 0.0)] * (MOST_ITEMS + 1))


def test_home_alone_is_the_empty_mission() -> None:
    assert mission([at(0.0, 0.0)]) == mission([]) == Mission()


def test_speeds_count_from_their_place_on() -> None:
    items = [at(0, 0), change_speed(2.0), at(10, 0), at(20, 0), change_speed(1.5), change_speed(1.2), at(30, 0)]
    pilot = Pilot(mission(items), 3.0)
    speeds, reached = [], []
    for north in range(31):
        pilot.steer(GAINS, FRAME, (float(north), 0.0), 0.0, 1.0, 0.02)
        speeds.append((pilot.current, pilot.speed_mps))
        reached += pilot.take_reached()
    assert reached == [2, 3, 6]
    assert list(dict.fromkeys(speeds)) == [(2, 2.0), (3, 2.0), (6, 1.2), (0, 1.2)]
    assert pilot.state == COMPLETE


def test_legs_join_waypoints_and_the_first_starts_at_the_vessel() -> None:
    pilot = Pilot(mission([at(0, 0), at(50, 50), at(50, 150)]), 3.0)
    output = pilot.steer(GAINS, FRAME, (50.0, 0.0), 0.0, 1.0, 0.02)
    assert output is not None
    assert output.cross_track_m == 0.0
    assert output.bearing_rad == pytest.approx(math.pi / 2.0)
    pilot.steer(GAINS, FRAME, (50.0, 49.0), 0.0, 1.0, 0.02)
    output = pilot.steer(GAINS, FRAME, (45.0, 60.0), 0.0, 1.0, 0.02)
    assert output is not None
    assert output.cross_track_m == pytest.approx(5.0)  # right of a leg to the east is south


def test_waypoints_on_top_of_each_other_are_ticked_off() -> None:
    pilot = Pilot(mission([at(0, 0), at(5, 5), at(5, 5), at(5, 5)]), 3.0)
    outputs = [pilot.steer(GAINS, FRAME, (5.0, 5.0), 0.0, 0.0, 0.02) for _ in range(4)]
    assert outputs[-1] is None
    assert pilot.take_reached() == [1, 2, 3]
