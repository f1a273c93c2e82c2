"""Lenses against OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.random import default_rng

from sim_core.sensors.camera_spec import LensSpec
from sim_core.sensors.lens import Lens

PINHOLE = (-0.31, 0.12, 0.0011, -0.0007, -0.02)
FISHEYE = (0.021, -0.013, 0.004, -0.0006)


def points_m(count: int, widest_deg: float) -> np.ndarray:
    """Points within an angle of the optical axis."""
    rng = default_rng(5)
    angle, turn = np.radians(rng.uniform(0.0, widest_deg, count)), rng.uniform(0.0, 2.0 * np.pi, count)
    direction = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1)
    return direction * rng.uniform(0.5, 80.0, (count, 1))


@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05), PINHOLE])
def test_a_pinhole_projects_as_opencv_does(distortion: tuple[float, ...]) -> None:
    lens = Lens.from_spec(LensSpec(view_deg=80, distortion=distortion), 640, 480)
    points = points_m(500, 38.0)
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), lens.matrix, np.array(lens.distortion))
    np.testing.assert_allclose(lens.project(points), theirs[:, 0], atol=1e-6)


def test_a_fisheye_projects_as_opencv_does() -> None:
    lens = Lens.from_spec(LensSpec(model="fisheye", view_deg=170, distortion=FISHEYE), 800, 600)
    points = points_m(500, 80.0)
    zero = np.zeros((1, 3))
    theirs, _ = cv2.fisheye.projectPoints(points[None], zero, zero, lens.matrix, np.array(lens.distortion))
    np.testing.assert_allclose(lens.project(points), theirs[0], atol=1e-6)


@pytest.mark.medium
@pytest.mark.parametrize(
    "spec",
    [
        LensSpec(view_deg=70, distortion=PINHOLE),
        LensSpec(view_deg=120, distortion=(-0.05, 0.002)),
        LensSpec(model="fisheye", view_deg=200, distortion=FISHEYE),
    ],
)
def test_a_direction_is_the_inverse_of_a_projection(spec: LensSpec) -> None:
    lens = Lens.from_spec(spec, 320, 240)
    directions = lens.all_directions()
    seen = np.isfinite(directions).all(axis=-1)
    assert seen.mean() > 0.7
    np.testing.assert_allclose(np.linalg.norm(directions[seen], axis=-1), 1.0, atol=1e-12)
    grid = np.stack(np.meshgrid(np.arange(320), np.arange(240)), axis=-1)
    np.testing.assert_allclose(lens.project(directions[seen]), grid[seen], atol=1e-6)


def test_the_field_of_view_is_that_of_the_key() -> None:
    lens = Lens.from_spec(LensSpec(view_deg=90), 640, 480)
    edge = lens.directions(np.array([-0.5, 239.5]))
    assert np.degrees(np.arctan2(-edge[0], edge[2])) == pytest.approx(45.0)


def test_a_point_behind_a_pinhole_is_not_seen() -> None:
    lens = Lens.from_spec(LensSpec(), 640, 480)
    assert np.isnan(lens.project(np.array([0.3, 0.2, -4.0]))).all()
