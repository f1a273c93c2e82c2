"""What rays meet: the interface of ray casting.

    hits = caster.cast(origin_ned_m, direction_ned, bodies)

A caster knows what does not move. What drifts comes with every call.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy import float32, float64, int16
from numpy.typing import NDArray

from sim_core.world.mesh import Mesh

Array = NDArray[float64]
Array32 = NDArray[float32]


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


NO_BODIES = Bodies((), np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Of R rays: range_m (R,), inf for none; normal_ned (R, 3), unit, toward where the ray came from, 0 for none.

    material (R,): number in `materials.MATERIALS`, -1 for none. body (R,): number of the body, -1 for none and for what
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
