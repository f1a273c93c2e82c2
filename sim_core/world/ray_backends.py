"""Choice of the backend that casts rays at a scene.

hits = make_caster(scene).cast(origin_ned_m, direction_ned, bodies)
"""

from __future__ import annotations

from sim_core.world.rays import Backend, RayCaster, Scene


def make_caster(scene: Scene, backend: Backend = "embree") -> RayCaster:
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
