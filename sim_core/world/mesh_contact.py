"""Contact of hulls with triangles: rocks, trees and meshes of files, the same triangles that sensors see.

A hull is a row of spheres along its axis. Only the triangle with the deepest penetration presses on a sphere, away from
the contact point. The orientation of the triangles does not matter. Spring, damper and friction are those of `contact`,
shared by the touching spheres of a vessel. The centre of a sphere must not pass through. A stop therefore removes up to
`STOP_SHARE` of the closing speed in a step, more at a larger depth.

Triangles lie in cells of the plan. Cells and bounds limit the search for the triangles that a sphere may reach before
the next search. The cost of a step depends on the near triangles, not on their total number.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.world.contact import NO_CONTACTS, Contacts, Outline, pressed_n, velocity_at
from sim_core.world.geometry import Mesh
from sim_core.world.plan import Numbers, nearest_on_axis

CELL_M = 4.0
REACH_M = 0.25  # a hull moves less between two searches, 20 ms: 12 m/s
ABOUT_WATER_M = 5.0  # no hull gets farther above or below the water
STOP_FROM, STOP_SHARE = 0.3, 0.4  # share of the radius at which the stop begins; of the closing speed in a step
_MOST_CELLS = 4096  # cells of one triangle; a larger triangle is checked at any position
_NO_NUMBERS = np.empty(0, np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """T fixed triangles in NED."""

    corners_m: NDArray[float64]
    """Corners, (T, 3, 3)."""
    what: Numbers
    """Indices into `names`, (T,)."""
    names: tuple[str, ...]
    low_m: Array
    """Lower bounds, (T, 3)."""
    high_m: Array
    """Upper bounds, (T, 3)."""
    least_m: Array
    """Lower bound of all triangles, (3,)."""
    most_m: Array
    """Upper bound of all triangles, (3,)."""
    cells: dict[tuple[int, int], Numbers]
    """Indices of triangles by cell of the plan."""
    everywhere: Numbers
    """Indices of triangles that are too large for cells."""

    @classmethod
    def from_meshes(
        cls, meshes: Sequence[tuple[str, Mesh]], water_down_m: float, tide_m: tuple[float, float] = (0.0, 0.0)
    ) -> Triangles:
        """Select the triangles of named meshes that a hull in this water can reach.

        tide_m: lowest and highest level of the water above water_down_m.
        """
        lowest_down_m, highest_down_m = (water_down_m - height_m for height_m in tide_m)
        names = tuple(dict.fromkeys(name for name, _ in meshes))
        corners = np.concatenate([np.empty((0, 3, 3)), *(mesh.vertices_m[mesh.faces] for _, mesh in meshes)])
        what = np.repeat([names.index(name) for name, _ in meshes], [len(mesh.faces) for _, mesh in meshes])
        down = corners[:, :, 2]
        near = (down.min(axis=1) < lowest_down_m + ABOUT_WATER_M) & (down.max(axis=1) > highest_down_m - ABOUT_WATER_M)
        corners, what = corners[near], what[near].astype(np.intp)
        low, high = corners.min(axis=1), corners.max(axis=1)
        first = np.floor(low[:, :2] / CELL_M).astype(np.intp)
        counts = np.floor(high[:, :2] / CELL_M).astype(np.intp) - first + 1
        size = counts.prod(axis=1)
        large = size > _MOST_CELLS
        number = np.repeat(np.arange(len(corners)), np.where(large, 0, size))
        turn = np.arange(len(number)) - np.repeat(np.cumsum(np.where(large, 0, size)) - size * ~large, size * ~large)
        place = first[number] + np.column_stack([turn // counts[number, 1], turn % counts[number, 1]])
        order = np.lexsort((place[:, 1], place[:, 0]))
        number, place = number[order], place[order]
        edges = np.flatnonzero(np.any(np.diff(place, axis=0) != 0, axis=1)) + 1
        groups = np.split(number, edges) if len(number) else []
        keys = place[np.concatenate([[0], edges])].tolist() if len(number) else []
        cells = {(north, east): group for (north, east), group in zip(keys, groups, strict=True)}
        least, most = np.min(low, axis=0, initial=np.inf), np.max(high, axis=0, initial=-np.inf)
        return cls(corners, what, names, low, high, least, most, cells, np.flatnonzero(large))

    def __len__(self) -> int:
        return len(self.corners_m)

    def within(self, low_m: Array, high_m: Array) -> Numbers:
        """Return the triangles with bounds that overlap a box (3,) to (3,)."""
        (north0, east0), (north1, east1) = (
            np.floor(edge[:2] / CELL_M).astype(int).tolist() for edge in (low_m, high_m)
        )
        places = ((north, east) for north in range(north0, north1 + 1) for east in range(east0, east1 + 1))
        groups = [self.cells[place] for place in places if place in self.cells]
        if not groups and not len(self.everywhere):
            return _NO_NUMBERS
        numbers = np.unique(np.concatenate([self.everywhere, *groups]))
        meets = np.all((self.low_m[numbers] < high_m) & (self.high_m[numbers] > low_m), axis=1)
        chosen: Numbers = numbers[meets]
        return chosen


NO_TRIANGLES = Triangles.from_meshes((), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Reachable:
    """P pairs of a hull sphere and a triangle that it may touch before the next search."""

    sphere: Numbers
    """Indices of the spheres, numbered through all vessels, (P,)."""
    triangle: Numbers
    """Indices of the triangles, (P,)."""
    low_m: Array
    """Lower bounds of these triangles, (P, 3)."""
    high_m: Array
    """Upper bounds of these triangles, (P, 3)."""

    def __len__(self) -> int:
        return len(self.sphere)


OUT_OF_REACH = Reachable(_NO_NUMBERS, _NO_NUMBERS, np.empty((0, 3)), np.empty((0, 3)))


def find_reachable(triangles: Triangles, outline: Outline, motion: Kinematics) -> Reachable:
    """Return the pairs of all vessels within `REACH_M`."""
    if not len(triangles):
        return OUT_OF_REACH
    centres = _centres(outline, motion)
    reach_m = outline.sphere_radius_m[:, None] + REACH_M  # (S, 1)
    pairs = []
    low, high = (centres - reach_m).min(axis=1), (centres + reach_m).max(axis=1)
    for vessel in np.flatnonzero(np.all((high > triangles.least_m) & (low < triangles.most_m), axis=1)).tolist():
        near = triangles.within(low[vessel], high[vessel])
        if not len(near):
            continue
        over, under = (centres[vessel] + reach_m)[:, None], (centres[vessel] - reach_m)[:, None]
        meets = (triangles.low_m[near] < over) & (triangles.high_m[near] > under)
        sphere, which = np.nonzero(np.all(meets, axis=2))
        pairs.append((vessel * len(outline.spheres_frd_m) + sphere, near[which]))
    if not pairs:
        return OUT_OF_REACH
    sphere, triangle = (np.concatenate(column) for column in zip(*pairs, strict=True))
    return Reachable(sphere, triangle, triangles.low_m[triangle], triangles.high_m[triangle])


def compute_mesh_contacts(
    triangles: Triangles, outline: Outline, motion: Kinematics, reachable: Reachable, dt_s: float
) -> Contacts:
    """Return one contact for each sphere that touches."""
    # Pairs of sphere and triangle in touch
    count = len(outline.spheres_frd_m)
    centre = _centres(outline, motion).reshape(-1, 3)[reachable.sphere]
    radius_m = outline.sphere_radius_m[reachable.sphere % count]
    reach = radius_m**2
    # The distance to the bounds of a triangle is at most the distance to the triangle.
    short = np.maximum(reachable.low_m - centre, 0.0) + np.maximum(centre - reachable.high_m, 0.0)
    close = np.flatnonzero(np.vecdot(short, short) < reach)
    if not len(close):
        return NO_CONTACTS
    sphere, triangle, centre = reachable.sphere[close], reachable.triangle[close], centre[close]
    radius_m = radius_m[close]
    place = nearest_on_triangles(centre, triangles.corners_m[triangle])
    between = centre - place
    square = np.vecdot(between, between)
    touch = np.flatnonzero(square < reach[close])
    if not len(touch):
        return NO_CONTACTS
    # The deepest contact of each sphere
    touch = touch[np.lexsort((square[touch], sphere[touch]))]
    touch = touch[np.unique(sphere[touch], return_index=True)[1]]
    # Spring, damper and friction, away from the contact point
    vessel = sphere[touch] // count
    distance, place, radius_m = np.sqrt(square[touch]), place[touch], radius_m[touch]
    inward = motion.pos_ned_m[vessel] - place  # for a centre inside the triangle's plane
    away = np.where((distance > 1e-9)[:, None], between[touch], inward)
    normal = away / np.maximum(np.sqrt(np.vecdot(away, away)), 1e-12)[:, None]
    depth = radius_m - distance
    velocity = velocity_at(motion, vessel, place)
    share_kg = outline.mass_kg / np.bincount(vessel)[vessel]
    force = pressed_n(normal, depth, velocity, share_kg, dt_s)
    # The stop, which removes a share of the closing speed
    closing = -np.vecdot(velocity, normal)
    stop = np.clip((depth / radius_m - STOP_FROM) / (1.0 - STOP_FROM), 0.0, 1.0) ** 0.5 * STOP_SHARE
    lacking = np.maximum(stop * share_kg * closing / dt_s - np.vecdot(force, normal), 0.0)
    force = force + lacking[:, None] * normal
    what = tuple(triangles.names[number] for number in triangles.what[triangle[touch]].tolist())
    return Contacts(vessel, what, place, force, closing, np.sqrt(np.vecdot(force, force)) * dt_s)


def nearest_on_triangles(points: Array, corners: Array) -> Array:
    """Return the (P, 3) positions on triangles (P, 3, 3) nearest to (P, 3) points."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    best, _ = nearest_on_axis(points, a, b)
    least = np.vecdot(points - best, points - best)
    for start, end in ((b, c), (c, a)):
        place, _ = nearest_on_axis(points, start, end)
        square = np.vecdot(points - place, points - place)
        best = np.where((square < least)[:, None], place, best)
        least = np.minimum(square, least)
    # Above the interior, the projection on the plane is nearer than any edge: no barycentric coordinate is negative.
    ab, ac, ap = b - a, c - a, points - a
    ab2, ac2, both = np.vecdot(ab, ab), np.vecdot(ac, ac), np.vecdot(ab, ac)
    to_ab, to_ac = np.vecdot(ap, ab), np.vecdot(ap, ac)
    area = ab2 * ac2 - both * both
    safe = np.where(area > 0.0, area, 1.0)
    v, w = (ac2 * to_ab - both * to_ac) / safe, (ab2 * to_ac - both * to_ab) / safe
    inside = (area > 0.0) & (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0)
    nearest: Array = np.where(inside[:, None], a + v[:, None] * ab + w[:, None] * ac, best)
    return nearest


def _centres(outline: Outline, motion: Kinematics) -> Array:
    """Return the (N, S, 3) centres of the spheres."""
    centres: Array = (motion.rot_ned_frd @ outline.spheres_frd_m.T).transpose(0, 2, 1) + motion.pos_ned_m[:, None]
    return centres
