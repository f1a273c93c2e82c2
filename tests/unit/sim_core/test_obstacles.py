"""Rays against walls, in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_core.world.plan import Wall, Walls, box_walls, line_walls

ORIGIN = np.zeros((1, 3))


def rays(*directions: tuple[float, float, float]) -> np.ndarray:
    given = np.array([directions])
    return given / np.linalg.norm(given, axis=2, keepdims=True)


def test_a_wall_is_met_where_its_line_is_and_nowhere_else() -> None:
    """A wall on north = 10 from east -5 to 5: at 45 degrees to it the range is 10 sqrt(2) if the wall were longer."""
    walls = Walls.joined([Wall((10.0, -5.0), (10.0, 5.0), -2.0, 2.0)])
    found = walls.range_m(ORIGIN, rays((1, 0, 0), (10, 4, 0), (1, 1, 0), (-1, 0, 0), (0, 1, 0)))
    np.testing.assert_allclose(found, [[10.0, math.hypot(10, 4), np.inf, np.inf, np.inf]])


def test_a_ray_goes_over_and_under_a_wall() -> None:
    walls = Walls.joined([Wall((10.0, -5.0), (10.0, 5.0), -2.0, 1.0)])
    found = walls.range_m(ORIGIN, rays((10, 0, -1.9), (10, 0, -2.1), (10, 0, 0.9), (10, 0, 1.1), (0, 0, 1)))
    np.testing.assert_allclose(found, [[math.hypot(10, 1.9), np.inf, math.hypot(10, 0.9), np.inf, np.inf]])
    in_plan = walls.range_in_plan_m(ORIGIN[:, :2], rays((1, 0, 0))[:, :, :2])
    assert in_plan[0, 0] == pytest.approx(10.0)


def test_the_nearest_of_several_counts_and_open_water_has_none() -> None:
    near, far = Wall((5.0, -1.0), (5.0, 1.0), -1.0, 1.0), Wall((9.0, -1.0), (9.0, 1.0), -1.0, 1.0)
    assert Walls.joined([far, near]).range_m(ORIGIN, rays((1, 0, 0)))[0, 0] == pytest.approx(5.0)
    assert np.isinf(Walls.joined([]).range_m(ORIGIN, rays((1, 0, 0)))[0, 0])


@pytest.mark.parametrize("heading_deg", [0.0, 36.87, 90.0, 200.0])
def test_a_box_from_its_middle_ends_at_its_sides(heading_deg: float) -> None:
    heading = math.radians(heading_deg)
    walls = Walls.joined(box_walls((0.0, 0.0), 40.0, 6.0, heading, -1.0, 1.0))
    ahead = (math.cos(heading), math.sin(heading), 0.0)
    right = (-math.sin(heading), math.cos(heading), 0.0)
    np.testing.assert_allclose(walls.range_m(ORIGIN, rays(ahead, right)), [[20.0, 3.0]])


def test_a_boom_is_as_wide_and_as_high_as_its_floats() -> None:
    """Across a line of floats of radius 0.4 whose axis lies 8 m to the right, a ray ends 0.4 m before it."""
    walls = Walls.joined(line_walls([(-50.0, 8.0, 0.0), (50.0, 8.0, 0.0)], 0.4))
    found = walls.range_m(ORIGIN, rays((0, 1, 0), (0, 8, 0.3), (0, 8, 0.5)))
    assert found[0, 0] == pytest.approx(7.6)
    assert found[0, 1] == pytest.approx(7.6 * math.hypot(8, 0.3) / 8)
    assert np.isinf(found[0, 2])


def test_every_vessel_has_its_own_ray() -> None:
    walls = Walls.joined([Wall((10.0, -5.0), (10.0, 5.0), -2.0, 2.0)])
    origins = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    found = walls.range_m(origins, np.repeat(rays((1, 0, 0)), 2, axis=0))
    np.testing.assert_allclose(found[:, 0], [10.0, 6.0])
