"""The bed of a river and the land beside it, as one smooth surface.

bed = RiverBed.of(direction_deg=126.9, through_ne_m=(0, 0), width_m=300, depth_m=12)
bed.bed_down_m(places_ne_m)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy import float64, int32
from numpy.random import default_rng
from numpy.typing import NDArray

from sim_core.world.materials import BED, EARTH
from sim_core.world.mesh import Mesh

Array = NDArray[float64]
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
