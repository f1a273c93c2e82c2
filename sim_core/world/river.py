"""The bed of a river and the adjacent land as one smooth surface, and random trees and rocks along it.

bed = RiverBed.from_spec(RiverSpec(direction_deg=126.9, width_m=300, depth_m=12))
bed.bed_down_m(places_ne_m)
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy import int32
from numpy.random import Generator, default_rng

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.world.geometry import (
    BED,
    EARTH,
    LEAVES,
    ROCK,
    UPRIGHT,
    WOOD,
    Mesh,
    cylinder,
    ellipsoid,
    heading_matrix,
    merged,
    moved,
)
from sim_core.world.rays import ScenePart
from sim_core.world.spec import NEAREST_TREE_M, RiverSpec, ShoalSpec

_WAVELENGTHS_M = (15.0, 70.0)
_SINUSOIDS = 12
_ROUNDING_M = 1.0
"""Rounding of the bed's edges between bank, bed and land."""


class Bed(Protocol):
    """The ground under the water and next to it."""

    def bed_down_m(self, north_east_m: Array) -> Array:
        """Return the (...,) depth of the ground below the local origin, at places (..., 2)."""
        ...

    def gradient(self, north_east_m: Array) -> Array:
        """Return the (..., 2) derivative of `bed_down_m` to the north and to the east."""
        ...


@dataclass(frozen=True, slots=True)
class FlatBed:
    """A bed at one depth everywhere."""

    down_m: float

    def bed_down_m(self, north_east_m: Array) -> Array:
        """See `Bed`."""
        return np.full(north_east_m.shape[:-1], self.down_m)

    def gradient(self, north_east_m: Array) -> Array:
        """See `Bed`."""
        return np.zeros(north_east_m.shape)


@dataclass(frozen=True, slots=True, eq=False)
class RiverBed:
    """A straight channel between banks of constant slope, with an undulation that is a sum of K sinusoids."""

    spec: RiverSpec
    water_down_m: float
    """Down coordinate of the water surface."""
    wave_vector_radpm: Array
    """Wave vectors of the undulation, (K, 2)."""
    phase_rad: Array
    """Phases of the undulation, (K,)."""
    amplitude_m: Array
    """Amplitudes of the undulation, (K,)."""

    @classmethod
    def from_spec(cls, spec: RiverSpec, water_down_m: float = 0.0) -> RiverBed:
        """Return the bed. The specification's seed draws the undulation."""
        rng = default_rng(spec.seed)
        wavelength = np.geomspace(*_WAVELENGTHS_M, _SINUSOIDS)
        turn = rng.uniform(0.0, 2 * math.pi, _SINUSOIDS)
        vector = (2 * math.pi / wavelength)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        amplitude = np.full(_SINUSOIDS, spec.undulation_m * math.sqrt(2 / _SINUSOIDS))
        return cls(spec, water_down_m, vector, rng.uniform(0.0, 2 * math.pi, _SINUSOIDS), amplitude)

    @property
    def direction_rad(self) -> float:
        """Direction of the channel, clockwise from north."""
        return math.radians(self.spec.direction_deg)

    def bed_down_m(self, north_east_m: Array) -> Array:
        """See `Bed`."""
        undulation: Array = np.sin(self._angle(north_east_m)) @ self.amplitude_m
        return self.water_down_m - self._ground(north_east_m)[0] + undulation

    def gradient(self, north_east_m: Array) -> Array:
        """See `Bed`."""
        gradient: Array = (np.cos(self._angle(north_east_m)) * self.amplitude_m) @ self.wave_vector_radpm
        across = np.array([-math.sin(self.direction_rad), math.cos(self.direction_rad)])
        gradient += self._ground(north_east_m)[1][..., None] * across
        return gradient

    def place_ne_m(self, along_m: Array, right_m: Array) -> Array:
        """Return the (..., 2) places at distances along the channel and to the right of its middle."""
        cosine, sine = math.cos(self.direction_rad), math.sin(self.direction_rad)
        north, east = self.spec.through_ne_m
        return np.stack([north + cosine * along_m - sine * right_m, east + sine * along_m + cosine * right_m], axis=-1)

    def meshes(self, cell_m: float | None = None) -> list[Mesh]:
        """Return bed and land within the specified range. The ground under water has a different material.

        Cells have cell_m (None: the specification's) near the waterlines, and twice that in the middle.
        """
        cell_m, along_m, beside_m = cell_m or self.spec.cell_m, self.spec.along_m, self.spec.beside_m
        edge = self.spec.width_m / 2
        shore = min(self.spec.depth_m / self.spec.bank_slope + 4 * cell_m, edge)
        inner, outer = edge - shore, edge + beside_m
        bank = np.linspace(inner, outer, max(round((outer - inner) / cell_m), 1) + 1)
        middle = np.linspace(-inner, inner, max(round(inner / cell_m), 1) + 1)
        across = np.unique(np.concatenate([-bank, middle, bank]))
        rows = np.linspace(*along_m, max(round((along_m[1] - along_m[0]) / cell_m), 1) + 1)
        place = self.place_ne_m(*np.meshgrid(rows, across, indexing="ij")).reshape(-1, 2)
        down = self.bed_down_m(place)
        vertices = np.column_stack([place, down])
        corner = np.arange(len(rows) * len(across)).reshape(len(rows), len(across))
        here, right = corner[:-1, :-1].ravel(), corner[:-1, 1:].ravel()
        ahead, beyond = corner[1:, :-1].ravel(), corner[1:, 1:].ravel()
        # Counter-clockwise from above: right x ahead is up.
        faces = np.concatenate([np.stack([here, right, ahead], -1), np.stack([right, beyond, ahead], -1)])
        under = np.all(down[faces] > self.water_down_m, axis=1)
        return [
            Mesh(vertices, faces[chosen].astype(int32), material)
            for chosen, material in ((under, BED), (~under, EARTH))
            if chosen.any()
        ]

    def _ground(self, place: Array) -> tuple[Array, Array]:
        """Return the height above the water without the undulation, and its slope to the right."""
        north, east = place[..., 0] - self.spec.through_ne_m[0], place[..., 1] - self.spec.through_ne_m[1]
        right = math.cos(self.direction_rad) * east - math.sin(self.direction_rad) * north
        bank = self.spec.bank_slope * (self.spec.width_m / 2 - np.abs(right))
        bed, bed_slope = _lesser(bank, self.spec.depth_m)
        ground, ground_slope = _lesser(-bed, self.spec.bank_height_m)
        return ground, bed_slope * ground_slope * self.spec.bank_slope * -np.sign(right)

    def _angle(self, place: Array) -> Array:
        """Return the (..., K) phases of the undulation."""
        angle: Array = place @ self.wave_vector_radpm.T + self.phase_rad
        return angle


def _lesser(value: Array, most: float) -> tuple[Array, Array]:
    """Return a smooth minimum of the two, and its slope over `value`."""
    root = np.sqrt((value - most) ** 2 + _ROUNDING_M**2)
    return 0.5 * (value + most - root), 0.5 * (1 - (value - most) / root)


_SUNK_M = 0.5
"""Depth of a trunk below the ground."""


def bank_parts(bed: RiverBed) -> list[ScenePart]:
    """Return trees and rocks on both banks, drawn from the specification's seed."""
    rng = default_rng(bed.spec.seed)
    # Trees of 5 to 14 m: trunks and crowns
    trunks: list[Mesh] = []
    crowns: list[Mesh] = []
    for place in _along_banks(bed, bed.spec.trees, (NEAREST_TREE_M, bed.spec.beside_m), rng):
        ground, height = float(bed.bed_down_m(place)), rng.uniform(5.0, 14.0)
        spread = height * rng.uniform(0.15, 0.3)
        stem = 0.45 * height
        middle = [*place, ground + (_SUNK_M - stem) / 2]
        trunks.append(moved(cylinder(0.02 * height + 0.05, stem + _SUNK_M, WOOD, sides=6), middle, UPRIGHT))
        crown = ellipsoid((0.32 * height, spread, spread), LEAVES, sides=10, rings=6)
        crowns.append(moved(_roughened(crown, 0.2, rng), [*place, ground - 0.68 * height], UPRIGHT))
    # Rocks at both waterlines, of radii from 0.4 to 1.8 m
    rocks: list[Mesh] = []
    for place in _along_banks(bed, bed.spec.rocks, (-3.0, 6.0), rng):
        radius_m = rng.uniform(0.4, 1.8)
        shape = ellipsoid((radius_m, radius_m * rng.uniform(0.6, 1.0), radius_m * rng.uniform(0.5, 0.9)), ROCK, 10, 6)
        turn = heading_matrix(rng.uniform(0.0, 2 * math.pi))
        rocks.append(moved(_roughened(shape, 0.2, rng), [*place, float(bed.bed_down_m(place))], turn))
    named = (("trunks", trunks), ("crowns", crowns), ("rocks", rocks))
    return [ScenePart(name, merged(meshes)) for name, meshes in named if meshes]


def shoal_part(bed: Bed, water_down_m: float, spec: ShoalSpec, rng: Generator) -> ScenePart:
    """Return rocks on the bed that reach out of the water, evenly spaced along the strip and random across it."""
    start, way = np.array(spec.from_ne_m), np.array(spec.to_ne_m) - np.array(spec.from_ne_m)
    length = float(np.linalg.norm(way))
    aside = np.array([-way[1], way[0]]) / (length or 1.0)
    rocks = []
    for share in ((np.arange(spec.count) + 0.5) / spec.count).tolist():
        place = start + share * way + rng.uniform(-0.5, 0.5) * spec.width_m * aside
        high, radius = rng.uniform(*spec.height_m), rng.uniform(*spec.radius_m)
        deep = max(float(bed.bed_down_m(place)) - water_down_m, 0.0)
        # The ellipsoid's middle is on the bed. Its width at the waterline is smaller by this factor.
        narrower = math.sqrt(1.0 - (deep / (deep + high)) ** 2)
        shape = ellipsoid((deep + high, radius / narrower, rng.uniform(0.7, 1.0) * radius / narrower), ROCK, 14, 16)
        turn = heading_matrix(rng.uniform(0.0, 2 * math.pi)) @ UPRIGHT
        rocks.append(moved(_roughened(shape, 0.12, rng), [*place, water_down_m + deep], turn))
    return ScenePart("shoal", merged(rocks))


def _along_banks(bed: RiverBed, count: int, beyond_m: tuple[float, float], rng: Generator) -> Array:
    """Return (count, 2) places, in turn on the left and the right bank."""
    side = np.where(np.arange(count) % 2, 1.0, -1.0)
    along, beyond = rng.uniform(*bed.spec.along_m, count), rng.uniform(*beyond_m, count)
    return bed.place_ne_m(along, side * (bed.spec.width_m / 2 + beyond))


def _roughened(mesh: Mesh, share: float, rng: Generator) -> Mesh:
    """Move every corner in or out by up to `share` of its distance from the middle."""
    factor = 1.0 + rng.uniform(-share, share, (len(mesh.vertices_m), 1))
    return Mesh(mesh.vertices_m * factor, mesh.faces, mesh.material)
