"""What is counted of a fused cloud, by points whose place is known."""

from __future__ import annotations

import numpy as np

from xitl_cli.plugins.studies.experiments.section_4_4_lidar_sonar import (
    BRANCH,
    TRUNK,
    Footprint,
    FusedCloud,
    seen_as_in_the_paper,
    trunk_mesh,
)


def test_a_footprint_is_a_capsule() -> None:
    east_west = Footprint((10.0, 2.0), 4.0, 90.0, 0.5)
    inside = [(10.0, 0.0, 0.0), (10.4, 2.0, 5.0), (10.0, 4.4, 0.0)]
    outside = [(10.0, 4.6, 0.0), (10.6, 2.0, 0.0), (9.0, 2.0, 0.0)]
    assert east_west.holds(np.array(inside + outside)).tolist() == [True] * 3 + [False] * 3


def test_points_are_counted_by_what_they_hit() -> None:
    branch, trunk = (*BRANCH.middle_ne_m, -0.3), (*TRUNK.middle_ne_m, 0.35)
    lidar = np.array([branch, branch, (4.0, 0.0, 0.02), (5.0, 0.0, 0.0), (6.0, 1.0, 0.04)])
    cloud = FusedCloud(lidar, np.array([trunk, trunk, trunk]), 0.02, {15.0: 9.1, 20.0: 12.0}, {"OBSTACLE_DISTANCE": 4})
    assert (cloud.lidar_in(BRANCH), cloud.lidar_in(TRUNK), cloud.lidar_below()) == (2, 0, 0)
    assert (cloud.sonar_in(TRUNK), cloud.sonar_in(BRANCH), int(cloud.water().sum())) == (3, 0, 3)
    assert cloud.told_toward(BRANCH.middle_ne_m) == 9.1
    assert cloud.told_toward((0.0, -5.0)) is None
    assert seen_as_in_the_paper(cloud)


def test_a_lidar_that_saw_below_the_water_is_not_the_paper_s() -> None:
    trunk = (*TRUNK.middle_ne_m, 1.0)
    lidar = np.array([(*BRANCH.middle_ne_m, -0.3), (4.0, 0.0, 0.0), trunk])
    cloud = FusedCloud(lidar, np.array([trunk]), 0.0, {}, {"DISTANCE_SENSOR": 1})
    assert cloud.lidar_below() == 1
    assert not seen_as_in_the_paper(cloud)


def test_the_sunken_trunk_is_a_mesh_along_north() -> None:
    corners = np.array([line.split()[1:] for line in trunk_mesh().splitlines() if line.startswith("v ")], dtype=float)
    assert np.allclose(np.ptp(corners, axis=0), (0.7, 4.0, 0.7), atol=0.02)
