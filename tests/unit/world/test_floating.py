"""How deep things float: closed forms of simple solids, and trimesh's cuts of the very meshes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sim_core.world.debris import USUAL_LENGTH_M, BodyKind, make_body, volume_below_m3, waterline_m
from sim_core.world.geometry import WOOD, Mesh, box, cylinder, ellipsoid

trimesh = pytest.importorskip("trimesh")


def solid(mesh: Mesh) -> Any:
    return trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)


@pytest.mark.parametrize("level_m", [-0.6, -0.5, -0.2, 0.0, 0.31, 0.5, 0.7])
def test_a_box_is_wet_by_its_share(level_m: float) -> None:
    wet = volume_below_m3(box((3.0, 2.0, 1.0), WOOD), level_m)
    assert wet == pytest.approx(6.0 * min(max(0.5 - level_m, 0.0), 1.0), abs=1e-12)


@pytest.mark.parametrize("level_m", [-0.24, -0.1, 0.0, 0.1, 0.2])
def test_a_lying_cylinder_is_wet_by_a_segment_of_its_circle(level_m: float) -> None:
    radius, length, sides = 0.25, 5.0, 256
    depth = radius - level_m
    segment = radius**2 * math.acos(level_m / radius) - level_m * math.sqrt(radius**2 - level_m**2)
    assert 0.0 < depth < 2.0 * radius
    # A polygon of n sides lies inside the circle and lacks 2 pi^2 / (3 n^2) of its area.
    slack = length * math.pi * radius**2 * 7.0 / sides**2
    wet = volume_below_m3(cylinder(radius, length, WOOD, sides=sides), level_m)
    assert length * segment - slack <= wet <= length * segment


def test_an_ellipsoid_is_wet_by_a_cap() -> None:
    a, b, c = 1.2, 0.9, 0.3
    mesh = ellipsoid((a, b, c), WOOD, 200, 100)
    for share in (0.3, 1.0, 1.6):  # of c, deep
        cap = math.pi * a * b * c * share**2 * (1.0 - share / 3.0)
        assert volume_below_m3(mesh, c - share * c) == pytest.approx(cap, rel=2e-3)  # flat faces: about (pi / 100)^2


@pytest.mark.parametrize("kind", BodyKind)
@pytest.mark.parametrize(("scale", "water_kgpm3"), [(0.5, 998.0), (1.0, 1025.0), (1.4, 998.0)])
def test_a_body_displaces_its_weight(kind: BodyKind, scale: float, water_kgpm3: float) -> None:
    body = make_body(kind, scale * USUAL_LENGTH_M[kind], water_kgpm3)
    whole = solid(body.mesh)
    assert whole.is_watertight
    assert whole.is_winding_consistent
    displaced = volume_below_m3(body.mesh, -body.middle_below_surface_m)
    assert displaced * water_kgpm3 == pytest.approx(body.mass_kg, rel=1e-9)
    assert body.draught_m + body.height_m == pytest.approx(np.ptp(whole.vertices[:, 2]))


def test_the_volume_under_water_is_that_of_a_cut() -> None:
    """Of a convex body: the hull of what lies below the level, with the points where edges cross it."""
    mesh = make_body(BodyKind.PLANTS).mesh
    for level_m in (-0.2, -0.05, 0.0, 0.13):
        section = solid(mesh).section((0, 0, 1), (0, 0, level_m)).vertices
        below = mesh.vertices_m[mesh.vertices_m[:, 2] > level_m]
        cut = trimesh.convex.convex_hull(np.concatenate([section, below]))
        assert volume_below_m3(mesh, level_m) == pytest.approx(cut.volume, rel=1e-6)


def test_a_trunk_turns_and_is_carried_as_a_cylinder() -> None:
    """m (3 r^2 + L^2) / 12, and Hoerner's 1.1 across the flow and 0.8 of a blunt end."""
    trunk = make_body(BodyKind.TRUNK, 4.0, 1000.0)
    inertia_kgm2 = trunk.mass_kg * (3.0 * trunk.radius_m**2 + 4.0**2) / 12.0
    assert trunk.yaw_inertia_kgm2 == pytest.approx(inertia_kgm2, rel=0.005)
    wet_m2 = 2.0 * trunk.radius_m * trunk.draught_m, 4.0 * trunk.draught_m
    assert trunk.drag_kgpm == pytest.approx((500.0 * 0.8 * wet_m2[0], 500.0 * 1.1 * wet_m2[1]))


def test_what_shows_above_the_water_is_what_such_things_show() -> None:
    trunk, branch, plants, animal, plank, drum, buoy = (make_body(kind) for kind in BodyKind)
    wet = volume_below_m3(trunk.mesh, -trunk.middle_below_surface_m) / volume_below_m3(trunk.mesh, -1.0)
    assert 0.6 <= wet <= 0.9
    assert 0.1 <= trunk.height_m <= 0.2
    assert 0.4 <= branch.height_m <= 0.7
    assert plants.height_m == pytest.approx(0.3, abs=0.03)
    assert 0.2 <= animal.height_m <= 0.3
    assert plank.height_m == pytest.approx(0.06 * 0.4, rel=0.01)  # a box of density 0.6 shows 0.4 of its height
    assert drum.height_m > 2.0 * drum.draught_m
    assert buoy.height_m > buoy.draught_m


def test_every_point_of_a_body_lies_in_its_capsule() -> None:
    for kind in BodyKind:
        body = make_body(kind)
        ahead, right = body.mesh.vertices_m[:, 0], body.mesh.vertices_m[:, 1]
        beyond = np.maximum(np.abs(ahead) - body.half_axis_m, 0.0)
        slack = 0.25 if kind is BodyKind.BRANCH else 0.11  # square ends of a trunk, tips of twigs, a head
        assert np.hypot(beyond, right).max() <= body.radius_m + slack


def test_the_same_body_is_the_same_object() -> None:
    assert make_body(BodyKind.TRUNK, 4.0).mesh is make_body(BodyKind.TRUNK, 4.0).mesh


@pytest.mark.parametrize("length_m", [0.0, -1.0, 60.0, math.nan, math.inf])
def test_no_such_length(length_m: float) -> None:
    with pytest.raises(ValueError, match="give a length"):
        make_body(BodyKind.TRUNK, length_m)


def test_what_is_heavier_than_water_sinks() -> None:
    with pytest.raises(ValueError, match="displaces 2 m3 afloat has 1 m3"):
        waterline_m(box((1.0, 1.0, 1.0), WOOD), 2.0)
