"""The bed of a river and the land beside it as one smooth surface, and trees and rocks along it, drawn from a seed.

bed = RiverBed.of(direction_deg=126.9, through_ne_m=(0, 0), width_m=300, depth_m=12)
bed.bed_down_m(places_ne_m)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy import int32
from numpy.random import Generator, default_rng

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
from sim_core.world.rays import Part

_WAVELENGTHS_M = (15.0, 70.0)
_SINUSOIDS = 12
_ROUNDING_M = 1.0
"""How far the bed's edges are rounded where bank meets bed and land."""


class Bed(Protocol):
    """The ground under the water and beside it."""

    def bed_down_m(self, north_east_m: Array) -> Array:
        """(...,) how deep the ground is below the local origin, at places (..., 2)."""
        ...

    def gradient(self, north_east_m: Array) -> Array:
        """(..., 2) how `bed_down_m` grows to the north and to the east."""
        ...


@dataclass(frozen=True, slots=True)
class FlatBed:
    """At one depth everywhere."""

    down_m: float

    def bed_down_m(self, north_east_m: Array) -> Array:
        """See `Bed`."""
        return np.full(north_east_m.shape[:-1], self.down_m)

    def gradient(self, north_east_m: Array) -> Array:
        """See `Bed`."""
        return np.zeros(north_east_m.shape)


@dataclass(frozen=True, slots=True, eq=False)
class RiverBed:
    """A straight channel between banks of an even slope, and everywhere an undulation that is a sum of sinusoids.

    `width_m`: between the banks at the waterline, about `through_ne_m`, along `direction_rad`. `water_down_m`: where
    the surface is. wave_vector_radpm (K, 2), phase_rad, amplitude_m (K,): the undulation.
    """

    direction_rad: float
    through_ne_m: tuple[float, float]
    width_m: float
    depth_m: float
    bank_slope: float
    bank_height_m: float
    water_down_m: float
    wave_vector_radpm: Array
    phase_rad: Array
    amplitude_m: Array

    @classmethod
    def of(
        cls,
        direction_deg: float,
        through_ne_m: tuple[float, float],
        width_m: float,
        depth_m: float,
        bank_slope: float = 0.5,
        bank_height_m: float = 4.0,
        undulation_m: float = 0.3,
        seed: int = 1,
        water_down_m: float = 0.0,
    ) -> RiverBed:
        """undulation_m: its standard deviation."""
        rng = default_rng(seed)
        wavelength = np.geomspace(*_WAVELENGTHS_M, _SINUSOIDS)
        turn = rng.uniform(0.0, 2 * math.pi, _SINUSOIDS)
        vector = (2 * math.pi / wavelength)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        amplitude = np.full(_SINUSOIDS, undulation_m * math.sqrt(2 / _SINUSOIDS))
        phase = rng.uniform(0.0, 2 * math.pi, _SINUSOIDS)
        return cls(
            math.radians(direction_deg), through_ne_m, width_m, depth_m, bank_slope, bank_height_m, water_down_m,
            vector, phase, amplitude,
        )  # fmt: skip

    def bed_down_m(self, north_east_m: Array) -> Array:
        """See `Bed`."""
        return self._shape(north_east_m)[0]

    def gradient(self, north_east_m: Array) -> Array:
        """See `Bed`."""
        return self._shape(north_east_m)[1]

    def place_ne_m(self, along_m: Array, right_m: Array) -> Array:
        """(..., 2) of places so far along the channel and to the right of its middle."""
        cosine, sine = math.cos(self.direction_rad), math.sin(self.direction_rad)
        north, east = self.through_ne_m
        return np.stack([north + cosine * along_m - sine * right_m, east + sine * along_m + cosine * right_m], axis=-1)

    def meshes(self, along_m: tuple[float, float], beside_m: float, cell_m: float) -> list[Mesh]:
        """Bed and land from along_m[0] to along_m[1] along the channel and to beside_m beyond both banks.

        Cells of cell_m near the waterlines, of twice that in the middle; the ground under water is of another material.
        """
        edge = self.width_m / 2
        shore = min(self.depth_m / self.bank_slope + 4 * cell_m, edge)
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

    def _shape(self, place: Array) -> tuple[Array, Array]:
        """Depth below the origin, and its gradient."""
        north, east = place[..., 0] - self.through_ne_m[0], place[..., 1] - self.through_ne_m[1]
        cosine, sine = math.cos(self.direction_rad), math.sin(self.direction_rad)
        right = cosine * east - sine * north
        bank = self.bank_slope * (self.width_m / 2 - np.abs(right))
        bed, bed_slope = _lesser(bank, self.depth_m)
        ground, ground_slope = _lesser(-bed, self.bank_height_m)
        slope = bed_slope * ground_slope * self.bank_slope * -np.sign(right)
        angle = place @ self.wave_vector_radpm.T + self.phase_rad
        down = self.water_down_m - ground + np.sin(angle) @ self.amplitude_m
        gradient = (np.cos(angle) * self.amplitude_m) @ self.wave_vector_radpm
        gradient += slope[..., None] * np.array([-sine, cosine])
        return down, gradient


def _lesser(value: Array, most: float) -> tuple[Array, Array]:
    """The lesser of the two, rounded where they meet, and its slope over `value`."""
    root = np.sqrt((value - most) ** 2 + _ROUNDING_M**2)
    return 0.5 * (value + most - root), 0.5 * (1 - (value - most) / root)


_SUNK_M = 0.5
"""How deep a trunk reaches into the ground."""


def tree_parts(bed: RiverBed, count: int, along_m: tuple[float, float], beside_m: float, rng: Generator) -> list[Part]:
    """Trees on both banks, from 4 m to beside_m beyond the waterline: trunks and crowns of 5 to 14 m."""
    trunks: list[Mesh] = []
    crowns: list[Mesh] = []
    for place in _along_banks(bed, count, along_m, (4.0, beside_m), rng):
        ground, height = float(bed.bed_down_m(place)), rng.uniform(5.0, 14.0)
        spread = height * rng.uniform(0.15, 0.3)
        stem = 0.45 * height
        middle = [*place, ground + (_SUNK_M - stem) / 2]
        trunks.append(moved(cylinder(0.02 * height + 0.05, stem + _SUNK_M, WOOD, sides=6), middle, UPRIGHT))
        crown = ellipsoid((0.32 * height, spread, spread), LEAVES, sides=10, rings=6)
        crowns.append(moved(_roughened(crown, 0.2, rng), [*place, ground - 0.68 * height], UPRIGHT))
    return [Part("trunks", merged(trunks)), Part("crowns", merged(crowns))] if count else []


def rock_parts(bed: RiverBed, count: int, along_m: tuple[float, float], rng: Generator) -> list[Part]:
    """Rocks at both waterlines, of radii from 0.4 to 1.8 m."""
    rocks = [
        _rock(bed, place, rng.uniform(0.4, 1.8), rng) for place in _along_banks(bed, count, along_m, (-3.0, 6.0), rng)
    ]
    return [Part("rocks", merged(rocks))] if count else []


def shoal_part(
    bed: Bed,
    water_down_m: float,
    count: int,
    from_ne_m: tuple[float, float],
    to_ne_m: tuple[float, float],
    width_m: float,
    radius_m: tuple[float, float],
    height_m: tuple[float, float],
    rng: Generator,
) -> Part:
    """Rocks that stand on the bed and reach out of the water by height_m, of radius_m at the waterline.

    Evenly spaced from from_ne_m to to_ne_m, and drawn across width_m.
    """
    start, way = np.array(from_ne_m), np.array(to_ne_m) - np.array(from_ne_m)
    length = float(np.linalg.norm(way))
    aside = np.array([-way[1], way[0]]) / (length or 1.0)
    rocks = []
    for share in ((np.arange(count) + 0.5) / count).tolist():
        place = start + share * way + rng.uniform(-0.5, 0.5) * width_m * aside
        high, radius = rng.uniform(*height_m), rng.uniform(*radius_m)
        deep = max(float(bed.bed_down_m(place)) - water_down_m, 0.0)
        # The ellipsoid's middle is on the bed; at the waterline it is narrower than there by this.
        narrower = math.sqrt(1.0 - (deep / (deep + high)) ** 2)
        shape = ellipsoid((deep + high, radius / narrower, rng.uniform(0.7, 1.0) * radius / narrower), ROCK, 14, 16)
        turn = heading_matrix(rng.uniform(0.0, 2 * math.pi)) @ UPRIGHT
        rocks.append(moved(_roughened(shape, 0.12, rng), [*place, water_down_m + deep], turn))
    return Part("shoal", merged(rocks))


def _rock(bed: Bed, place: Array, radius_m: float, rng: Generator) -> Mesh:
    shape = ellipsoid((radius_m, radius_m * rng.uniform(0.6, 1.0), radius_m * rng.uniform(0.5, 0.9)), ROCK, 10, 6)
    turn = heading_matrix(rng.uniform(0.0, 2 * math.pi))
    return moved(_roughened(shape, 0.2, rng), [*place, float(bed.bed_down_m(place))], turn)


def _along_banks(
    bed: RiverBed, count: int, along_m: tuple[float, float], beyond_m: tuple[float, float], rng: Generator
) -> Array:
    """(count, 2) places, by turns on the left and the right bank."""
    side = np.where(np.arange(count) % 2, 1.0, -1.0)
    along, beyond = rng.uniform(*along_m, count), rng.uniform(*beyond_m, count)
    return bed.place_ne_m(along, side * (bed.width_m / 2 + beyond))


def _roughened(mesh: Mesh, share: float, rng: Generator) -> Mesh:
    """Every corner moved in or out by up to `share` of its distance from the middle."""
    factor = 1.0 + rng.uniform(-share, share, (len(mesh.vertices_m), 1))
    return Mesh(mesh.vertices_m * factor, mesh.faces, mesh.material)
