"""Hulls as strips of cross-sections: round, box-shaped or tabulated sections with taper, or sections cut from a mesh.

A cross-section is a polygon in the plane of y and z. Its corners go to starboard along the bottom and back over the
deck.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy import int32
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.keys import SpecificationError
from sim_core.mesh_file import MeshFileError, modified_ns, read_triangles
from sim_core.vessel.spec import DemiHull, HullMesh, HullSection, VisualMesh

ROUND_CORNERS = 32
"""Corners of the polygon that replaces a round section. It has the area of the circle and is 0.16 % less deep."""
_WITHIN = 1e-6  # the end cuts of a mesh are inside its ends by this share of its length
VISUAL_SIZE = 4.0
"""Largest ratio of the length of a drawn mesh to the vessel's length, either way: finds a mesh without a scale."""
MESH_SHARE, MESH_LENGTH_SHARE = 0.05, 0.2
"""Largest difference between a mesh's size and its keys. The waterline may be shorter than the mesh."""


@dataclass(frozen=True, slots=True, eq=False)
class HullStrips:
    """S strips of one hull, from stern to bow, in body axes."""

    along_m: Array
    """The middle of each strip's volume, (S,)."""
    length_m: Array
    """Volume over the area of the cross-section, (S,)."""
    corners_m: Array
    """y and z of the cross-section, (S, C, 2). The last corner repeats the first."""

    @property
    def area_m2(self) -> Array:
        """Areas of the cross-sections, (S,)."""
        y, z = self.corners_m[..., 0], self.corners_m[..., 1]
        area: Array = 0.5 * (y[:, 1:] * z[:, :-1] - y[:, :-1] * z[:, 1:]).sum(axis=1)
        return area


@dataclass(frozen=True, slots=True, eq=False)
class HullShape:
    """The surface of a hull as triangles in body axes."""

    vertices_m: Array
    """Vertices, (V, 3)."""
    faces: NDArray[int32]
    """Indices of vertices, (F, 3), counter-clockwise from outside."""


def cut_strips(hull: DemiHull) -> HullStrips:
    """Return the strips of a hull.

    Raises:
        MeshFileError: the mesh is not available, is not closed or encloses nothing.
        SpecificationError: its size differs from the hull's keys.
    """
    return _tapered_strips(hull, hull.section) if hull.section is not None else _mesh_strips(hull)


def hull_shape(hull: DemiHull) -> HullShape:
    """Return the surface of a hull for drawing. Raises the same errors as `cut_strips`."""
    if hull.section is None:
        return _placed_mesh(hull)
    corners = section_corners_m(hull.section)
    count = len(corners)
    rings = [
        np.column_stack([np.full(count, place * hull.length_m), corners * [share, 1.0]]) for place, share in hull.taper
    ]
    here = np.arange(count)
    ahead = (here + 1) % count
    faces = [np.column_stack([np.zeros(count - 2, int), here[1:-1], here[2:]])]
    for ring in range(len(rings) - 1):
        low, high = ring * count, (ring + 1) * count
        faces += [
            np.column_stack([low + here, high + here, high + ahead]),
            np.column_stack([low + here, high + ahead, low + ahead]),
        ]
    faces.append(faces[0][:, ::-1] + (len(rings) - 1) * count)
    return HullShape(np.concatenate(rings) + hull.keel_frd_m, np.concatenate(faces).astype(int32))


def visual_shape(visual: VisualMesh, length_m: float) -> HullShape:
    """Return the mesh that is drawn for a vessel of this length, in body axes.

    Raises:
        SpecificationError: the mesh is not available, has holes or encloses nothing, or its size does not fit.
    """
    try:
        vertices, faces = _closed_mesh(visual, modified_ns(visual.file))
    except MeshFileError as error:
        raise SpecificationError(("visual", "file"), f"= {visual.file} {error}") from error
    drawn_m = float(np.ptp(vertices, axis=0).max())
    if not length_m / VISUAL_SIZE <= drawn_m <= length_m * VISUAL_SIZE:
        raise SpecificationError(
            ("visual", "scale"),
            f"= {visual.scale:g} makes {visual.file} {drawn_m:.3g} m long, and the vessel is {length_m:.3g} m long; "
            f"use {visual.scale * length_m / drawn_m:.2g}, or the unit of the mesh, such as 0.001 for millimetres",
        )
    return HullShape(vertices + visual.origin_frd_m, faces)


def section_corners_m(section: HullSection) -> Array:
    """Return (C, 2) y and z of a section's corners, with the keel at the origin."""
    radius_m = section.radius_m
    if radius_m is not None:
        turn = 2.0 * math.pi / ROUND_CORNERS
        angle = turn * (np.arange(ROUND_CORNERS) - 0.5)
        equal_area_m = radius_m * math.sqrt(turn / math.sin(turn))
        return np.column_stack([equal_area_m * np.sin(angle), equal_area_m * np.cos(angle) - radius_m])
    table = section.offsets_m
    if table is None:
        assert section.width_m is not None
        assert section.depth_m is not None
        table = ((0.0, 0.5 * section.width_m), (section.depth_m, 0.5 * section.width_m))
    up_m, half_m = np.array(table).T
    corners = np.concatenate([np.column_stack([half_m, -up_m]), np.column_stack([-half_m, -up_m])[::-1]])
    once: Array = corners[np.any(corners != np.roll(corners, 1, axis=0), axis=1)]  # keel or deck may be a line
    return once


def _tapered_strips(hull: DemiHull, section: HullSection) -> HullStrips:
    """Cut a tapered hull. Volumes and their middles are exact: the areas scale with the share of the width."""
    edges = np.linspace(-0.5, 0.5, hull.strips + 1)
    places, shares = np.array(hull.taper).T
    ends = np.array(sorted({*edges.tolist(), *places.tolist()}))  # union1d would import numpy.ma, 12 ms
    middle, step = 0.5 * (ends[1:] + ends[:-1]), np.diff(ends)
    at_ends, at_middle = np.interp(ends, places, shares), np.interp(middle, places, shares)
    strip = np.searchsorted(edges, middle) - 1
    volume = np.bincount(strip, step * at_middle, hull.strips)
    moment = (at_ends[:-1] * ends[:-1] + 4.0 * at_middle * middle + at_ends[1:] * ends[1:]) * step / 6.0  # Simpson
    centre = 0.5 * (edges[1:] + edges[:-1])
    along = np.where(volume > 0, np.bincount(strip, moment, hull.strips) / np.where(volume > 0, volume, 1.0), centre)
    corners = section_corners_m(section)
    corners = np.concatenate([corners, corners[:1]])
    width = (volume * hull.strips)[:, None]
    x_m, y_m, z_m = hull.keel_frd_m
    return HullStrips(
        along_m=x_m + hull.length_m * along,
        length_m=np.full(hull.strips, hull.length_m / hull.strips),
        corners_m=np.stack([y_m + width * corners[:, 0], np.tile(z_m + corners[:, 1], (hull.strips, 1))], axis=-1),
    )


def _mesh_strips(hull: DemiHull) -> HullStrips:
    """Cut a mesh at the middles of the strips. Volumes and middles follow Simpson's rule and add up to the mesh's
    volume.
    """
    assert hull.mesh is not None
    shape = _placed_mesh(hull)
    low_m, high_m = shape.vertices_m[:, 0].min(), shape.vertices_m[:, 0].max()
    places = np.linspace(low_m, high_m, 2 * hull.strips + 1)
    places[0], places[-1] = places[0] + _WITHIN * (high_m - low_m), places[-1] - _WITHIN * (high_m - low_m)
    cut_loops = [_cut_mesh(shape, x_m) for x_m in places.tolist()]
    area = np.array([sum(map(_loop_area_m2, loops)) for loops in cut_loops])
    cuts = [_simplified(loops, hull.mesh.corners) for loops in cut_loops[1::2]]
    most = max(len(cut) for cut in cuts)
    middle = np.array([hull.keel_frd_m[1:]])
    cuts = [cut if len(cut) else middle for cut in cuts]  # no part of the mesh there
    # Volumes and their middles, by Simpson's rule
    step = (high_m - low_m) / hull.strips / 6.0
    volume = step * (area[:-1:2] + 4.0 * area[1::2] + area[2::2])
    moment = step * (area * places)[:-1:2] + step * (4.0 * (area * places)[1::2] + (area * places)[2::2])
    cut_there = (area[1::2] > 0.0) & (volume > 0.0)
    length_m = np.where(cut_there, volume / np.where(cut_there, area[1::2], 1.0), 0.0)
    length_m *= _volume_m3(shape.vertices_m[shape.faces]) / (length_m @ area[1::2])
    return HullStrips(
        along_m=np.where(cut_there, moment / np.where(cut_there, volume, 1.0), places[1::2]),
        length_m=length_m,
        corners_m=np.stack([np.concatenate([cut, np.repeat(cut[:1], most + 1 - len(cut), axis=0)]) for cut in cuts]),
    )


def _placed_mesh(hull: DemiHull) -> HullShape:
    """Return the mesh with the middle of its lowest line at the hull's keel."""
    assert hull.mesh is not None
    path = hull.mesh.file
    vertices, faces = _closed_mesh(hull.mesh, modified_ns(path))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size_m = high - low
    for key, given_m, short, axis in (
        (("length_m",), hull.length_m, MESH_LENGTH_SHARE, 0),
        (("mesh", "width_m"), hull.mesh.width_m, MESH_SHARE, 1),
        (("mesh", "depth_m"), hull.mesh.depth_m, MESH_SHARE, 2),
    ):
        if not (1.0 - short) * size_m[axis] <= given_m <= (1.0 + MESH_SHARE) * size_m[axis]:
            measured = " x ".join(f"{extent:.3g}" for extent in size_m)
            raise SpecificationError(
                key,
                f"= {given_m:g} does not fit {path}, which is {measured} m long, wide and deep; "
                f"use {size_m[axis]:.3g}, or correct the mesh's scale or axes",
            )
    lowest = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), high[2]])
    return HullShape(vertices - lowest + hull.keel_frd_m, faces)


@lru_cache(maxsize=16)
def _closed_mesh(mesh: HullMesh | VisualMesh, stamp_ns: int) -> tuple[Array, NDArray[int32]]:
    """Return vertices in FRD about the mesh's origin, and faces that point outward."""
    vertices, faces = read_triangles(Path(mesh.file))
    if not len(faces):
        raise MeshFileError("has no triangles; export it again, as a mesh of triangles")
    if not np.isfinite(vertices).all():
        raise MeshFileError("has vertices that are not numbers; repair the mesh and export it again")
    # A file of triangles without shared vertices, such as STL, repeats them.
    _, first, number = np.unique(vertices.astype(np.float32), axis=0, return_index=True, return_inverse=True)
    vertices, faces = vertices[first], number.reshape(-1)[faces].astype(int32)
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    used, number = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], number.reshape(-1, 3).astype(int32)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, edge, sharing = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    odd = int(np.count_nonzero(sharing % 2))
    if odd:
        raise MeshFileError(
            f"is not closed: {odd} of its {len(sharing)} edges belong to a single triangle; "
            "close its holes, deck included"
        )
    if np.any(np.bincount(edge.reshape(-1), np.where(edges[:, 0] < edges[:, 1], 1, -1))):
        raise MeshFileError("has triangles that face inward and others that face outward; make its normals agree")
    own = mesh.scale * vertices * (1.0 if mesh.axes == "frd" else np.array([1.0, -1.0, -1.0]))
    volume_m3, size_m3 = _volume_m3(own[faces]), float(np.prod(np.ptp(own, axis=0)))
    if abs(volume_m3) <= 1e-6 * size_m3 or not size_m3:
        raise MeshFileError("encloses no volume; export it as a closed body with a deck")
    return own, (faces if volume_m3 > 0 else faces[:, ::-1])


def _volume_m3(corners_m: Array) -> float:
    """Return the volume that (F, 3, 3) triangles enclose, positive for counter-clockwise faces from outside."""
    a, b, c = corners_m.transpose(1, 0, 2)
    return float(np.vecdot(a, np.cross(b, c)).sum() / 6.0)


def _cut_mesh(shape: HullShape, along_m: float) -> list[Array]:
    """Return (C, 2) y and z of each loop in which a plane across the hull cuts the surface."""
    ahead = shape.vertices_m[:, 0] >= along_m
    onward: dict[tuple[int, int], list[tuple[int, int]]] = {}  # from each cut edge to the next, over a face
    for face in shape.faces[np.ptp(ahead[shape.faces].astype(int), axis=1) > 0].tolist():
        edges = list(pairwise((*face, face[0])))
        (forward,) = ((start, end) for start, end in edges if ahead[end] and not ahead[start])
        (back,) = ((end, start) for start, end in edges if ahead[start] and not ahead[end])
        onward.setdefault(forward, []).append(back)
    loops = []
    while onward:
        loop = [next(iter(onward))]
        while loop[-1] in onward:
            edge = loop[-1]
            loop.append(onward[edge].pop())
            if not onward[edge]:
                del onward[edge]
        behind, before = shape.vertices_m[np.array(loop[1:]).T]
        share = (along_m - behind[:, 0]) / (before[:, 0] - behind[:, 0])
        loops.append((behind + share[:, None] * (before - behind))[:, 1:])
    return loops


def _simplified(loops: list[Array], corners: int) -> Array:
    """Return (C, 2) of all loops in one line, without the least important corners (Visvalingam and Whyatt 1993).

    The remaining corners keep their heights. Their widths are stretched to the area of each loop. The line passes the
    connections between loops in both directions, so that they cancel.
    """
    share = corners / max(sum(len(loop) for loop in loops), corners)
    simplified = []
    for loop_m in loops:
        # Remove the corner of the smallest triangle with its neighbours, again and again
        left = loop_m
        while len(left) > max(round(share * len(loop_m)), 4):
            before, after = np.roll(left, 1, axis=0) - left, np.roll(left, -1, axis=0) - left
            left = np.delete(left, np.argmin(np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])), axis=0)
        # Stretch the widths to the area of the loop
        wanted, area, middle = _loop_area_m2(loop_m), _loop_area_m2(left), left[:, 0].mean()
        if area:
            left = np.column_stack([middle + (left[:, 0] - middle) * (wanted / area), left[:, 1]])
        simplified.append(left)
    parts = [np.concatenate([loop, loop[:1]]) for loop in simplified] + [loop[:1] for loop in simplified[-2::-1]]
    return np.concatenate([np.empty((0, 2)), *parts])


def _loop_area_m2(loop_m: Array) -> float:
    """Return the area like `HullStrips.area_m2`; negative for a hole."""
    y, z = loop_m.T
    return 0.5 * float(np.sum(np.roll(y, -1) * z - y * np.roll(z, -1)))
