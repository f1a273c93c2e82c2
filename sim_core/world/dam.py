"""A dam: a box, or a wall with intakes before it, each a niche with bars across its mouth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.world.buildings import block
from sim_core.world.materials import CONCRETE, STEEL
from sim_core.world.scene import Part
from sim_core.world.shapes import heading_matrix

Array = NDArray[float64]
_BAR_M = 0.15


@dataclass(frozen=True, slots=True)
class Intakes:
    """`count` openings of width and height, their middles at `down_m`, each behind `bars` upright bars."""

    count: int
    width_m: float
    height_m: float
    down_m: float
    bars: int = 0


def dam_parts(
    centre_ned_m: Array, size_m: tuple[float, float, float], heading_rad: float, intakes: Intakes | None = None
) -> list[Part]:
    """`size_m`: length along the heading, width, height. The intakes are niches half as deep, on the left."""
    length, width, height = size_m
    centre = np.asarray(centre_ned_m, dtype=float64)
    if intakes is None:
        return [block("dam", centre, size_m, heading_rad, CONCRETE)]
    blocks = [((0.0, width / 4, 0.0), (length, width / 2, height))]
    top, bottom = -height / 2, height / 2
    middle_down = intakes.down_m - centre[2]
    low, high = middle_down + intakes.height_m / 2, middle_down - intakes.height_m / 2
    for above, below in ((top, high), (low, bottom)):
        if below > above:
            blocks.append(((0.0, -width / 4, (above + below) / 2), (length, width / 2, below - above)))
    pitch = length / intakes.count
    mouths = (np.arange(intakes.count) + 0.5) * pitch - length / 2
    edges = [
        -length / 2,
        *np.ravel([mouths - intakes.width_m / 2, mouths + intakes.width_m / 2], order="F"),
        length / 2,
    ]
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if last > first:
            blocks.append((((first + last) / 2, -width / 4, middle_down), (last - first, width / 2, intakes.height_m)))
    turn = heading_matrix(heading_rad)
    parts = [block("dam", centre + turn @ place, size, heading_rad, CONCRETE) for place, size in blocks]
    for mouth in mouths.tolist():
        for share in ((np.arange(intakes.bars) + 1) / (intakes.bars + 1)).tolist():
            place = np.array([mouth + (share - 0.5) * intakes.width_m, _BAR_M - width / 2, middle_down])
            size = (_BAR_M, _BAR_M, intakes.height_m)
            parts.append(block("bars", centre + turn @ place, size, heading_rad, STEEL))
    return parts
