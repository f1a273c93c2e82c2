"""The visible shape of vessels: from their keys, in one place for views and cameras, or a mesh of the user."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from sim_core.frames import flu_to_frd
from sim_core.vessel.floating import floating_pose
from sim_core.vessel.sections import cut_strips
from xitl_cli.errors import UserError
from xitl_cli.plugins.cameras.models import vessel_model
from xitl_cli.plugins.view.scene import make_view_scene, read_scene_updates
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.catalogue import shipped_profiles
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.world.colours import GRASS, MATERIAL_COLOURS, PAINTS, Rgb, ground_colours
from xitl_cli.run.world.scene import make_scene
from xitl_cli.run.world.vessel_shape import hull_parts, propeller_mesh, vessel_parts
from xitl_cli.scenery import Scenery

VEHICLES = sorted(name for name in shipped_profiles() if name.startswith("vehicles/"))


def profile_of(folder: Path, vehicle: str, more: str = "") -> RunProfile:
    path = folder / "own.yaml"
    path.write_text(f"extends: [sitl, {vehicle}]\n{more}")
    return load_profile(str(path)).runnable()


def volume_m3(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return float(np.vecdot(a, np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_a_shipped_vessel_has_hulls_of_its_own_size(tmp_path: Path, vehicle: str) -> None:
    profile = profile_of(tmp_path, vehicle)
    boat = profile.vehicle
    parts = vessel_parts(boat, profile.environment.water)
    assert {part.paint for part in parts} <= set(PAINTS)
    waterline_m = -floating_pose(boat, profile.environment.water).depth_m
    several = len(boat.demi_hulls) > 1
    hulls = [part for hull in boat.demi_hulls for part in hull_parts(hull, waterline_m, several)]
    low = np.min([part.mesh.vertices_m.min(axis=0) for part in hulls], axis=0)
    high = np.max([part.mesh.vertices_m.max(axis=0) for part in hulls], axis=0)
    assert high[0] - low[0] == pytest.approx(boat.length_m, rel=1e-6)
    assert high[1] - low[1] == pytest.approx(boat.width_m, rel=0.02)
    assert high[2] == pytest.approx(boat.keel_m, abs=0.02 * boat.demi_hulls[0].height_m)
    # Closed and outward: the shape holds what the physics displaces, but for the finer ends of a drawn hull
    drawn_m3 = sum(volume_m3(part.mesh.vertices_m, part.mesh.faces) for part in hulls)
    given_m3 = sum(float((strips.area_m2 * strips.length_m).sum()) for strips in map(cut_strips, boat.demi_hulls))
    assert 0.8 * given_m3 < drawn_m3 < 1.05 * given_m3
    assert min(part.mesh.vertices_m[:, 2].min() for part in parts) < low[2]  # something rises above the deck


def test_rudders_are_drawn_at_their_places(tmp_path: Path) -> None:
    profile = profile_of(tmp_path, "vehicles/cybership2")
    rudders = [part.mesh for part in vessel_parts(profile.vehicle, profile.environment.water) if part.paint == "rudder"]
    assert len(rudders) == len(profile.vehicle.rudders)
    for mesh, rudder in zip(rudders, profile.vehicle.rudders, strict=True):
        size = np.ptp(mesh.vertices_m, axis=0)
        assert size[0] * size[2] == pytest.approx(rudder.area_m2, rel=1e-6)
        assert size[2] / size[0] == pytest.approx(rudder.aspect_ratio, rel=1e-6)
        assert mesh.vertices_m[:, 1].mean() == pytest.approx(rudder.position_frd_m[1], abs=1e-3)
        assert mesh.vertices_m[:, 2].mean() == pytest.approx(rudder.position_frd_m[2], abs=1e-9)


def test_a_propeller_has_its_diameter() -> None:
    vertices = propeller_mesh(0.5).vertices_m
    assert 2.0 * np.hypot(vertices[:, 1], vertices[:, 2]).max() == pytest.approx(0.5, rel=0.01)


@pytest.mark.medium
def test_the_view_and_the_cameras_draw_the_same_vessel(tmp_path: Path) -> None:
    profile = profile_of(tmp_path, "vehicles/otter")
    parts = vessel_parts(profile.vehicle, profile.environment.water)
    vessel = make_view_scene("", read_scene_updates(make_scene([profile], Scenery(profile)).encode())).vessels[""]
    in_view = np.concatenate([flu_to_frd(mesh.vertices_m.astype(float)) for mesh in vessel.meshes])
    in_camera = vessel_model(profile.vehicle, profile.environment.water, "boat").vertices
    for part in parts:
        used = part.mesh.vertices_m[np.unique(part.mesh.faces)]
        for drawn in (in_view, in_camera["position"].astype(float)):
            assert {tuple(row) for row in np.round(used, 3).tolist()} <= {
                tuple(row) for row in np.round(drawn, 3).tolist()
            }
    colours = {mesh.colour for mesh in vessel.meshes}
    assert colours == {tuple(round(255 * value) for value in PAINTS[part.paint]) for part in parts}


@pytest.mark.parametrize("kind", ["stl", "obj", "glb"])
def test_a_mesh_of_the_user_replaces_the_shape(tmp_path: Path, kind: str) -> None:
    trimesh.creation.box((2.0, 1.0, 0.5)).export(tmp_path / f"boat.{kind}")
    profile = profile_of(
        tmp_path, "vehicles/asv-full", f"vehicle: {{visual: {{file: boat.{kind}, origin_frd_m: [0.2, 0, -0.1]}}}}\n"
    )
    (part,) = vessel_parts(profile.vehicle, profile.environment.water)
    assert part.mesh.vertices_m.min(axis=0) == pytest.approx([-0.8, -0.5, -0.35])
    assert part.mesh.vertices_m.max(axis=0) == pytest.approx([1.2, 0.5, 0.15])
    vessel = make_view_scene("", read_scene_updates(make_scene([profile], Scenery(profile)).encode())).vessels[""]
    assert len(vessel.meshes) == 1
    assert len(vessel.thrusters) == 2
    camera = vessel_model(profile.vehicle, profile.environment.water, "boat").vertices["position"]
    assert camera[:36].min(axis=0) == pytest.approx([-0.8, -0.5, -0.35], abs=1e-6)


def test_a_mesh_in_millimetres_is_refused(tmp_path: Path) -> None:
    trimesh.creation.box((2300.0, 1600.0, 500.0)).export(tmp_path / "boat.stl")
    with pytest.raises(
        UserError, match=r"vehicle\.visual\.scale.* 2.3e\+03 m long.*the vessel is 2\.3 m long; use 0\.001"
    ):
        profile_of(tmp_path, "vehicles/asv-full", "vehicle: {visual: {file: boat.stl}}\n")
    profile_of(tmp_path, "vehicles/asv-full", "vehicle: {visual: {file: boat.stl, scale: 0.001}}\n")


def test_a_mesh_with_holes_is_refused(tmp_path: Path) -> None:
    mesh = trimesh.creation.box((2.0, 1.0, 0.5))
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(tmp_path / "boat.stl")
    with pytest.raises(UserError, match=r"vehicle\.visual\.file.*not closed: 3 of its"):
        profile_of(tmp_path, "vehicles/asv-full", "vehicle: {visual: {file: boat.stl}}\n")


@pytest.mark.medium
def test_the_ground_is_bare_at_the_shore_and_green_above() -> None:
    profile = load_profile("sitl-camera").runnable()
    scenery = Scenery(profile)
    ground = [part.mesh for part in scenery.scene.parts if part.name == "ground"]
    shown = [pair for mesh in ground for pair in ground_colours(mesh, scenery.water_down_m)]
    assert sum(len(mesh.faces) for mesh, _ in shown) == sum(len(mesh.faces) for mesh in ground)
    heights_m: dict[Rgb, list[np.ndarray]] = {}
    for mesh, colour in shown:
        heights_m.setdefault(colour, []).append(scenery.water_down_m - mesh.vertices_m[mesh.faces, 2].mean(axis=1))
    green, bare = (np.concatenate(heights_m[colour]) for colour in (GRASS, MATERIAL_COLOURS["earth"]))
    assert green.min() > bare.max() > 0.0
