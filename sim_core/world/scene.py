"""What stands in the river: parts with names, and a caster for all of them.

Scene
└── Part      name, Mesh, and the solids it is made of, if closed forms know them
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from sim_core.world.mesh import Mesh
from sim_core.world.rays import RayCaster
from sim_core.world.solids import Solid

Backend = Literal["embree", "numpy"]


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A mesh in NED; `solids`: the same in closed form, in NED, empty where there is none."""

    name: str
    mesh: Mesh
    solids: tuple[Solid, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All that does not move."""

    parts: tuple[Part, ...] = ()

    @property
    def triangles(self) -> int:
        """Of all parts."""
        return sum(len(part.mesh.faces) for part in self.parts)


def caster_of(scene: Scene, backend: Backend = "embree") -> RayCaster:
    """A caster for the scene: Embree, or numpy, which is slow and needs nothing else.

    Raises:
        WorldError: embree is wanted and not installed.
    """
    if backend == "numpy":
        from sim_core.world.primitive_rays import PrimitiveCaster

        meshes = [part.mesh for part in scene.parts if not part.solids]
        return PrimitiveCaster([solid for part in scene.parts for solid in part.solids], meshes)
    from sim_core.world.embree_rays import EmbreeCaster

    return EmbreeCaster([part.mesh for part in scene.parts])
