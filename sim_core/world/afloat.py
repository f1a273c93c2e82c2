"""How deep a closed mesh floats.

The volume below a level plane is, by the divergence theorem with the field (0, 0, max(z - level, 0)), the sum over the
triangles of their area seen from above, signed, times the mean of max(z - level, 0) over each: no triangle is cut.
"""

from __future__ import annotations

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.world.mesh import Mesh

Array = NDArray[float64]


def volume_below_m3(mesh: Mesh, level_m: float) -> float:
    """Volume of what lies below (z, down, greater than) `level_m`, in the mesh's axes."""
    corner = mesh.vertices_m[mesh.faces]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    seen_m2 = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    return float(seen_m2 @ _mean_depth_m(corner[:, :, 2] - level_m))


def waterline_m(mesh: Mesh, volume_m3: float) -> float:
    """Height (z, down) of the water's surface in the mesh's axes when it displaces `volume_m3`.

    Raises ValueError when that is more than the mesh has: it would sink.
    """
    top, bottom = float(mesh.vertices_m[:, 2].min()), float(mesh.vertices_m[:, 2].max())
    if not 0.0 < volume_m3 < volume_below_m3(mesh, top):
        raise ValueError(f"a body that displaces {volume_m3:.3g} m3 afloat has {volume_below_m3(mesh, top):.3g} m3")
    for _ in range(60):  # bisection to rounding
        middle = 0.5 * (top + bottom)
        if volume_below_m3(mesh, middle) > volume_m3:
            top = middle
        else:
            bottom = middle
    return 0.5 * (top + bottom)


def _mean_depth_m(depth_m: Array) -> Array:
    """(F,) mean over triangles of the positive part of a depth that is linear in them, from the corners' (F, 3).

    With corners a <= b <= c, where only a < 0 the part cut off is a pyramid of height -a on the share
    a^2 / ((b - a) (c - a)) of the area, and as well for c where only c > 0.
    """
    a, b, c = np.sort(depth_m, axis=1).T
    mean = np.where(a >= 0.0, (a + b + c) / 3.0, 0.0)
    one_dry = (a < 0.0) & (b >= 0.0) & (c > 0.0)
    one_wet = (b < 0.0) & (c > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(one_dry, (a + b + c) / 3.0 - a**3 / (3.0 * (b - a) * (c - a)), mean)
        wet: Array = np.where(one_wet, c**3 / (3.0 * (c - a) * (c - b)), mean)
    return wet
