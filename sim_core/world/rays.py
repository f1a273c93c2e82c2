"""Ray casting: a scene of fixed geometry, drifting bodies, and the hits of rays.

    hits = ray_backends.make_caster(scene).cast(origin_ned_m, direction_ned, bodies)

A caster holds the fixed geometry. Each call supplies the drifting bodies.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, Protocol

import numpy as np
from numpy import float32, float64, int16
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array, Array32
from sim_core.world.geometry import Mesh, Solid


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """B drifting bodies at one instant."""

    meshes: tuple[Mesh, ...]
    """Meshes, each in its body axes (forward, right, down), about its middle."""
    pos_ned_m: Array
    """Positions, (B, 3)."""
    vel_ned_mps: Array
    """Velocities, (B, 3)."""
    rot_ned_body: Array
    """Rotations from body axes to NED, (B, 3, 3)."""

    def joined(self, other: Bodies) -> Bodies:
        """Return these bodies, then the others."""
        return Bodies(
            self.meshes + other.meshes,
            np.concatenate([self.pos_ned_m, other.pos_ned_m]),
            np.concatenate([self.vel_ned_mps, other.vel_ned_mps]),
            np.concatenate([self.rot_ned_body, other.rot_ned_body]),
        )


NO_BODIES = Bodies((), np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Hits of R rays."""

    range_m: Array32
    """Ranges, (R,), inf for none."""
    normal_ned: Array32
    """Unit normals toward the origin of the ray, (R, 3), 0 for none."""
    material: NDArray[int16]
    """Indices into `geometry.MATERIALS`, (R,), -1 for none."""
    body: NDArray[int16]
    """Indices of bodies, (R,), -1 for none and for fixed geometry."""


class RayCaster(Protocol):
    """Ray casting by one backend.

    `cast` casts R rays in single precision from origin_ned_m along unit vectors
    direction_ned, both (R, 3). `body_delay_s` (R,), if given, is the delay of each ray after the instant of `bodies`:
    the bodies then move on with their velocity. `reach_m` (R,), if given, is the range beyond which hits may be
    omitted.
    """

    triangles: int
    """Number of fixed triangles."""

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
    """Yield (index of a body, indices of the rays that may hit it): never too few, and mostly few.

    radius_m (B,): radius of the bounding sphere about each body's middle. A ray d from o passes a sphere about c within
    r if d . (c - o) >= sqrt(|c - o|^2 - r^2). One o represents all origins. r grows by their distance from it and by
    the drift of the body.
    """
    if not len(origin_ned_m):
        return
    # By columns: numpy is at least ten times slower for rows of three.
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
    """A mesh in NED."""

    name: str
    mesh: Mesh
    solids: tuple[Solid, ...] = ()
    """The same shape in closed form, in NED; empty if there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All fixed geometry."""

    parts: tuple[ScenePart, ...] = ()

    @property
    def triangles(self) -> int:
        """Number of triangles of all parts."""
        return sum(len(part.mesh.faces) for part in self.parts)
