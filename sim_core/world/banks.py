"""What grows and lies along a river: trees and rocks, drawn from a seed."""

from __future__ import annotations

import math

import numpy as np
from numpy import float64
from numpy.random import Generator
from numpy.typing import NDArray

from sim_core.world.materials import LEAVES, ROCK, WOOD
from sim_core.world.mesh import Mesh
from sim_core.world.river import Bed, RiverBed
from sim_core.world.scene import Part
from sim_core.world.shapes import UPRIGHT, cylinder, ellipsoid, heading_matrix, merged, moved

Array = NDArray[float64]
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
