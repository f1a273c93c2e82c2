"""The scene that a run records, read back as what a view draws, and its water against the simulation's."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import default_rng

from sim_core.frames import euler_to_quat, frd_to_flu
from sim_core.vessel.sections import hull_shape
from sim_core.world.debris import BodyKind, make_body
from xitl_cli.plugins.view import shapes
from xitl_cli.plugins.view.scene import make_view_scene, read_bodies, read_scene_updates, waves_of
from xitl_cli.plugins.view.shapes import SCREEN_WATER, WaterGrid
from xitl_cli.profile import load_profile
from xitl_cli.run.world.colours import PAINTS
from xitl_cli.run.world.scene import make_debris_scene, make_scene
from xitl_cli.run.world.world import build_plant
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds


def volume_m3(vertices: np.ndarray, faces: np.ndarray) -> float:
    """By the divergence theorem: positive when faces are counter-clockwise from outside."""
    a, b, c = (vertices[faces[:, corner]].astype(np.float64) for corner in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def test_closed_shapes_have_their_volume_and_face_outwards() -> None:
    sides = 200
    polygon = 0.5 * sides * np.sin(2 * np.pi / sides)  # area of a regular polygon in the unit circle
    cone = shapes.frustum((2.0, 2.0, 3.0), 1.0, 0.0, sides)
    cylinder = shapes.frustum((2.0, 2.0, 3.0), sides=sides)
    assert volume_m3(*cylinder) == pytest.approx(3.0 * polygon, rel=1e-5)
    assert volume_m3(*cone) == pytest.approx(polygon, rel=1e-5)
    assert volume_m3(*shapes.cuboid((1.0, 2.0, 3.0))) == pytest.approx(6.0)
    assert volume_m3(*shapes.ellipsoid((2.0, 4.0, 6.0), 200, 200)) == pytest.approx(8.0 * np.pi, rel=1e-3)
    assert volume_m3(*shapes.boat(2.0)) > 0.0
    assert volume_m3(*shapes.arrow(1.0, 0.2)) > 0.0


def test_a_shape_is_turned_then_moved() -> None:
    turned = shapes.cuboid((2.0, 1.0, 1.0)).placed((10.0, 0.0, 0.0), euler_to_quat(np.array([0.0, 0.0, np.pi / 2])))
    assert np.ptp(turned.vertices_m, axis=0) == pytest.approx([1.0, 2.0, 1.0], abs=1e-6)
    assert turned.vertices_m.mean(axis=0) == pytest.approx([10.0, 0.0, 0.0], abs=1e-6)


def test_the_water_of_a_scene_has_the_tide_of_its_profile() -> None:
    tide = "environment.water.tide={constituents: [{name: quick, amplitude_m: 2, phase_deg: 0, speed_degph: 180}]}"
    profile = load_profile("sitl", [tide]).runnable()
    update = make_scene([profile], Scenery(profile))
    water = make_view_scene("sitl", read_scene_updates(update.encode()), [profile]).water
    level_m = profile.environment.water.level_m
    assert [water.level_at_m(time_s) for time_s in (0.0, 3600.0)] == pytest.approx([level_m + 2.0, level_m - 2.0])


def test_the_scene_of_a_run_is_read_back() -> None:
    profile = load_profile("sitl").runnable()
    scene = make_view_scene("sitl", read_scene_updates(make_scene([profile], Scenery(profile)).encode()), [profile])
    vessel = scene.vessels[""]
    corners = np.concatenate([frd_to_flu(hull_shape(hull).vertices_m) for hull in profile.vehicle.demi_hulls])
    white = tuple(round(255 * value) for value in PAINTS["hull"])
    drawn = np.concatenate([mesh.vertices_m for mesh in vessel.meshes if mesh.colour == white])
    assert drawn.min(axis=0)[:2] == pytest.approx(corners.min(axis=0)[:2], abs=0.02)
    assert vessel.length_m == pytest.approx(profile.vehicle.length_m, rel=0.1)
    places = [[thruster.place_flu_m[0], -thruster.place_flu_m[1]] for thruster in vessel.thrusters]
    assert places == [pytest.approx(one.position_frd_m[:2]) for one in profile.vehicle.propellers]
    assert [thruster.motor for thruster in vessel.thrusters] == [0, 1]
    assert all(thruster.axis_flu == pytest.approx((1.0, 0.0, 0.0), abs=1e-6) for thruster in vessel.thrusters)
    legs = [(profile.mission.start.north_m, profile.mission.start.east_m), *profile.mission.waypoints_ned_m]
    assert vessel.mission_enu_m[:, 1::-1] == pytest.approx(np.array(legs))
    assert vessel.acceptance_radius_m == pytest.approx(profile.mission.acceptance_radius_m)
    assert scene.water.level_m == profile.environment.water.level_m
    assert {mesh.name.rstrip(" 0123456789") for mesh in scene.meshes} == {"log boom", "dam"}


def test_every_vessel_of_a_fleet_is_in_the_scene() -> None:
    profiles = load_profile("fleet-crossing").run_profiles()
    scene = make_view_scene("fleet", read_scene_updates(make_scene(profiles, Scenery(profiles[0])).encode()), profiles)
    assert set(scene.vessels) == {profile.vessel for profile in profiles}
    assert all(vessel.meshes and vessel.thrusters for vessel in scene.vessels.values())


def test_bodies_are_told_by_their_number() -> None:
    bodies = [make_body(BodyKind.TRUNK, 4.0), make_body(BodyKind.BRANCH, 2.0)]
    found = read_bodies(read_scene_updates(make_debris_scene(bodies, 1).encode()))
    assert list(found) == [1]
    assert np.ptp(found[1][0].vertices_m[:, 0]) == pytest.approx(2.0, rel=0.2)


def test_what_is_no_scene_says_so() -> None:
    with pytest.raises(ValueError, match="SceneUpdate"):
        read_scene_updates(b"\xff\xff\xff")


@pytest.mark.medium
def test_the_water_is_that_of_the_run() -> None:
    """Drawn at a place and an instant where the simulation itself has it, near the vessel."""
    profile = load_profile("sitl").runnable()
    plant = build_plant([profile], Seeds(profile.clock.seed), Scenery(profile))
    waves = waves_of(profile)
    assert waves is not None
    places_ne = default_rng(5).uniform(-80.0, 80.0, (200, 2))
    theirs = plant.simulation.environment.waves.elevation_m(37.25, places_ne)
    assert waves.elevation_m(37.25, places_ne[:, ::-1]) == pytest.approx(theirs, abs=1e-9)
    grid = WaterGrid(waves)
    middle = grid.middle(np.array([40.1, -21.3]))
    vertices = grid.move(37.25, middle)
    near = np.max(np.abs(vertices[:, :2]), axis=1) < 15.0
    there = vertices[near, :2].astype(np.float64) + middle
    height_m = np.sqrt(np.mean(vertices[near, 2] ** 2))
    off_m = vertices[near, 2] - plant.simulation.environment.waves.elevation_m(37.25, there[:, ::-1])
    # What is shorter than some cells fades; all that carries energy is there.
    assert np.sqrt(np.mean(off_m**2)) < 0.25 * height_m
    assert np.ptp(vertices[:, 0]) > 3000.0
    assert np.min(np.diff(np.unique(vertices[:, 0]))) == pytest.approx(SCREEN_WATER.near_cell_m)


def test_still_water_is_a_square() -> None:
    grid = WaterGrid(None)
    assert len(grid.faces) == 2
    assert np.ptp(grid.move(3.0, (0.0, 0.0))[:, 2]) == 0.0
