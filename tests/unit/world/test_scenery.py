"""Profiles' worlds as they are built, and the river site as it was meant to be."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from sim_core.world.geometry import MATERIALS
from sim_core.world.primitive_rays import PrimitiveCaster
from sim_core.world.rays import RayCaster
from sim_core.world.spec import MeshFileSpec
from sim_core.world.structures import LogBoom, upright_walls
from tests.golden import Golden
from tests.river import fan, river_profile, river_scenery
from xitl_cli import extras
from xitl_cli.errors import UserError
from xitl_cli.profile.files.entry import ProfileError
from xitl_cli.profile.load import load_profile
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.world import WorldSpec
from xitl_cli.run.session import check_extras
from xitl_cli.run.world import scene
from xitl_cli.run.world.scene import make_scene
from xitl_cli.scenery import Scenery


def run_in(**world: Any) -> RunProfile:
    """The shipped run in another world."""
    return dataclasses.replace(load_profile("sitl").runnable(), world=WorldSpec(**world))


def test_a_world_with_nothing_in_it_has_a_flat_bed_at_the_waters_depth() -> None:
    scenery = Scenery(run_in())
    assert scenery.boom is None
    assert scenery.boxes == ()
    # 20 m below a surface 0.01 m below the origin.
    assert float(scenery.bed.bed_down_m(np.array([3.0, 4.0]))) == pytest.approx(20.01)
    down = np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
    for backend in ("embree", "numpy"):
        hits = scenery.caster(backend).cast(np.array([[300.0, -200.0, 0.5]], dtype=np.float32), down)
        np.testing.assert_allclose(hits.range_m, 19.51, rtol=1e-6)


def test_the_shipped_boom_by_points_is_where_it_was() -> None:
    profile = load_profile("sitl").runnable()
    boom = Scenery(profile).boom
    assert boom is not None
    assert len(boom.centre_ned_m) == 40
    assert boom.piles == ()
    points = np.array(profile.world.log_boom.points_ned_m)
    np.testing.assert_allclose(boom.distance_m(points[1:-1]), 0.15, atol=1e-12, err_msg="in the middle of a gap")


@pytest.mark.medium
def test_the_river_has_about_100_000_triangles() -> None:
    assert 90_000 <= river_scenery().scene.triangles <= 120_000
    assert river_scenery().caster().triangles == river_scenery().scene.triangles
    assert river_scenery().warnings == ()


def test_the_mission_runs_300_m_along_the_boom_at_8_to_11_m_in_deep_water() -> None:
    profile, scenery = river_profile(), river_scenery()
    start, end = (np.array(place) for place in profile.mission.waypoints_ned_m[:2])
    assert np.linalg.norm(end - start) >= 300.0
    way = start + np.linspace(0.0, 1.0, 400)[:, None] * (end - start)
    assert scenery.boom is not None
    distance = scenery.boom.distance_m(np.column_stack([way, np.zeros(400)]))
    assert distance.min() > 7.9
    assert distance.max() < 11.0
    assert scenery.bed.bed_down_m(way).min() > 5.0
    ends = scenery.boom.centre_ned_m[[0, -1], :2]
    assert np.linalg.norm(ends[1] - ends[0]) >= 340.0
    place = np.array([profile.mission.start.north_m, profile.mission.start.east_m, 0.0])
    assert scenery.boom.distance_m(place[None])[0] > 25.0


@pytest.mark.medium
def test_everywhere_on_the_way_something_ahead_fixes_the_place_along_it() -> None:
    """Within 100 m, in the lidar's view: hits of a frame whose normal is within 60 degrees of the way."""
    profile, caster = river_profile(), river_scenery().caster()
    start, end = (np.array(place) for place in profile.mission.waypoints_ned_m[:2])
    along = np.append(end - start, 0.0) / np.linalg.norm(end - start)
    origin, direction = fan(10_000)
    for share in np.linspace(0.0, 1.0, 16):
        shift = np.append(start + share * (end - start), -1.1).astype(np.float32) - origin[0]
        hits = caster.cast(origin + shift, direction)
        above = origin[:, 2] + hits.range_m * direction[:, 2] < 0.0
        facing = above & (hits.range_m < 100.0) & (np.abs(hits.normal_ned @ along) > 0.5)
        # Ten would do against 2 cm of noise and a registration to a decimetre.
        assert facing.sum() > 40


def test_walls_of_a_catenary_lie_along_its_floats() -> None:
    world = river_profile().world
    walls = upright_walls(world.log_boom, world.dam, 0.01)
    boom = river_scenery().boom
    assert isinstance(boom, LogBoom)
    assert len(walls.top_down_m) == 4 * len(boom.centre_ned_m) + 4
    north_east = boom.centre_ned_m[:1, :2]
    # From the middle of a float across: its side is a radius away.
    across = np.array([[[-boom.axis_ne[0, 1], boom.axis_ne[0, 0]]]])
    np.testing.assert_allclose(walls.range_in_plan_m(north_east, across), 0.5, atol=1e-9)


@pytest.mark.medium
def test_the_river_is_drawn() -> None:
    """As much as a recording can bear, and the world of before as it was."""
    profiles = load_profile("sitl").runnable(), river_profile()
    small, large = (len(make_scene([profile], Scenery(profile)).encode()) for profile in profiles)
    assert small < 110_000  # most is the shape of the vessel; 26 kB when compressed
    assert 500_000 < large < 4_000_000


def test_a_mesh_by_file_stands_in_the_scene_and_is_warned_of(tmp_path: Path, golden: Golden) -> None:
    path = tmp_path / "pier.stl"
    trimesh.creation.box((4.0, 4.0, 6.0)).export(path)
    profile = run_in(meshes=(MeshFileSpec(str(path), (30.0, 0.0, 0.0), material="steel"),))
    scenery = Scenery(profile)
    hits = scenery.caster().cast(np.zeros((1, 3), dtype=np.float32), np.array([[1.0, 0, 0]], dtype=np.float32))
    assert hits.range_m[0] == pytest.approx(28.0)
    assert MATERIALS[hits.material[0]].name == "steel"
    assert scenery.warnings == ()
    large = Scenery(run_in(meshes=(MeshFileSpec(str(path), scale=1000.0),)))
    assert large.scene.triangles
    golden("warning", large.warnings, "6000 m", path=path)  # fmt: skip
    with pytest.raises(UserError) as refused:
        _ = Scenery(run_in(meshes=(MeshFileSpec(str(tmp_path / "none.stl")),))).scene
    golden("error", refused.value)


def test_a_meshs_path_is_meant_from_its_profile(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box((4.0, 4.0, 6.0)).export(tmp_path / "meshes" / "quay.stl")
    (tmp_path / "quay.yaml").write_text("world: {meshes: [{file: meshes/quay.stl}]}\n")
    world = load_profile(str(tmp_path / "quay.yaml")).world
    assert world is not None
    assert world.meshes[0].file == str(tmp_path / "meshes" / "quay.stl")


def test_without_embree_a_run_that_needs_it_is_refused_with_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
    golden: Golden,
) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    with pytest.raises(UserError) as refused:
        check_extras(load_profile("sitl-perception").runnable())
    golden("error", refused.value)
    check_extras(load_profile("sitl").runnable())


def test_numpy_casts_for_those_who_ask_for_it() -> None:
    caster: RayCaster = Scenery(run_in()).caster("numpy")
    assert isinstance(caster, PrimitiveCaster)


@pytest.mark.parametrize(
    "world",
    [
        "log_boom: {float_length_m: 6, float_radius_m: 0.4}",
        "log_boom: {float_length_m: 6, float_radius_m: 0.4, anchors_ne_m: [[0, 0], [9, 9], [9, 9]]}",
        (
            "dam: {centre_ned_m: [0, 0, 0], size_m: [100, 10, 20], "
            "intakes: {count: 10, width_m: 12, height_m: 5, down_m: 0}}"
        ),
        (
            "dam: {centre_ned_m: [0, 0, 0], size_m: [100, 10, 20], "
            "intakes: {count: 2, width_m: 12, height_m: 5, down_m: 9}}"
        ),
        "river: {width_m: 100, depth_m: 9, along_m: [5, -5]}",
    ],
)
def test_a_world_that_cannot_be_is_refused(world: str, golden: Golden, tmp_path: Path) -> None:
    path = tmp_path / "place.yaml"
    path.write_text(f"world:\n  {world}\n")
    with pytest.raises(ProfileError) as raised:
        load_profile(str(path))
    golden("problem", [problem.sentence for problem in raised.value.problems])


@pytest.mark.medium
def test_intakes_and_piles_stand_where_the_profile_says() -> None:
    """A ray at the height of the intakes goes 8 m further into an opening than between two."""
    profile, caster = river_profile(), river_scenery().caster()
    dam = profile.world.dam
    assert dam is not None
    heading = math.radians(dam.heading_deg)
    along = np.array([math.cos(heading), math.sin(heading)])
    upstream = np.array([along[1], -along[0]])
    ranges = []
    # 14 intakes 30 m apart: between two at the middle; 15 m on, in the middle of an opening, between bars 0.72 m apart.
    for off in (0.0, 15.0):
        place = np.array(dam.centre_ned_m[:2]) + off * along + 14.0 * upstream
        origin = np.array([[*place, 4.5]], dtype=np.float32)
        ranges.append(float(caster.cast(origin, np.array([[*-upstream, 0.0]], dtype=np.float32)).range_m[0]))
    np.testing.assert_allclose(ranges, [6.0, 14.0], atol=1e-3)


def test_a_mesh_too_large_to_be_drawn_is_met_by_rays_and_told_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    path = tmp_path / "pier.stl"
    trimesh.creation.box((4.0, 4.0, 6.0)).export(path)
    profile = run_in(meshes=(MeshFileSpec(str(path), (30.0, 0.0, 0.0)),))
    assert b"pier.stl" in make_scene([profile], Scenery(profile)).encode()
    monkeypatch.setattr(scene, "MOST_DRAWN", 11)
    scenery = Scenery(profile)
    assert b"pier.stl" not in make_scene([profile], scenery).encode()
    golden("warning", scenery.warnings, "12")
    hits = scenery.caster().cast(np.zeros((1, 3), dtype=np.float32), np.array([[1.0, 0, 0]], dtype=np.float32))
    assert hits.range_m[0] == pytest.approx(28.0)


@pytest.mark.parametrize(
    ("file", "said"),
    [("gone.stl", r"gone\.stl does not exist; check the path"), ("a.step", "not of a known format; use one of stl, d")],
)
def test_a_mesh_that_cannot_be_had_is_found_by_the_check(file: str, said: str, tmp_path: Path) -> None:
    profile = tmp_path / "quay.yaml"
    profile.write_text(f"extends: sitl\nworld: {{meshes: [{{file: {file}}}]}}\n")
    with pytest.raises(ProfileError, match=rf"quay\.yaml:2: world\.meshes\.0\.file.*{said}"):
        load_profile(str(profile))
