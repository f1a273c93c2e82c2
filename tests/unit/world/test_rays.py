"""Rays against closed forms, by both backends, and one backend against the other."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest

from sim_core.frames import Array32
from sim_core.world.embree_rays import EmbreeCaster
from sim_core.world.geometry import (
    BED,
    CONCRETE,
    HIDE,
    MATERIALS,
    PLASTIC,
    STEEL,
    WOOD,
    Box,
    Cylinder,
    Mesh,
    Plane,
    Sphere,
    WorldError,
    box,
    cylinder,
    heading_matrix,
    moved,
    sphere,
)
from sim_core.world.primitive_rays import PrimitiveCaster
from sim_core.world.ray_backends import make_caster
from sim_core.world.rays import Backend, Bodies, RayCaster, Scene, ScenePart, rays_near
from tests.golden import Golden
from tests.river import fan, river_scenery

# Single precision carries 24 bits: 6e-8 of the 10 m these rays go, and some operations.
SINGLE_M = 1e-5
SIDES = 240
"""Flat sides of a mesh lie inside the round one by up to 1 - cos(pi / SIDES), 1e-4 of the radius."""
FLATNESS = 1 - math.cos(math.pi / SIDES)

PLANE = ScenePart(
    "bed",
    moved(box((400.0, 400.0, 1.0), BED), (0.0, 0.0, 12.5)),
    (Plane(np.array([0.0, 0.0, 1.0]), 12.0, BED),),
)
EAST = heading_matrix(math.pi / 2)
CYLINDER = ScenePart(
    "float",
    moved(cylinder(0.5, 6.0, PLASTIC, SIDES), (10.0, 0.0, 0.0), EAST),
    (Cylinder(np.array([10.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), 0.5, 6.0, PLASTIC),),
)
SPHERE = ScenePart(
    "buoy",
    moved(sphere(2.0, STEEL, SIDES, SIDES // 2), (0.0, 10.0, 0.0)),
    (Sphere(np.array([0.0, 10.0, 0.0]), 2.0, STEEL),),
)
TURNED = heading_matrix(math.radians(30.0))
BOX = ScenePart(
    "dam",
    moved(box((4.0, 2.0, 6.0), CONCRETE), (-10.0, 0.0, 0.0), TURNED),
    (Box(np.array([-10.0, 0.0, 0.0]), np.array([4.0, 2.0, 6.0]), TURNED, CONCRETE),),
)
SCENE = Scene((PLANE, CYLINDER, SPHERE, BOX))


@pytest.fixture(params=["embree", "numpy", "triangles in numpy"], scope="module")
def caster(request: pytest.FixtureRequest) -> RayCaster:
    if request.param == "triangles in numpy":
        return make_caster(Scene(tuple(ScenePart(part.name, part.mesh) for part in SCENE.parts)), "numpy")
    return make_caster(SCENE, request.param)


def rays(origin: object, direction: object) -> tuple[Array32, Array32]:
    """(R, 3) both, with unit directions."""
    towards = np.atleast_2d(np.asarray(direction, dtype=np.float64))
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    return np.broadcast_to(np.asarray(origin), towards.shape).astype(np.float32), towards.astype(np.float32)


@pytest.mark.medium
def test_a_plane_is_at_its_depth_over_the_cosine(caster: RayCaster) -> None:
    angle = np.radians(np.arange(0.0, 80.0, 7.0))
    down = np.stack([0.3 * np.sin(angle), -0.954 * np.sin(angle), np.cos(angle)], axis=-1)
    hits = caster.cast(*rays((30.0, 30.0, 2.0), down))
    cosine = down[:, 2] / np.linalg.norm(down, axis=1)
    np.testing.assert_allclose(hits.range_m, 10.0 / cosine, rtol=1e-5)
    np.testing.assert_allclose(hits.normal_ned, np.tile([0.0, 0.0, -1.0], (len(angle), 1)), atol=1e-6)
    assert set(hits.material.tolist()) == {MATERIALS.index(BED)}
    assert set(hits.body.tolist()) == {-1}


def test_a_cylinder_square_to_its_axis(caster: RayCaster) -> None:
    """At a height h off the axis the surface is sqrt(r^2 - h^2) before it."""
    height = np.linspace(-0.4, 0.4, 33)
    origin = np.column_stack([np.zeros(33), np.linspace(-2.9, 2.9, 33), height])
    hits = caster.cast(*rays(origin, np.tile([1.0, 0.0, 0.0], (33, 1))))
    depth = np.sqrt(0.25 - height**2)
    # At 0.4 of 0.5 m a flat side that is e too low is met e / 0.6 later.
    np.testing.assert_allclose(hits.range_m, 10.0 - depth, atol=0.5 * FLATNESS / 0.6 + SINGLE_M)
    round_normal = np.column_stack([-depth, np.zeros(33), height]) / 0.5
    np.testing.assert_allclose(hits.normal_ned, round_normal, atol=1.01 * math.pi / SIDES)


def test_a_cylinder_along_its_axis_and_past_its_end(caster: RayCaster) -> None:
    origin = np.array([[10.2, -8.0, 0.1], [10.6, -8.0, 0.0], [0.0, 3.1, 0.0]])
    hits = caster.cast(*rays(origin, [[0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(hits.range_m, [5.0, np.inf, np.inf], atol=SINGLE_M)
    np.testing.assert_allclose(hits.normal_ned[0], [0.0, -1.0, 0.0], atol=1e-6)
    np.testing.assert_array_equal(hits.normal_ned[1:], 0.0)
    assert hits.material.tolist() == [MATERIALS.index(PLASTIC), -1, -1]


def test_a_sphere_by_the_law_of_cosines(caster: RayCaster) -> None:
    """At an angle a off the middle, D away: D cos a - sqrt(r^2 - D^2 sin^2 a)."""
    angle, turn = np.radians(np.linspace(0.0, 9.0, 20)), np.linspace(0.0, 6.0, 20)
    direction = np.column_stack([np.sin(angle) * np.cos(turn), np.cos(angle), np.sin(angle) * np.sin(turn)])
    hits = caster.cast(*rays((0.0, 0.0, 0.0), direction))
    wanted = 10.0 * np.cos(angle) - np.sqrt(4.0 - 100.0 * np.sin(angle) ** 2)
    # At 9 degrees the ray meets the surface at a cosine of 0.62; facets lie within those of a ring each way.
    np.testing.assert_allclose(hits.range_m, wanted, atol=2 * 2.0 * FLATNESS / 0.62 + SINGLE_M)
    outward = (wanted[:, None] * direction - [0.0, 10.0, 0.0]) / 2.0
    np.testing.assert_allclose(hits.normal_ned, outward, atol=2.0 * math.pi / SIDES)


def test_a_box_by_its_corners(caster: RayCaster) -> None:
    """Rays aimed at points on a turned face, seen from outside and from inside."""
    for origin, sign in ((np.array([-1.0, 0.5, -1.0]), -1.0), (np.array([-10.0, 0.0, 0.0]), 1.0)):
        on_face = TURNED @ np.array([2.0, 0.3, 0.7]) + [-10.0, 0.0, 0.0]
        hits = caster.cast(*rays(origin, on_face - origin))
        np.testing.assert_allclose(hits.range_m, np.linalg.norm(on_face - origin), atol=SINGLE_M)
        np.testing.assert_allclose(hits.normal_ned[0], -sign * TURNED[:, 0], atol=1e-6)


@pytest.mark.medium
def test_a_body_is_met_where_its_velocity_has_brought_it(caster: RayCaster) -> None:
    """A ball that crosses at 2 m/s is 0.2 m further on for a ray that goes out 0.1 s later."""
    ball, still = sphere(0.5, HIDE, SIDES, SIDES // 2), heading_matrix(1.0)
    bodies = Bodies((ball, ball), np.array([[5.0, -0.2, 0.0], [-5.0, 0, 0]]), np.array([[0, 2.0, 0], [0, 0, 0]]),
                    np.stack([still, still]))  # fmt: skip
    delay_s = np.array([0.0, 0.1, 0.3, 0.9], dtype=np.float32)
    origin, direction = rays((0.0, 0.0, 0.0), np.tile([1.0, 0.0, 0.0], (4, 1)))
    hits = caster.cast(origin, direction, bodies, delay_s)
    aside = -0.2 + 2.0 * delay_s[:3]
    np.testing.assert_allclose(hits.range_m[:3], 5.0 - np.sqrt(0.25 - aside**2), atol=FLATNESS / 0.5 + SINGLE_M)
    assert hits.range_m[3] == pytest.approx(9.5, abs=1e-4), "past it, the log boom"
    assert hits.body.tolist() == [0, 0, 0, -1]
    assert hits.material.tolist() == [MATERIALS.index(HIDE)] * 3 + [MATERIALS.index(PLASTIC)]
    # The normal is back in NED, though the body is turned.
    np.testing.assert_allclose(hits.normal_ned[1], [-1.0, 0.0, 0.0], atol=2 * math.pi / SIDES)


def test_a_body_behind_what_stands_is_not_seen(caster: RayCaster) -> None:
    ball = sphere(0.4, HIDE)
    bodies = Bodies((ball,), np.array([[13.0, 0.0, 0.0]]), np.zeros((1, 3)), np.eye(3)[None])
    hits = caster.cast(*rays((0.0, 0.0, 0.0), [1.0, 0.0, 0.0]), bodies)
    assert hits.body.tolist() == [-1]
    assert hits.range_m[0] == pytest.approx(9.5, abs=1e-4)


def test_what_is_no_direction_meets_nothing(caster: RayCaster) -> None:
    """From inside the sphere, where every direction meets something; the last one is a direction."""
    none = [[0.0, 0.0, 0.0], [math.nan, 0.0, 1.0], [0.0, 0.0, math.inf], [0.0, 1.0, 0.0]]
    hits = caster.cast(np.full((4, 3), [0.0, 10.0, 0.0], np.float32), np.array(none, np.float32))
    assert np.isinf(hits.range_m[:3]).all()
    assert (hits.material[:3] == -1).all()
    assert hits.range_m[3] == pytest.approx(2.0, abs=2.0 * FLATNESS + SINGLE_M)


def test_rays_in_the_plane_miss_it_and_those_that_graze_it_meet_it(caster: RayCaster) -> None:
    slope = 12.0 / 150.0
    along = np.array([math.cos(slope), 0.0, math.sin(slope)])
    hits = caster.cast(*rays([[0.0, 50.0, 0.0]] * 2, [[1.0, 0.0, 0.0], along]))
    assert np.isinf(hits.range_m[0])
    assert hits.range_m[1] == pytest.approx(12.0 / math.sin(slope), abs=1e-4)


@pytest.mark.parametrize("backend", ["embree", "numpy"])
def test_nothing_is_met_in_an_empty_scene_and_by_no_rays(backend: Backend) -> None:
    empty = make_caster(Scene(), backend)
    hits = empty.cast(*rays((0.0, 0.0, 0.0), [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert np.isinf(hits.range_m).all()
    assert hits.material.tolist() == [-1, -1]
    none = np.empty((0, 3), dtype=np.float32)
    ball = Bodies((sphere(1.0, HIDE),), np.zeros((1, 3)), np.zeros((1, 3)), np.eye(3)[None])
    assert len(make_caster(SCENE, backend).cast(none, none, ball).range_m) == 0


@pytest.mark.parametrize("seed", range(5))
def test_no_ray_that_meets_a_body_is_left_out(seed: int) -> None:
    """Against the exact test of every ray against every body's sphere, with origins that lie apart."""
    rng = np.random.default_rng(seed)
    origin = rng.normal(0.0, 0.5, (3000, 3)).astype(np.float32)
    direction = rays((0.0, 0.0, 0.0), rng.normal(0.0, 1.0, (3000, 3)))[1]
    place, velocity = rng.normal(0.0, 30.0, (25, 3)), rng.normal(0.0, 3.0, (25, 3))
    place[0] = 0.0
    radius, delay_s = rng.uniform(0.1, 3.0, 25), rng.uniform(0.0, 0.1, 3000).astype(np.float32)
    bodies = Bodies((sphere(1.0, WOOD),) * 25, place, velocity, np.tile(np.eye(3), (25, 1, 1)))
    chosen = {body: set(numbers.tolist()) for body, numbers in rays_near(origin, direction, bodies, radius, delay_s)}
    for body in range(25):
        relative = place[body] + delay_s[:, None] * velocity[body] - origin
        along = np.einsum("ij,ij->i", relative, direction.astype(np.float64))
        square = np.einsum("ij,ij->i", relative, relative)
        meets = (square <= radius[body] ** 2) | ((along > 0) & (square - along**2 <= radius[body] ** 2))
        assert set(np.flatnonzero(meets).tolist()) <= chosen.get(body, set())
    assert sum(map(len, chosen.values())) < 0.2 * 25 * 3000


@pytest.mark.medium
def test_a_reach_hides_what_is_farther_and_is_left_as_it_was() -> None:
    caster, (origin, direction) = river_scenery().caster(), fan(3000)
    reach_m = np.full(3000, 60.0, dtype=np.float32)
    whole, near = caster.cast(origin, direction), caster.cast(origin, direction, reach_m=reach_m)
    within = whole.range_m < 60.0
    np.testing.assert_array_equal(near.range_m[within], whole.range_m[within])
    np.testing.assert_array_equal(near.material, np.where(within, whole.material, -1))
    assert np.isinf(near.range_m[~within]).all()
    np.testing.assert_array_equal(reach_m, 60.0)


@pytest.mark.medium
def test_embree_sees_the_whole_site_as_the_test_of_each_triangle_does() -> None:
    meshes = [part.mesh for part in river_scenery().scene.parts]
    origin, direction = fan(300)
    embree, numpy = EmbreeCaster(meshes).cast(origin, direction), PrimitiveCaster((), meshes).cast(origin, direction)
    # In single precision a ray that passes an edge may go to one side or the other.
    same = np.isclose(embree.range_m, numpy.range_m, rtol=0.0, atol=0.01)
    assert same.mean() >= 0.99
    assert (embree.material == numpy.material)[same].mean() >= 0.99
    assert np.isfinite(embree.range_m).sum() > 100


def test_without_embree_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    with pytest.raises(WorldError) as refused:
        make_caster(SCENE)
    golden("error", refused.value)


def triangle(corners: list[list[float]], material: int) -> Mesh:
    return Mesh(np.array(corners), np.array([[0, 1, 2]], dtype=np.int32), MATERIALS[material])


def test_a_small_triangle_has_its_material_and_a_unit_normal_toward_the_ray() -> None:
    """Legs of 0.2 m and 0.5 m: twice its area is 0.1 m², a ray from either side hits it at its plane."""
    flat = triangle([[1.0, 1.0, 3.0], [1.2, 1.0, 3.0], [1.0, 1.5, 3.0]], 2)
    tilted = triangle([[5.0, 5.0, 3.0], [5.3, 5.0, 3.0], [5.0, 5.3, 3.3]], 4)
    point = triangle([[8.0, 8.0, 3.0]] * 3, 1)
    caster = EmbreeCaster([flat, point, tilted])
    assert caster.triangles == 3
    origin, direction = rays(
        [[1.05, 1.1, 0.0], [1.05, 1.1, 5.0], [5.05, 5.1, 0.0], [8.0, 8.0, 0.0], [0.0, 0.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]],
    )
    hits = caster.cast(origin, direction)
    np.testing.assert_allclose(hits.range_m, [3.0, 2.0, 3.1, np.inf, np.inf], atol=SINGLE_M)
    root = math.sqrt(0.5)
    expected = [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, root, -root], [0.0] * 3, [0.0] * 3]
    np.testing.assert_allclose(hits.normal_ned, expected, atol=1e-6)
    assert hits.material.tolist() == [2, 2, 4, -1, -1]
    assert hits.body.tolist() == [-1] * 5


def test_a_body_that_turned_is_met_in_its_place_and_hides_what_is_behind() -> None:
    """A triangle in the body's own axes at 0.4 m ahead of it, which turned to the east and moves north at 1 m/s."""
    behind = triangle([[-2.0, 20.0, -2.0], [6.0, 20.0, -2.0], [0.0, 20.0, 4.0]], 3)
    part = triangle([[0.4, -0.2, -0.2], [0.4, 0.2, -0.2], [0.4, 0.0, 0.3]], 1)
    bodies = Bodies((part,), np.array([[2.0, 9.6, 0.0]]), np.array([[1.0, 0.0, 0.0]]), EAST[None])
    origin, direction = rays([[1.5, 0.0, 0.0], [2.5, 0.0, 0.0], [2.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]] * 3)
    hits = EmbreeCaster([behind]).cast(origin, direction, bodies, np.array([-0.5, 0.5, 0.5], dtype=np.float32))
    np.testing.assert_allclose(hits.range_m, [10.0, 10.0, 20.0], atol=SINGLE_M)
    np.testing.assert_allclose(hits.normal_ned, [[0.0, -1.0, 0.0]] * 3, atol=1e-6)
    assert hits.material.tolist() == [1, 1, 3]
    assert hits.body.tolist() == [0, 0, -1]
    empty = EmbreeCaster([]).cast(origin, direction, bodies, np.array([-0.5, 0.5, 0.5], dtype=np.float32))
    assert empty.body.tolist() == [0, 0, -1]
