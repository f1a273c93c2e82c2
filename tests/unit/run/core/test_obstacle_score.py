"""The lookout's score against what is adrift, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agent.wire import dialect as mav
from sim_core.world.debris import BodyKind, DebrisState, Launch, launched, no_debris
from sim_core.world.geometry import CONCRETE, Mesh, box, moved
from sim_core.world.primitive_rays import PrimitiveCaster
from sim_core.world.rays import Bodies
from xitl_cli.run.core.scores import ObstacleScore

HULL_M = (2.3, 1.6)


def debris() -> DebrisState:
    """A trunk 30 m north, across; a raft of plants 30 m east."""
    state = no_debris()
    for launch in (Launch(0, BodyKind.TRUNK, 30.0, 0.0, math.pi / 2), Launch(0, BodyKind.PLANTS, 0.0, 30.0)):
        state = launched(state, launch, np.zeros(3), 0.0)
    return state


def news(north_m: float, east_m: float, number: int = 1) -> mav.MAVLink_xitl_obstacle_message:
    return mav.MAVLink_xitl_obstacle_message(
        0, (north_m, east_m, 0.0), (0.0, 0.0, 0.0), (1.0, 1.0, 0.3), 0.0, 9.0, 0.0, number, 5, 9
    )


def test_a_body_is_detected_at_its_distance_from_the_bow() -> None:
    score = ObstacleScore(HULL_M)
    score.see(np.zeros(3), 0.0, debris())
    score.hear(news(31.0, 1.0))
    report = score.report()
    assert (report["launched"], report["detected"], report["false"]) == (2, 1, 0)
    assert report["detected_at_m"] == [pytest.approx(30.0 - 0.25 - 1.15, abs=0.01), None]
    assert report["min_clearance_m"] == pytest.approx(30.0 - 1.05 - 0.8, abs=0.01), "the raft, off the side"


def test_tracks_of_nothing_are_false_until_they_are_of_something() -> None:
    score = ObstacleScore(HULL_M)
    score.see(np.zeros(3), 0.0, debris())
    score.hear(news(15.0, 15.0, 4))
    score.hear(news(20.0, -15.0, 5))
    score.hear(news(1.0, 29.0, 4))
    assert (score.report()["tracks"], score.report()["false"]) == (2, 1)
    score.hear(news(math.nan, 0.0, 6))
    assert score.report()["false"] == 2


def test_a_rock_is_an_obstacle_at_low_water_alone() -> None:
    rock = moved(box((4.0, 4.0, 1.0), CONCRETE), (-10.0, -20.0, 1.3))
    for height_m, false in ((0.0, 1), (-1.0, 0)):
        score = ObstacleScore(HULL_M, PrimitiveCaster([], [rock]), tide_m=lambda height_m=height_m: height_m)
        score.see(np.zeros(3), 0.0, no_debris())
        score.hear(news(-10.0, -20.0))
        assert score.report()["false"] == false


def test_what_stands_in_the_river_is_no_false_obstacle() -> None:
    pile = moved(box((1.0, 1.0, 6.0), CONCRETE), (10.0, -20.0, 0.0))
    under = moved(box((4.0, 4.0, 1.0), CONCRETE), (-10.0, -20.0, 3.0))
    score = ObstacleScore(HULL_M, PrimitiveCaster([], [pile, under]))
    score.see(np.zeros(3), 0.0, no_debris())
    score.hear(news(11.5, -20.5, 1))
    assert score.report()["false"] == 0
    score.hear(news(-10.0, -20.0, 2))
    assert score.report()["false"] == 1, "what is 2.5 m under water is not seen"


def test_the_least_clearance_is_kept() -> None:
    score = ObstacleScore(HULL_M)
    state = debris()
    for north_m in (0.0, 24.0, 10.0):
        score.see(np.array((north_m, 0.0, 0.0)), 0.0, state)
    assert score.report()["min_clearance_m"] == pytest.approx(6.0 - 1.15 - 0.25, abs=0.01)
    score.see(np.array((30.0, 0.0, 0.0)), 0.0, state)
    assert score.report()["min_clearance_m"] == 0.0


def test_a_run_without_bodies_has_no_clearance() -> None:
    assert ObstacleScore(HULL_M).report() == {
        "launched": 0,
        "detected": 0,
        "detected_at_m": [],
        "tracks": 0,
        "false": 0,
        "min_clearance_m": None,
        "range_rms_m": None,
        "classes": {},
    }


def test_classes_and_ranges_are_compared_with_the_bodies() -> None:
    state = launched(debris(), Launch(0, BodyKind.BUOY, -20.0, 0.0, swing_m=0.5), np.zeros(3), 0.0)
    score = ObstacleScore(HULL_M)
    score.see(np.zeros(3), 0.0, state)
    score.hear(labelled(news(30.0, 0.0, 1), "debris"))
    score.hear(labelled(news(-20.0, 0.0, 2), "vessel"))
    score.hear(labelled(news(0.0, 30.0, 3), ""))
    classes = score.report()["classes"]
    assert classes["debris"] == {"tracked": 2, "right": 1, "wrong": 0}  # the raft has no class
    assert classes["buoy"] == {"tracked": 1, "right": 0, "wrong": 1}
    score.hear(labelled(news(-20.0, 0.0, 2), "buoy"))
    score.hear(news(-20.0, 0.0, 2))  # without a class, the latest one stays
    assert score.report()["classes"]["buoy"] == {"tracked": 1, "right": 1, "wrong": 0}


def test_the_range_error_is_that_from_the_bow() -> None:
    score = ObstacleScore(HULL_M)
    score.see(np.zeros(3), 0.0, debris())
    score.hear(news(30.0, 0.0))  # reports 9 m
    assert score.report()["range_rms_m"] == pytest.approx(30.0 - 0.25 - 1.15 - 9.0, abs=0.01)


def labelled(message: mav.MAVLink_xitl_obstacle_message, label: str) -> mav.MAVLink_xitl_obstacle_message:
    message.label = label
    return message


def test_another_vessel_is_no_false_obstacle() -> None:
    hull = Mesh(
        np.array([[2.0, 0.0, 0.0], [-2.0, 0.5, 0.0], [-2.0, -0.5, 0.0]]), np.array([[0, 1, 2]], np.int32), CONCRETE
    )
    other = Bodies((hull,), np.array([[30.0, 0.0, 0.0]]), np.zeros((1, 3)), np.eye(3)[None])
    score = ObstacleScore(HULL_M, others=lambda: other)
    score.hear(news(32.0, 1.0))
    assert score.report()["false"] == 0
    score.hear(news(50.0, 1.0, number=2))
    assert (score.report()["tracks"], score.report()["false"]) == (2, 1)
