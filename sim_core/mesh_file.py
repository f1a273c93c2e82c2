"""Triangles from mesh files, read by the package trimesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy import float64, int32
from numpy.typing import NDArray

from sim_core.frames import Array
from sim_core.keys import MESH_FORMATS

LARGEST_BYTES = 512 << 20


class MeshFileError(Exception):
    """Problem of a mesh file and its fix, as text after the file name."""


def modified_ns(file: str) -> int:
    """Return the time of the last change of a file, 0 for none. With it, a cache notices a changed mesh."""
    path = Path(file)
    return path.stat().st_mtime_ns if path.is_file() else 0


def read_triangles(path: Path) -> tuple[Array, NDArray[int32]]:
    """Read the vertices (V, 3) and faces (F, 3) of everything in the file.

    Raises:
        MeshFileError: no such file, another format, a damaged one, or trimesh is not installed.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind not in MESH_FORMATS:
        raise MeshFileError(f"is not of a known format; use one of {', '.join(MESH_FORMATS)}")
    if not path.is_file():
        raise MeshFileError("does not exist; give the path of a mesh, relative to the profile")
    if path.stat().st_size > LARGEST_BYTES:
        raise MeshFileError(f"has more than {LARGEST_BYTES >> 20} MiB; reduce the mesh and export it again")
    try:
        import trimesh
    except ImportError:
        raise MeshFileError("needs trimesh, which is not installed; pip install 'xitl[perception]'") from None
    try:
        # Processing would silently remove vertices that are not numbers, together with their triangles.
        loaded = trimesh.load_scene(path, process=False).to_mesh()
        vertices, faces = np.asarray(loaded.vertices, dtype=float64), np.asarray(loaded.faces, dtype=int32)
    except ImportError as error:  # for a damaged file, trimesh tries other readers too
        raise MeshFileError(
            f"cannot be read as {kind}: it is damaged, or of a kind that needs more ({error}); export it again"
        ) from error
    except Exception as error:  # a damaged file can raise any error in the readers
        raise MeshFileError(f"cannot be read as {kind} ({error}); export it again") from error
    if vertices.ndim != 2 or faces.ndim != 2:
        return np.empty((0, 3)), np.empty((0, 3), dtype=int32)
    return vertices, faces
