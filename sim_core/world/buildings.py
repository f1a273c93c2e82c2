"""Boxes that stand level: buildings, and what a dam is put together from."""

from __future__ import annotations

import numpy as np
from numpy import float64
from numpy.typing import ArrayLike, NDArray

from sim_core.world.materials import WALL, Material
from sim_core.world.river import Bed
from sim_core.world.scene import Part
from sim_core.world.shapes import box, heading_matrix, moved
from sim_core.world.solids import Box

Array = NDArray[float64]
_FOUNDATION_M = 1.0


def block(
    name: str, centre_ned_m: ArrayLike, size_m: tuple[float, float, float], heading_rad: float, material: Material
) -> Part:
    """A box of size_m, its length along the heading."""
    centre, turn = np.asarray(centre_ned_m, dtype=float64), heading_matrix(heading_rad)
    mesh = moved(box(size_m, material), centre, turn)
    return Part(name, mesh, (Box(centre, np.array(size_m), turn, material),))


def building(
    bed: Bed, centre_ne_m: tuple[float, float], size_m: tuple[float, float, float], heading_rad: float
) -> Part:
    """A block that stands on the ground at its middle, size_m[2] high above it, its foundation a metre below."""
    length, width, height = size_m
    ground = float(bed.bed_down_m(np.array(centre_ne_m)))
    centre = np.array([*centre_ne_m, ground + (_FOUNDATION_M - height) / 2])
    return block("building", centre, (length, width, height + _FOUNDATION_M), heading_rad, WALL)
