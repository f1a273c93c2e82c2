"""Meshes that close, with the volume they should have; trimesh measures."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from sim_core.world.geometry import (
    CONCRETE,
    STEEL,
    UPRIGHT,
    WOOD,
    Mesh,
    box,
    cylinder,
    ellipsoid,
    heading_matrix,
    merged,
    moved,
    revolved,
    sphere,
)

SIDES = 48
POLYGON = SIDES / 2 * math.sin(2 * math.pi / SIDES)
"""Area of a polygon of so many corners on the unit circle."""


def solid(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)


@pytest.mark.parametrize(
    ("mesh", "volume_m3", "within"),
    [
        (box((1.0, 2.0, 3.0), WOOD), 6.0, 1e-12),
        (cylinder(0.5, 4.0, WOOD, SIDES), POLYGON * 0.25 * 4.0, 1e-12),
        (revolved((-1.5, -1.5, 1.5), (0.0, 1.0, 0.0), WOOD, SIDES), POLYGON, 1e-12),
        # Corners lie on the round surface: less by 0.3 % for 48 sides, and by about as much for rings as fine.
        (sphere(2.0, WOOD, SIDES, SIDES // 2), 4 / 3 * math.pi * 8.0, 0.008),
        (ellipsoid((1.0, 2.0, 3.0), WOOD, SIDES, SIDES // 2), 8 * math.pi, 0.008),
    ],
)
def test_each_closes_and_has_its_volume(mesh: Mesh, volume_m3: float, within: float) -> None:
    measured = solid(mesh)
    assert measured.is_watertight
    assert measured.is_winding_consistent
    # Positive: counter-clockwise from outside.
    assert measured.volume == pytest.approx(volume_m3, rel=within)
    np.testing.assert_allclose(measured.center_mass[1:], 0.0, atol=1e-9)


def test_long_ones_lie_along_x() -> None:
    np.testing.assert_allclose(np.ptp(cylinder(0.2, 5.0, WOOD).vertices_m, axis=0), [5.0, 0.4, 0.4], atol=1e-12)


def test_a_heading_east_and_upright() -> None:
    mesh = box((4.0, 1.0, 1.0), STEEL)
    np.testing.assert_allclose(heading_matrix(math.pi / 2) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(
        np.ptp(moved(mesh, (0, 0, 0), heading_matrix(math.pi / 2)).vertices_m, axis=0), [1, 4, 1]
    )
    np.testing.assert_allclose(UPRIGHT @ [1.0, 0.0, 0.0], [0.0, 0.0, -1.0])
    for turn in (UPRIGHT, heading_matrix(0.4)):
        assert np.linalg.det(turn) == pytest.approx(1.0)
    tip = moved(revolved((-1.5, -1.5, 1.5), (0.0, 1.0, 0.0), WOOD), (1.0, 2.0, 5.0), UPRIGHT).vertices_m
    np.testing.assert_allclose(tip[tip[:, 2].argmin()], [1.0, 2.0, 3.5])


def test_merged_keeps_all_of_both() -> None:
    one, other = box((1.0, 1.0, 1.0), CONCRETE), moved(cylinder(0.5, 2.0, WOOD), (5.0, 0.0, 0.0))
    both = merged([one, other])
    assert solid(both).volume == pytest.approx(solid(one).volume + solid(other).volume)
    assert both.material is CONCRETE
