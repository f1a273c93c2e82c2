"""Triangles."""

from __future__ import annotations

from dataclasses import dataclass

from numpy import float64, int32
from numpy.typing import NDArray

from sim_core.world.materials import Material


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles of one material: vertices_m (V, 3), faces (F, 3) numbers of vertices, counter-clockwise from outside.

    The axes are those of who holds it: NED for what stands in the river, forward, right, down for a body.
    """

    vertices_m: NDArray[float64]
    faces: NDArray[int32]
    material: Material
