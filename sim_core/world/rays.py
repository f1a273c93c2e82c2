"""Ray casting: a scene of what does not move, bodies adrift, and what rays meet of them.

    hits = ray_backends.make_caster(scene).cast(origin_ned_m, direction_ned, bodies)

A caster knows what does not move. What drifts comes with every call.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy import float32, float64, int16
from numpy.typing import NDArray

from sim_core.frames import Array, Array32
from sim_core.world.geometry import Mesh, Solid


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """B bodies adrift at one instant.

    meshes: each in its own axes (forward, right, down), about its middle. pos_ned_m, vel_ned_mps (B, 3);
    rot_ned_body (B, 3, 3).
    """

    meshes: tuple[Mesh, ...]
    pos_ned_m: Array
    vel_ned_mps: Array
    rot_ned_body: Array

    def joined(self, other: Bodies) -> Bodies:
        """These, then the others."""
        return Bodies(
            self.meshes + other.meshes,
            np.concatenate([self.pos_ned_m, other.pos_ned_m]),
            np.concatenate([self.vel_ned_mps, other.vel_ned_mps]),
            np.concatenate([self.rot_ned_body, other.rot_ned_body]),
        )


NO_BODIES = Bodies((), np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Of R rays: range_m (R,), inf for none; normal_ned (R, 3), unit, toward where the ray came from, 0 for none.

    material (R,): number in `geometry.MATERIALS`, -1 for none. body (R,): number of the body, -1 for none and for what
    does not move.
    """

    range_m: Array32
    normal_ned: Array32
    material: NDArray[int16]
    body: NDArray[int16]


class RayCaster(Protocol):
    """Ray casting by one backend.

    triangles: how many does it know. cast: of R rays from origin_ned_m along unit vectors direction_ned, both (R, 3),
    in single precision. `body_delay_s` (R,), if given, is how much later than `bodies` each ray goes out: bodies are
    then met where their velocity has brought them. `reach_m` (R,), if given: what is farther need not be found.
    """

    triangles: int

    def cast(
        self,
        origin_ned_m: Array32,
        direction_ned: Array32,
        bodies: Bodies = NO_BODIES,
        body_delay_s: Array32 | None = None,
        reach_m: Array32 | None = None,
    ) -> Hits: ...


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


Backend = Literal["embree", "numpy"]


@dataclass(frozen=True, slots=True, eq=False)
class ScenePart:
    """A mesh in NED; `solids`: the same in closed form, in NED, empty where there is none."""

    name: str
    mesh: Mesh
    solids: tuple[Solid, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All that does not move."""

    parts: tuple[ScenePart, ...] = ()

    @property
    def triangles(self) -> int:
        """Of all parts."""
        return sum(len(part.mesh.faces) for part in self.parts)
