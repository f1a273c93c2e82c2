"""One point a cell, of each source."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.companion import mapping
from agent.companion.mapping import SONAR, CloudMap


def test_a_cell_keeps_the_first_point_of_each_source() -> None:
    cloud_map = CloudMap(cell_m=1.0, far_m=50.0)
    points = np.array([[1.2, 0.5, 0.5], [1.7, 0.5, 0.5], [-0.5, 0.5, 0.5], [60.0, 0, 0]], np.float32)
    intensity = np.array([1, 2, 3, 4], np.uint8)
    assert len(cloud_map.add(np.eye(4), points, intensity).intensity) == len(cloud_map) == 0  # seen once
    added = cloud_map.add(np.eye(4), points, intensity)
    assert sorted(added.intensity.tolist()) == [1, 3]
    assert len(cloud_map.add(np.eye(4), points, intensity).points_odom_m) == 0
    assert len(cloud_map.add(np.eye(4), points, intensity, SONAR).points_odom_m) == 2
    assert len(cloud_map) == 4


def test_points_go_where_the_pose_says() -> None:
    pose = np.array([[0.0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]])
    added = CloudMap().add(pose, np.array([[1.0, 2.0, 3.0]], np.float32), np.zeros(1, np.uint8), SONAR)
    np.testing.assert_allclose(added.points_odom_m, [[8.0, 21.0, 33.0]], atol=1e-6)


def test_what_is_no_place_is_refused_and_counted() -> None:
    cloud_map = CloudMap(cell_m=0.1)
    points = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [1, 1, 1]], np.float32)
    assert len(cloud_map.add(np.eye(4), points, np.zeros(3, np.uint8), SONAR).points_odom_m) == 1
    assert cloud_map.refused == 2
    away = np.eye(4)
    away[0, 3] = 1e6
    assert len(cloud_map.add(away, points[2:], np.zeros(1, np.uint8), SONAR).points_odom_m) == 0
    assert cloud_map.refused == 3


def test_a_cell_that_two_clouds_saw_has_the_middle_of_their_points() -> None:
    cloud_map = CloudMap(cell_m=1.0)
    none = np.zeros(1, np.uint8)
    assert len(cloud_map.add(np.eye(4), np.array([[2.2, 3.4, 0.0]], np.float32), none).points_odom_m) == 0
    added = cloud_map.add(np.eye(4), np.array([[2.6, 3.0, 0.5]], np.float32), none)
    np.testing.assert_allclose(added.points_odom_m, [[2.4, 3.2, 0.25]], atol=1e-6)
    assert len(cloud_map.add(np.eye(4), np.array([[2.5, 3.5, 0.5]], np.float32), none).points_odom_m) == 0


def test_cells_that_one_cloud_saw_are_forgotten_when_they_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapping, "MOST_ONCE", 16)
    cloud_map = CloudMap(cell_m=1.0)
    none = np.zeros(1, np.uint8)

    def added(north_m: float) -> int:
        return len(cloud_map.add(np.eye(4), np.array([[north_m, 0.5, 0.5]], np.float32), none).points_odom_m)

    assert [added(number + 0.5) for number in range(40)] == [0] * 40
    assert [added(39.5), added(39.5)] == [1, 0]
    assert sum(added(number + 0.5) for number in range(39)) <= 15  # at most 16 of 40 cells were kept


def test_a_forgotten_cell_of_the_map_is_returned_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapping, "MOST_CELLS", 16)
    cloud_map = CloudMap(cell_m=1.0, far_m=100.0)
    points = np.column_stack([np.arange(40) + 0.5, np.zeros(40), np.zeros(40)]).astype(np.float32)
    assert len(cloud_map.add(np.eye(4), points, np.zeros(40, np.uint8), SONAR).points_odom_m) == 40
    assert len(cloud_map) == 16
    assert len(cloud_map.add(np.eye(4), points, np.zeros(40, np.uint8), SONAR).points_odom_m) == 24


def test_the_map_has_one_point_in_each_cell_that_enough_clouds_hit() -> None:
    """Compare with the definition, by a dictionary of all cells."""
    rng = np.random.default_rng(3)
    cloud_map = CloudMap(cell_m=0.5)
    once: dict[tuple[int, ...], NDArray[np.float32]] = {}
    expected: dict[tuple[int, ...], NDArray[np.float64]] = {}
    got = []
    for _ in range(30):
        points = rng.uniform(-3.0, 3.0, (100, 3)).astype(np.float32)
        got.append(cloud_map.add(np.eye(4), points, np.zeros(100, np.uint8)).points_odom_m)
        first = {tuple(cell): point for cell, point in zip((points // 0.5).tolist()[::-1], points[::-1], strict=True)}
        for cell, point in first.items():
            if cell in once and cell not in expected:
                expected[cell] = 0.5 * (once[cell].astype(np.float64) + point)
            once.setdefault(cell, point)
    points = np.concatenate(got)
    wanted = np.array(list(expected.values()), dtype=np.float32)
    assert len(points) == len(cloud_map) == len(wanted) > 500
    np.testing.assert_array_equal(points[np.lexsort(points.T)], wanted[np.lexsort(wanted.T)])


@pytest.mark.medium
def test_the_memory_of_a_map_does_not_grow() -> None:
    rng = np.random.default_rng(5)
    cloud_map = CloudMap()

    def traced_bytes(clouds: int) -> int:
        for _ in range(clouds):
            points = rng.uniform(-30.0, 30.0, (300, 3)).astype(np.float32)
            cloud_map.add(np.eye(4), points, np.zeros(300, np.uint8), SONAR)
            cloud_map.add(np.eye(4), points, np.zeros(300, np.uint8))
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        assert traced_bytes(5) > 0
        before = traced_bytes(5)
        after = traced_bytes(40)
    finally:
        tracemalloc.stop()
    assert len(cloud_map) > 10_000
    assert after - before < 2_000  # less than a byte for each new cell
