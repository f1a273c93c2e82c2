"""Bed, banks, rocks, buildings and meshes as Foxglove and Lichtblick draw them: triangles, an entity for each name."""

from __future__ import annotations

import numpy as np
from foxglove import messages

from sim_core import frames
from sim_core.world.geometry import MATERIALS, Mesh
from sim_core.world.river import RiverBed
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import MAP_FRAME
from xitl_cli.run.world.scenery import Scenery

_CELL_M = 8.0
"""Of the ground as drawn: it would be most of a short recording as it is cast."""
MOST_DRAWN = 300_000
"""Triangles of one mesh: more would be most of any recording, and no viewer's pleasure."""
_DRAWN_OTHERWISE = ("bed", "ground", "log boom", "boom pile")
_COLOURS = {
    "concrete": (0.6, 0.6, 0.6),
    "steel": (0.45, 0.47, 0.5),
    "plastic": (0.95, 0.45, 0.1),
    "wood": (0.4, 0.28, 0.18),
    "leaves": (0.2, 0.45, 0.15),
    "hide": (0.45, 0.3, 0.2),
    "earth": (0.55, 0.45, 0.3),
    "rock": (0.4, 0.38, 0.36),
    "wall": (0.85, 0.82, 0.75),
    "bed": (0.3, 0.25, 0.18),
}
assert set(_COLOURS) == {material.name for material in MATERIALS}


def land_of(profile: RunProfile, scenery: Scenery) -> list[messages.SceneEntity]:
    """What stands around, without the boom; nothing where the world is a boom and a plain dam alone.

    A mesh of more than MOST_DRAWN triangles is left out, with a warning of the scenery's.
    """
    world, by_name = profile.world, dict[str, list[Mesh]]()
    plain = world.dam is None or world.dam.intakes is None
    if plain and world.river is None and not (world.shoals or world.buildings or world.meshes):
        return []
    if isinstance(scenery.bed, RiverBed) and world.river is not None:
        by_name["ground"] = scenery.bed.meshes(world.river.along_m, world.river.beside_m, _CELL_M)
    for part in scenery.scene.parts:
        if part.name in _DRAWN_OTHERWISE or (plain and part.name == "dam"):
            continue
        if len(part.mesh.faces) > MOST_DRAWN:
            scenery.warn(
                f"{part.name} has {len(part.mesh.faces)} triangles and is not drawn in the recording; rays do meet it"
            )
            continue
        by_name.setdefault(part.name, []).append(part.mesh)
    return [
        messages.SceneEntity(frame_id=MAP_FRAME, id=name, triangles=[_triangles(mesh) for mesh in meshes])
        for name, meshes in by_name.items()
    ]


def _triangles(mesh: Mesh) -> messages.TriangleListPrimitive:
    used, faces = np.unique(mesh.faces, return_inverse=True)
    red, green, blue = _COLOURS[mesh.material.name]
    return messages.TriangleListPrimitive(
        pose=messages.Pose(
            position=messages.Vector3(x=0.0, y=0.0, z=0.0), orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
        ),
        points=[messages.Point3(x=x, y=y, z=z) for x, y, z in frames.ned_to_enu(mesh.vertices_m[used]).tolist()],
        color=messages.Color(r=red, g=green, b=blue, a=1.0),
        indices=faces.ravel().tolist(),
    )
