"""The catenary by its own equation, the floats along it, and distances to their surface as trimesh has them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from trimesh import Trimesh
from trimesh.proximity import closest_point_naive

from sim_core.world.geometry import STEEL, UPRIGHT, cylinder, heading_matrix, merged, moved
from sim_core.world.structures import LogBoom, Pile, catenary_length_m, catenary_parameter_m, catenary_points_m


@pytest.mark.parametrize(("span_m", "sag_m"), [(50.0, 0.01), (50.0, 2.0), (350.0, 30.0), (10.0, 40.0), (1000.0, 1.0)])
def test_the_parameter_satisfies_the_equation_of_the_sag(span_m: float, sag_m: float) -> None:
    a = catenary_parameter_m(span_m, sag_m)
    assert a * (math.cosh(span_m / (2 * a)) - 1) == pytest.approx(sag_m, rel=1e-6)


def test_length_and_points_agree_with_a_fine_polyline() -> None:
    start, end = np.array([3.0, -4.0]), np.array([43.0, 26.0])
    points = catenary_points_m(start, end, 5.0, np.linspace(0.0, 1.0, 20_001))
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.sum() == pytest.approx(catenary_length_m(50.0, 5.0), rel=1e-7)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-5, err_msg="shares are of the length")
    np.testing.assert_allclose(points[[0, -1]], [start, end], atol=1e-9)
    # To the right of north-east is south-east.
    ahead, right = np.array([0.8, 0.6]), np.array([-0.6, 0.8])
    aside = (points - start) @ right
    assert aside.max() == pytest.approx(5.0)
    assert (points[aside.argmax()] - start) @ ahead == pytest.approx(25.0, abs=0.01)


def test_the_sag_of_a_flat_one_is_that_of_a_parabola() -> None:
    """L = s (1 + 8/3 (sag / s)^2), the next term being 32/5 (sag / s)^4."""
    assert catenary_length_m(100.0, 2.0) == pytest.approx(100.0 * (1 + 8 / 3 * 0.0004), abs=100 * 6.4 * 0.02**4)


def test_floats_follow_the_line_end_to_end() -> None:
    boom = LogBoom.between_anchors([(0.0, 0.0), (40.0, 30.0), (80.0, 60.0)], 3.0, 6.0, 0.5, down_m=0.2)
    assert len(boom.centre_ned_m) == 2 * round(catenary_length_m(50.0, 3.0) / 6.0)
    np.testing.assert_array_equal(boom.centre_ned_m[:, 2], 0.2)
    ends = boom.ends_ned_m
    np.testing.assert_allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), boom.length_m)
    gap = np.linalg.norm(ends[1:, 0] - ends[:-1, 1], axis=1)
    # A twentieth of the line is gaps, but a chord is not the arc: 6 m of a curve of some 105 m radius, a millimetre.
    np.testing.assert_allclose(gap, boom.length_m[0] / 0.95 * 0.05, atol=0.02)
    fine = catenary_points_m(np.zeros(2), np.array([40.0, 30.0]), 3.0, np.linspace(0.0, 1.0, 5001))
    first = boom.centre_ned_m[: len(boom.centre_ned_m) // 2, :2]
    off = np.linalg.norm(first[:, None] - fine[None], axis=2).min(axis=1)
    # Half a sagitta: l^2 / 8 R.
    assert off.max() < 6.0**2 / (8 * 100.0)


def test_points_give_the_straight_line_they_always_gave() -> None:
    boom = LogBoom.along_points([(-20.8, -5.6, 0.0), (27.2, 30.4, 0.5)], 6.0, 0.4)
    assert len(boom.centre_ned_m) == 10
    np.testing.assert_allclose(boom.centre_ned_m[0], [-20.8 + 48 / 20, -5.6 + 36 / 20, 0.025])
    np.testing.assert_allclose(boom.length_m, 0.95 * 6.0)
    np.testing.assert_allclose(boom.heading_rad, math.atan2(36.0, 48.0))


@pytest.mark.medium
def test_distances_are_those_to_a_fine_mesh() -> None:
    """24 of these points lie inside a float or pile; trimesh has the distance, not its sign."""
    piles = (Pile((0.0, 0.0), 0.8, -4.0, 6.0), Pile((40.0, 30.0), 0.8, -4.0, 6.0))
    boom = LogBoom.between_anchors([(0.0, 0.0), (40.0, 30.0)], 2.0, 6.0, 0.5, 0.1, piles)
    floats = [
        moved(cylinder(0.5, float(length), STEEL, 96), centre, heading_matrix(float(heading)))
        for centre, heading, length in zip(boom.centre_ned_m, boom.heading_rad, boom.length_m, strict=True)
    ]
    posts = [moved(cylinder(0.8, 10.0, STEEL, 96), (*pile.place_ne_m, 1.0), UPRIGHT) for pile in piles]
    mesh = merged(floats + posts)
    rng = np.random.default_rng(4)
    points = rng.uniform([-3.0, -3.0, -5.0], [43.0, 33.0, 4.0], (150, 3))
    _, wanted, _ = closest_point_naive(Trimesh(mesh.vertices_m, mesh.faces, process=False), points)
    # The mesh's sides lie up to 0.8 (1 - cos(pi / 96)) inside.
    outside = boom.distance_m(points) > 0
    np.testing.assert_allclose(boom.distance_m(points)[outside], wanted[outside], atol=0.0005)
    assert outside.sum() > 100


def test_distance_is_negative_inside_and_nought_on_the_surface() -> None:
    boom = LogBoom.between_anchors([(0.0, 0.0), (0.0, 6.0)], 0.0, 6.0, 0.5)
    points = [(0, 3, 0), (0, 3, -0.5), (0.3, 3, 0.4), (1.5, 3, 0), (0, 3 + 0.475 * 6, 0.1), (0, 0, -1.0)]
    wanted = [-0.5, 0.0, 0.0, 1.0, 0.0, math.hypot(0.5, 0.15)]
    np.testing.assert_allclose(boom.distance_m(np.array(points, dtype=float)), wanted, atol=1e-12)
    assert boom.distance_m(np.empty((0, 3))).shape == (0,)
