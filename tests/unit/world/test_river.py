"""The shape of the bed, its gradient, and triangles that lie on it; a dam by its volume."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from sim_core.world.river import FlatBed, RiverBed, bank_parts, shoal_part
from sim_core.world.spec import BuildingSpec, DamSpec, Intakes, RiverSpec, ShoalSpec
from sim_core.world.structures import building_part, dam_parts

RIVER = RiverSpec(direction_deg=126.87, through_ne_m=(10.0, 20.0), width_m=300.0, depth_m=12.0, seed=7)
STRIP = ShoalSpec(
    count=5, from_ne_m=(0.0, 0.0), to_ne_m=(20.0, 20.0), width_m=4.0, radius_m=(1.0, 2.0), height_m=(1.0, 2.0)
)
PLAIN = RiverBed.from_spec(replace(RIVER, undulation_m=0.0), 0.1)
BED = RiverBed.from_spec(RIVER, 0.1)


def test_the_channel_is_deep_in_the_middle_dry_beyond_the_banks_and_straight() -> None:
    along = np.array([-100.0, 0.0, 250.0])
    # The edges are rounded by a root of (distance^2 + 1 m^2): 0.02 m off at 12 m from the corner.
    for right, down in ((0.0, 12.1), (100.0, 12.1), (150.0, 0.1), (-150.0, 0.1), (140.0, 5.1), (200.0, -3.9)):
        found = PLAIN.bed_down_m(PLAIN.place_ne_m(along, np.full(3, right)))
        np.testing.assert_allclose(found, down, atol=0.1)


def test_the_channel_runs_in_its_direction() -> None:
    course = math.radians(126.87)
    step = PLAIN.place_ne_m(np.array(5.0), np.array(0.0)) - PLAIN.place_ne_m(np.array(0.0), np.array(0.0))
    np.testing.assert_allclose(step, 5.0 * np.array([math.cos(course), math.sin(course)]))


def test_the_gradient_is_the_difference_quotient() -> None:
    place = np.random.default_rng(0).uniform(-250.0, 250.0, (4, 200, 2))
    step = 1e-4 * np.eye(2)
    quotient = [(BED.bed_down_m(place + one) - BED.bed_down_m(place - one)) / 2e-4 for one in step]
    # Central differences err by h^2 f''' / 6, below 1e-8, and by rounding, 1e-15 / 1e-4.
    np.testing.assert_allclose(BED.gradient(place), np.stack(quotient, axis=-1), atol=1e-7)
    assert FlatBed(7.0).bed_down_m(place).shape == (4, 200)
    np.testing.assert_array_equal(FlatBed(7.0).gradient(place), 0.0)


@pytest.mark.medium
def test_the_undulation_has_its_deviation_and_is_the_seeds() -> None:
    place = np.random.default_rng(0).uniform(-5000.0, 5000.0, (40_000, 2))
    rough = BED.bed_down_m(place) - PLAIN.bed_down_m(place)
    # 40 000 draws, far apart: half a per cent.
    assert rough.std() == pytest.approx(0.3, rel=0.02)
    again = RiverBed.from_spec(RIVER, 0.1)
    np.testing.assert_array_equal(again.bed_down_m(place), BED.bed_down_m(place))
    other = RiverBed.from_spec(replace(RIVER, seed=8), 0.1)
    assert not np.array_equal(other.bed_down_m(place), BED.bed_down_m(place))


def test_the_triangles_lie_on_the_bed_face_up_and_cover_all_of_it() -> None:
    meshes = RiverBed.from_spec(replace(RIVER, along_m=(-50.0, 80.0), beside_m=20.0), 0.1).meshes()
    assert [mesh.material.name for mesh in meshes] == ["bed", "earth"]
    area = 0.0
    for mesh in meshes:
        np.testing.assert_allclose(mesh.vertices_m[:, 2], BED.bed_down_m(mesh.vertices_m[:, :2]))
        corner = mesh.vertices_m[mesh.faces]
        upward = -np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2]
        assert upward.min() > 0.0
        area += upward.sum() / 2
    assert area == pytest.approx(130.0 * 340.0)
    under = meshes[0].vertices_m[meshes[0].faces][..., 2]
    assert under.min() > BED.water_down_m


def test_trees_and_rocks_stand_on_the_land_and_shoals_reach_out_of_the_water() -> None:
    planted = replace(RIVER, trees=30, rocks=10, along_m=(-50.0, 50.0), beside_m=25.0)
    trunks, crowns, rocks = bank_parts(RiverBed.from_spec(planted, 0.1))
    assert trunks.mesh.vertices_m[:, 2].max() < BED.water_down_m + 1.0
    assert crowns.mesh.vertices_m[:, 2].min() > -25.0
    assert crowns.mesh.vertices_m[:, 2].min() < -8.0
    assert bank_parts(BED) == []
    assert trimesh.Trimesh(rocks.mesh.vertices_m, rocks.mesh.faces, process=False).is_watertight
    shoal = shoal_part(BED, 0.1, STRIP, np.random.default_rng(1))
    rock = shoal.mesh.vertices_m.reshape(5, -1, 3)
    # 1 to 2 m above the water, and roughened by 12 % of what stands 12 m high.
    assert (rock[..., 2].min(axis=1) < 0.1 + 0.8).all()
    assert (rock[..., 2].min(axis=1) > 0.1 - 4.0).all()


@pytest.mark.medium
def test_a_dam_loses_the_volume_of_its_niches() -> None:
    """420 x 16 x 32 m less 14 niches of 18 x 8 x 15 m, and 14 x 24 bars of 0.15 x 0.15 x 15 m."""
    dam = DamSpec((76.4, 189.8, -1.0), (420.0, 16.0, 32.0), 36.87, Intakes(14, 18.0, 15.0, 4.5, 24))
    parts = dam_parts(dam)
    volume = dict[str, float]()
    for part in parts:
        solid = trimesh.Trimesh(part.mesh.vertices_m, part.mesh.faces, process=False)
        volume[part.name] = volume.get(part.name, 0.0) + solid.volume
    assert volume["dam"] == pytest.approx(420 * 16 * 32 - 14 * 18 * 8 * 15)
    assert volume["bars"] == pytest.approx(14 * 24 * 0.15**2 * 15)
    whole = np.concatenate([part.mesh.vertices_m for part in parts])
    (plain,) = dam_parts(replace(dam, intakes=None))
    np.testing.assert_allclose([whole.min(axis=0), whole.max(axis=0)],
                               [plain.mesh.vertices_m.min(axis=0), plain.mesh.vertices_m.max(axis=0)])  # fmt: skip


def test_a_building_stands_on_the_ground() -> None:
    place = tuple(PLAIN.place_ne_m(np.array(0.0), np.array(180.0)).tolist())
    vertices = building_part(PLAIN, BuildingSpec(place, (12.0, 8.0, 5.0), 17.0)).mesh.vertices_m
    ground = float(PLAIN.bed_down_m(np.array(place)))
    assert vertices[:, 2].min() == pytest.approx(ground - 5.0)
    assert vertices[:, 2].max() > ground
