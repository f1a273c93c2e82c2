"""Objects as a radar at X band sees them: scattering points with their cross sections, and what hides them.

    points = mesh_points(mesh, spacing_m)

Rough surfaces follow the constant-gamma law: sigma = gamma A cos(incidence), because sigma0 = gamma sin(grazing).
Gammas at 10 GHz are Barton's (Radar Equations for Modern Radar, 2013: woods and fields -15 dB, wooded hills -10 dB,
rugged mountains and towns 0 dB). Gammas of wood, plastic and hides are chosen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.world.geometry import MATERIALS, Mesh

_GAMMA_DB = {
    "concrete": 0.0, "steel": 0.0, "wall": 0.0, "rock": 0.0, "earth": -15.0, "bed": -15.0, "leaves": -10.0,
    "wood": -10.0, "plastic": -10.0, "hide": -10.0,
}  # fmt: skip
GAMMA = {material: 10.0 ** (0.1 * _GAMMA_DB[material.name]) for material in MATERIALS}
_VESSELS = np.log10(
    [(3.0, 0.02), (7.6, 2.0), (10.0, 2.5), (13.7, 10.0), (60.0, 4.2e3), (161.0, 3.5e5), (325.0, 8.3e6)]
).T
"""Length in m and mean cross section in m²: an open boat, a pleasure boat of 20 to 30 feet and a cabin cruiser of 40 to
50 feet (Skolnik, Introduction to Radar Systems, 2001, table 2.2); a boat of 10 m (IMO MSC.192(79), table 2); ships by
52 f^0.5 D^1.5 (Skolnik, f in MHz, D in kilotons) with the displacement of a Mariner, 17 kt at 161 m, and length cubed.
"""


def vessel_section_m2(length_m: ArrayLike) -> Array:
    """Return the mean cross section (...,) over all aspects at X band, interpolated in logarithms of the length."""
    logs = np.log10(length_m)
    x, y = _VESSELS
    first, last = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
    beyond = first * np.minimum(logs - x[0], 0.0) + last * np.maximum(logs - x[-1], 0.0)
    section: Array = 10.0 ** (np.interp(logs, x, y) + beyond)
    return section


@dataclass(frozen=True, slots=True, eq=False)
class ScatterPoints:
    """P points of surfaces, or with a constant cross section."""

    place_m: Array
    """Positions, (P, 3)."""
    facing_m2: Array
    """Outward normals, with the length gamma times area, (P, 3); 0 for a constant cross section."""
    half_m: Array
    """Half the width of the surface of a point, (P,)."""
    constant_m2: Array
    """Constant cross sections, (P,); 0 for surfaces."""
    in_water: Array
    """1 for objects afloat, whose echo has a second path over the water, otherwise 0, (P,)."""
    circle_ne_m: tuple[float, float, float] = (0.0, 0.0, math.inf)
    """Middle and radius of a circle around all points in plan."""

    def __len__(self) -> int:
        return len(self.place_m)

    @classmethod
    def joined(cls, parts: Iterable[ScatterPoints]) -> ScatterPoints:
        """Join several parts in order."""
        parts = [NO_POINTS, *parts]
        return cls(
            np.concatenate([part.place_m for part in parts]),
            np.concatenate([part.facing_m2 for part in parts]),
            np.concatenate([part.half_m for part in parts]),
            np.concatenate([part.constant_m2 for part in parts]),
            np.concatenate([part.in_water for part in parts]),
        )

    def moved(self, pos_ned_m: Array, rot_ned_body: Array) -> ScatterPoints:
        """Return the points of a body with this pose, in NED."""
        place = pos_ned_m + self.place_m @ rot_ned_body.T
        return replace(self, place_m=place, facing_m2=self.facing_m2 @ rot_ned_body.T, circle_ne_m=(0.0, 0.0, math.inf))

    def above(self, water_down_m: float) -> ScatterPoints:
        """Return the points above the water."""
        return self.select(np.flatnonzero(self.place_m[:, 2] < water_down_m))

    def select(self, rows: NDArray[np.intp]) -> ScatterPoints:
        """Return the points of some rows."""
        return ScatterPoints(
            self.place_m[rows], self.facing_m2[rows], self.half_m[rows], self.constant_m2[rows], self.in_water[rows]
        )

    def tiles(self, size_m: float) -> list[ScatterPoints]:
        """Return the points by squares of a size in plan, with their circles."""
        if not len(self):
            return []
        square = np.floor(self.place_m[:, :2] / size_m).astype(np.intp)
        _, tile = np.unique(square, axis=0, return_inverse=True)
        order = np.argsort(tile, kind="stable")
        parts = []
        for rows in np.split(order, np.cumsum(np.bincount(tile))[:-1]):
            part = self.select(rows)
            north_m, east_m = part.place_m[:, :2].mean(axis=0).tolist()
            radius_m = float(np.hypot(part.place_m[:, 0] - north_m, part.place_m[:, 1] - east_m).max())
            parts.append(replace(part, circle_ne_m=(north_m, east_m, radius_m)))
        return parts

    def cross_section_m2(self, toward: Array) -> Array:
        """Return the cross sections (P,) in unit directions (P, 3) from the points to the radar."""
        section: Array = np.maximum(np.vecdot(self.facing_m2, toward), 0.0) + self.constant_m2
        return section


NO_POINTS = ScatterPoints(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0), np.empty(0))


def mesh_points(mesh: Mesh, spacing_m: float, afloat: bool = False, water_down_m: float = math.inf) -> ScatterPoints:
    """Return points on the triangles of a mesh, in its axes: the middles of parts with edges up to spacing_m.

    A larger triangle is halved at the middle of its longest edge, again and again. Parts that are wholly below
    water_down_m, in the same axes, are left out.
    """
    corners = mesh.vertices_m[mesh.faces]
    corners = corners[corners[:, :, 2].min(axis=1) < water_down_m]
    parts, widths = [np.empty((0, 3, 3))], [np.empty(0)]
    while len(corners):
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        longest, row = edges.argmax(axis=1), np.arange(len(corners))
        done = edges[row, longest] <= spacing_m
        parts.append(corners[done])
        widths.append(edges[row, longest][done])
        corners, longest, row = corners[~done], longest[~done], np.arange(np.count_nonzero(~done))
        start, end, apex = (corners[row, (longest + turn) % 3] for turn in range(3))
        middle = 0.5 * (start + end)
        corners = np.concatenate([np.stack([start, middle, apex], axis=1), np.stack([middle, end, apex], axis=1)])
        corners = corners[corners[:, :, 2].min(axis=1) < water_down_m]
    triangles = np.concatenate(parts)
    normal = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    none, floating = np.zeros(len(triangles)), np.full(len(triangles), float(afloat))
    return ScatterPoints(
        triangles.mean(axis=1), normal * GAMMA[mesh.material], 0.5 * np.concatenate(widths), none, floating
    )


def vessel_points(mesh: Mesh, spacing_m: float) -> ScatterPoints:
    """Return the points of a hull. Their mean cross section over all headings is `vessel_section_m2` of its length.

    The aspect changes the cross section by the projected area. The mean of max(cos, 0) over all aspects is 1 / pi.
    """
    points = mesh_points(mesh, spacing_m, afloat=True)
    upper = points.above(0.0)
    upper = upper if len(upper) else points
    length_m = float(np.ptp(mesh.vertices_m[:, 0]))
    mean_m2 = float(np.hypot(upper.facing_m2[:, 0], upper.facing_m2[:, 1]).sum()) / math.pi
    return replace(upper, facing_m2=upper.facing_m2 * (float(vessel_section_m2(length_m)) / max(mean_m2, 1e-12)))


def reflector_points(place_ned_m: Array, section_m2: Array) -> ScatterPoints:
    """Return points (P, 3) with constant cross sections (P,)."""
    count = len(section_m2)
    return ScatterPoints(place_ned_m, np.zeros((count, 3)), np.zeros(count), section_m2, np.ones(count))
