"""Meshes from files: STL, DAE, OBJ, PLY, glTF and GLB, through trimesh.

The file's axes are x east, y north, z up (or, as in glTF, y up and x east, with `up` "y"); a heading turns it clockwise
as seen from above, so that its y axis, north before, points there.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np
from numpy import float64, int32
from numpy.typing import NDArray

from sim_core.frames import enu_to_ned
from sim_core.world.error import WorldError
from sim_core.world.materials import CONCRETE, Material
from sim_core.world.mesh import Mesh
from sim_core.world.shapes import heading_matrix

Array = NDArray[float64]
FORMATS = ("stl", "dae", "obj", "ply", "gltf", "glb")
LARGEST_M = 2000.0
"""Of what is not suspected to be in millimetres."""
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def import_mesh(
    path: Path,
    position_ned_m: tuple[float, float, float],
    heading_deg: float = 0.0,
    scale: float = 1.0,
    up: Literal["y", "z"] = "z",
    material: Material = CONCRETE,
) -> tuple[Mesh, str | None]:
    """The mesh in NED, its origin at position_ned_m; and a warning if it looks like millimetres.

    Raises:
        WorldError: no such file, another format, no triangles, or coordinates that are not numbers.
    """
    vertices, faces = _read(path)
    if not len(faces):
        raise WorldError(f"{path} has no triangles; export it again, as a mesh of triangles")
    if not np.isfinite(vertices).all():
        raise WorldError(f"{path} has vertices that are not numbers; repair the mesh and export it again")
    own = scale * (vertices if up == "z" else vertices @ _Y_UP.T)
    extent_m = float(np.ptp(own[faces].reshape(-1, 3), axis=0).max())
    warning = None
    if extent_m > LARGEST_M:
        warning = f"{path} is {extent_m:.0f} m across; if it is in millimetres, give it scale: {scale / 1000:g}"
    turned = enu_to_ned(own) @ heading_matrix(math.radians(heading_deg)).T
    return Mesh(turned + np.array(position_ned_m), faces, material), warning


def _read(path: Path) -> tuple[Array, NDArray[int32]]:
    """Vertices (V, 3) and faces (F, 3), of all that the file holds."""
    kind = path.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise WorldError(f"{path} is not of a known format; use one of {', '.join(FORMATS)}")
    if not path.is_file():
        raise WorldError(f"{path} does not exist; give the path of a mesh, relative to the profile")
    try:
        import trimesh
    except ImportError:
        raise WorldError("meshes need trimesh, which is not installed; pip install 'xitl[perception]'") from None
    try:
        # Processed, vertices that are not numbers would go, and their triangles with them, unsaid.
        loaded = trimesh.load_scene(path, process=False).to_mesh()
        vertices, faces = np.asarray(loaded.vertices, dtype=float64), np.asarray(loaded.faces, dtype=int32)
    except ImportError as error:  # it tries other readers on a damaged file, too
        raise WorldError(
            f"{path} cannot be read as {kind}: it is damaged, or of a kind that needs more ({error}); export it again"
        ) from error
    except Exception as error:  # its readers raise whatever a damaged file leads them to
        raise WorldError(f"{path} cannot be read as {kind} ({error}); export it again") from error
    if vertices.ndim != 2 or faces.ndim != 2:
        return np.empty((0, 3)), np.empty((0, 3), dtype=int32)
    return vertices, faces
