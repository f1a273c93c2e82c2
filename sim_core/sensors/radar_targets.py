"""Objects as a radar at X band sees them: scattering points with their cross sections, and what hides them.

    points = mesh_points(mesh, spacing_m)

Rough surfaces follow the constant-gamma law: sigma = gamma A cos(incidence), because sigma0 = gamma sin(grazing).
Gammas at 10 GHz are Barton's (Radar Equations for Modern Radar, 2013: woods and fields -15 dB, wooded hills -10 dB,
rugged mountains and towns 0 dB). Gammas of wood, plastic and hides are chosen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

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

    def __len__(self) -> int:
        return len(self.place_m)

    @classmethod
    def joined(cls, parts: list[ScatterPoints]) -> ScatterPoints:
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
        return replace(self, place_m=place, facing_m2=self.facing_m2 @ rot_ned_body.T)

    def above(self, water_down_m: float) -> ScatterPoints:
        """Return the points above the water."""
        dry = self.place_m[:, 2] < water_down_m
        return ScatterPoints(
            self.place_m[dry], self.facing_m2[dry], self.half_m[dry], self.constant_m2[dry], self.in_water[dry]
        )

    def cross_section_m2(self, toward: Array) -> Array:
        """Return the cross sections (P,) in unit directions (P, 3) from the points to the radar."""
        section: Array = np.maximum(np.vecdot(self.facing_m2, toward), 0.0) + self.constant_m2
        return section


NO_POINTS = ScatterPoints(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0), np.empty(0))


def mesh_points(mesh: Mesh, spacing_m: float, afloat: bool = False) -> ScatterPoints:
    """Return points on the triangles of a mesh, in its axes, at most spacing_m apart.

    A triangle with a longest edge of k spacings is divided into k² similar triangles, each with a point in its middle.
    """
    corners = mesh.vertices_m[mesh.faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(np.ceil(edges / spacing_m), 1).astype(int)
    places, facings, halves = [], [], []
    for count in np.unique(parts).tolist():
        some = corners[parts == count]
        middles = _middles(count)
        normal = 0.5 * np.cross(some[:, 1] - some[:, 0], some[:, 2] - some[:, 0]) / count**2
        places.append(np.einsum("kc,tcx->tkx", middles, some).reshape(-1, 3))
        facings.append(np.repeat(normal, len(middles), axis=0))
        halves.append(np.repeat(0.5 * edges[parts == count] / count, len(middles)))
    if not places:
        return NO_POINTS
    place = np.concatenate(places)
    facing = np.concatenate(facings) * GAMMA[mesh.material]
    return ScatterPoints(
        place, facing, np.concatenate(halves), np.zeros(len(place)), np.full(len(place), float(afloat))
    )


def _middles(count: int) -> Array:
    """Return the (count², 3) weights of the corners for the middles of a triangle's similar parts."""
    rows = []
    for i in range(count):
        for j in range(count - i):
            rows.append((i + 1 / 3, j + 1 / 3))
            if i + j < count - 1:
                rows.append((i + 2 / 3, j + 2 / 3))
    weights = np.array(rows) / count
    return np.column_stack([1.0 - weights.sum(axis=1), weights])


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
