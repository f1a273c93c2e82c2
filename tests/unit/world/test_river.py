"""The shape of the bed, its gradient, and triangles that lie on it; a dam by its volume."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from sim_core.world.river import FlatBed, RiverBed, bank_parts, shoal_part
from sim_core.world.spec import NEAREST_TREE_M, BuildingSpec, DamSpec, Intakes, RiverSpec, ShoalSpec
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


def test_the_edges_are_rounded_by_a_root() -> None:
    """(a + b - sqrt((a - b)² + 1 m²)) / 2 of the bank and the depth, then of that and the land."""

    def lesser(one: np.ndarray, most: float) -> np.ndarray:
        return (one + most - np.sqrt((one - most) ** 2 + 1.0)) / 2.0

    right = np.linspace(-220.0, 220.0, 89)
    depth = lesser(0.5 * (150.0 - np.abs(right)), 12.0)
    found = PLAIN.bed_down_m(PLAIN.place_ne_m(33.0 + 0.0 * right, right))
    np.testing.assert_allclose(found, 0.1 - lesser(-depth, 4.0), atol=1e-9)


def right_of(bed: RiverBed, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances along the channel and to the right."""
    off = (place[..., :2] - bed.spec.through_ne_m) @ (1.0, 1j) * np.exp(-1j * bed.direction_rad)
    return off.real, off.imag


@pytest.mark.parametrize(
    ("width_m", "cell_m", "shore_m", "cells"),
    [(300.0, None, 34.0, 46), (300.0, 4.0, 40.0, 28), (40.0, None, 20.0, 0)],
)
def test_triangles_are_small_at_the_shores_and_twice_as_large_between(
    width_m: float, cell_m: float | None, shore_m: float, cells: int
) -> None:
    """A shore reaches to where the bank meets the bed, 24 m, and four cells farther, but not beyond the middle."""
    bed = RiverBed.from_spec(replace(RIVER, width_m=width_m, along_m=(-50.0, 80.0), beside_m=20.0))
    along, right = right_of(bed, np.concatenate([mesh.vertices_m for mesh in bed.meshes(cell_m)]))
    near, edge = cell_m or 2.5, width_m / 2.0
    rows, columns = np.unique(np.round(along, 6)), np.unique(np.round(right, 6))
    np.testing.assert_allclose(rows, np.linspace(-50.0, 80.0, round(130.0 / near) + 1), atol=1e-5)
    bank = np.linspace(edge - shore_m, edge + 20.0, round((shore_m + 20.0) / near) + 1)
    middle = np.linspace(shore_m - edge, edge - shore_m, cells + 1) if cells else np.zeros(1)
    np.testing.assert_allclose(columns, np.unique(np.round([*-bank, *middle, *bank], 6)), atol=1e-5)


def test_trees_have_their_proportions_and_stand_half_a_metre_deep_on_both_banks() -> None:
    planted = RiverBed.from_spec(replace(RIVER, trees=60, rocks=80, along_m=(-50.0, 70.0), beside_m=25.0), 0.1)
    trunks, crowns, rocks = (part.mesh.vertices_m for part in bank_parts(planted))
    trunks, crowns, rocks = (
        vertices.reshape(count, -1, 3) for vertices, count in ((trunks, 60), (crowns, 60), (rocks, 80))
    )
    place = trunks[..., :2].mean(axis=1)
    along, right = right_of(planted, place)
    assert (right[::2] < -150.0).all()
    assert (right[1::2] > 150.0).all()
    beyond_m = np.abs(right) - 150.0
    for value, low, high in ((along, -50.0, 70.0), (beyond_m, NEAREST_TREE_M, 25.0)):
        assert low < value.min() < low + 0.15 * (high - low) < high - 0.15 * (high - low) < value.max() < high
    # Trunk: down to 0.5 m below the ground, up to 0.45 of the tree's height, with a radius of 2 % of it and 5 cm
    ground = planted.bed_down_m(place)
    np.testing.assert_allclose(trunks[..., 2].max(axis=1), ground + 0.5, atol=1e-9)
    height = (ground - trunks[..., 2].min(axis=1)) / 0.45
    assert 5.0 <= height.min() < 6.0 < 13.0 < height.max() <= 14.0
    radius = np.linalg.norm(trunks[..., :2] - place[:, None], axis=-1).max(axis=1)
    np.testing.assert_allclose(radius, 0.02 * height + 0.05, rtol=1e-6)
    # Crown: an ellipsoid about 0.68 of the height, roughened by a fifth
    off = (crowns - np.column_stack([place, ground - 0.68 * height])[:, None]) / height[:, None, None]
    half, spread = np.abs(off[..., 2]).max(axis=1), np.linalg.norm(off[..., :2], axis=-1).max(axis=1)
    assert 0.32 * 0.8 <= half.min() < half.max() <= 0.32 * 1.2
    assert 0.15 * 0.8 <= spread.min() < 0.2 < 0.29 < spread.max() <= 0.3 * 1.2
    # Rocks: 0.4 to 1.8 m at the waterlines
    middle = rocks.mean(axis=1)
    _, right = right_of(planted, middle)
    beyond_m = np.abs(right) - 150.0
    assert -3.4 < beyond_m.min() < -2.0 < 5.0 < beyond_m.max() < 6.4
    np.testing.assert_allclose(middle[:, 2], planted.bed_down_m(middle[:, :2]), atol=0.5)
    size = np.linalg.norm(rocks - middle[:, None], axis=-1).max(axis=1)
    assert 0.4 * 0.85 < size.min() < 0.6 < 1.5 < size.max() < 1.8 * 1.25


class Middle:
    """Draws the middle of each range."""

    def uniform(self, low: float, high: float, size: tuple[int, ...] | None = None) -> np.ndarray | float:
        middle = (low + high) / 2.0
        return middle if size is None else np.full(size, middle)


@pytest.mark.parametrize(("bed_m", "deep_m", "wider"), [(4.1, 4.0, 1 / 0.6), (-1.0, 0.0, 1.0)])
def test_rocks_of_a_shoal_have_their_size_at_the_water(bed_m: float, deep_m: float, wider: float) -> None:
    """1 m above the water and 4 m below it: at the waterline, sqrt(1 - 0.8²) of the middle's width."""
    strip = replace(STRIP, height_m=(0.5, 1.5))
    rocks = shoal_part(FlatBed(bed_m), 0.1, strip, Middle()).mesh.vertices_m.reshape(5, -1, 3)  # type: ignore[arg-type]
    for number, rock in enumerate(rocks):
        middle = (4.0 * number + 2.0, 4.0 * number + 2.0, 0.1 + deep_m)
        np.testing.assert_allclose((rock.min(axis=0) + rock.max(axis=0)) / 2.0, middle, atol=0.05)
        half = np.sort((rock.max(axis=0) - rock.min(axis=0)) / 2.0)
        np.testing.assert_allclose(half, np.sort([1.0 + deep_m, 1.5 * wider, 0.85 * 1.5 * wider]), rtol=0.03)


def test_rocks_of_a_shoal_are_spread_over_the_width_of_its_strip() -> None:
    strip = replace(STRIP, count=200, from_ne_m=(3.0, 4.0), to_ne_m=(63.0, 84.0), width_m=10.0)
    rocks = shoal_part(FlatBed(2.0), 0.1, strip, np.random.default_rng(2)).mesh.vertices_m.reshape(200, -1, 3)
    off = (rocks.mean(axis=1)[:, :2] - (3.0, 4.0)) @ np.array([(0.6, -0.8), (0.8, 0.6)])
    np.testing.assert_allclose(off[:, 0], 0.25 + 0.5 * np.arange(200), atol=0.3)
    assert -5.3 < off[:, 1].min() < -4.5 < 4.5 < off[:, 1].max() < 5.3


def test_the_undulation_has_wavelengths_of_15_to_70_metres_in_all_directions() -> None:
    ratio = (70.0 / 15.0) ** (1.0 / 11.0)
    np.testing.assert_allclose(
        2.0 * math.pi / np.linalg.norm(BED.wave_vector_radpm, axis=1), 15.0 * ratio ** np.arange(12)
    )
    turn = np.arctan2(BED.wave_vector_radpm[:, 1], BED.wave_vector_radpm[:, 0]) % (2.0 * math.pi)
    for angles in (turn, BED.phase_rad):
        assert set((angles // (0.5 * math.pi)).tolist()) == {0.0, 1.0, 2.0, 3.0}
