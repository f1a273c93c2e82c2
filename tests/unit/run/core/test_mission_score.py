from __future__ import annotations

import math

import numpy as np
import pytest

from xitl_cli.run.core.scores import EstimationScore, MissionScore, cross_track_m


def test_cross_track_is_positive_to_the_right_of_the_leg() -> None:
    assert cross_track_m((5.0, 2.0), (0.0, 0.0), (10.0, 0.0)) == pytest.approx(2.0)  # heading north, east is right
    assert cross_track_m((2.0, 5.0), (0.0, 0.0), (0.0, 10.0)) == pytest.approx(-2.0)  # heading east, north is left
    assert cross_track_m((3.0, 4.0), (0.0, 0.0), (0.0, 0.0)) == pytest.approx(5.0)  # a leg of no length


def test_mission_score_of_a_track_offset_by_a_constant() -> None:
    score = MissionScore([(100.0, 0.0), (100.0, 100.0)])
    score.add((0.0, 0.0), 0, 0)
    for north in range(1, 100):
        score.add((float(north), 1.0), 0, 0)
    for east in range(100):
        score.add((103.0, float(east)), 1, 1)
    # 1 sample of 0, 99 of 1 m, 100 of 3 m
    assert score.cross_track_rms_m == pytest.approx(math.sqrt((99 + 900) / 200))
    assert score.cross_track_max_m == pytest.approx(3.0)
    assert score.closest_m[0] == pytest.approx(math.hypot(1.0, 1.0))
    assert not score.completed
    score.reached = 2
    assert score.completed


def test_a_score_starts_again_with_another_mission_only() -> None:
    score = MissionScore([(10.0, 0.0)])
    score.add((0.0, 2.0), 0, 1)
    score.follow(((10.0, 0.0),))
    assert score.completed
    score.follow(((10.0, 0.0), (20.0, 0.0)))
    assert (score.total, score.reached, score.cross_track_rms_m) == (2, 0, None)


def test_a_mission_without_waypoints_is_never_complete() -> None:
    assert not MissionScore([]).completed


def test_estimation_error_wraps_the_heading() -> None:
    def yaw(degrees: float) -> np.ndarray:
        half = math.radians(degrees) / 2
        return np.array([math.cos(half), 0.0, 0.0, math.sin(half)])

    score = EstimationScore()
    score.add(np.zeros(3), yaw(179.0), np.array([3.0, 4.0, 9.0]), yaw(-179.0))
    assert score.position_rms_m == pytest.approx(5.0)
    assert score.heading_rms_deg == pytest.approx(2.0)
    assert score.heading_nees is None
    score.add(np.zeros(3), yaw(179.0), np.zeros(3), yaw(-179.0), None, math.radians(4.0))
    assert score.heading_nees == pytest.approx(0.25)
