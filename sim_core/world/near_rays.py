"""Which rays pass near which bodies, at the cost of one product a ray and body."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy import float32, float64
from numpy.typing import NDArray

from sim_core.world.rays import Array32, Bodies


def rays_near(
    origin_ned_m: Array32,
    direction_ned: Array32,
    bodies: Bodies,
    radius_m: NDArray[float64],
    delay_s: Array32 | None = None,
) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Yields (number of a body, numbers of the rays that may meet it): never too few, and mostly few.

    radius_m (B,): of the sphere about each body's middle that holds it. A ray d from o passes a sphere about c within r
    when d . (c - o) >= sqrt(|c - o|^2 - r^2). One o stands for all origins, with r greater by how far they are from it
    and by how far the body drifts.
    """
    if not len(origin_ned_m):
        return
    # By columns: numpy is ten times slower at the least of rows of three.
    low = np.array([column.min() for column in origin_ned_m.T], dtype=float64)
    high = np.array([column.max() for column in origin_ned_m.T], dtype=float64)
    spread_m = float(np.linalg.norm(high - low)) / 2
    latest_s = 0.0 if delay_s is None else float(np.abs(delay_s).max())
    # A millimetre, and a millionth of the distance for single precision.
    centre = bodies.pos_ned_m - (low + high) / 2
    distance = np.linalg.norm(centre, axis=-1)
    reach = radius_m + spread_m + latest_s * np.linalg.norm(bodies.vel_ned_mps, axis=-1) + 1e-3 + 1e-6 * distance
    inside = distance <= reach
    least = np.sqrt(np.maximum(distance**2 - reach**2, 0.0)) * (1 - 1e-6)
    least[inside] = -np.inf
    near = centre.astype(float32) @ direction_ned.T >= least.astype(float32)[:, None]
    for body in np.flatnonzero(near.any(axis=1)).tolist():
        yield body, np.flatnonzero(near[body])
