"""The visible shape of a vessel, from the keys of its profile: hulls, deck, superstructure, propellers and rudders.

Recordings, views, pictures, Foxglove and cameras draw these parts. All meshes are in the axes of the vessel, FRD.

A profile gives the sections of a hull, and their widths along its length. The lines between them are chosen as boats
have them: a raked bow with sheer and flare, and a forefoot that rises. The hulls keep the length and the width of the
profile. The parts above the deck are chosen too, because a profile does not describe them: a platform on several hulls,
the deckhouses and hatches of a ship on a slender single hull, and a cabin on any other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy import int32

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.frames import Array
from sim_core.vessel.floating import floating_pose
from sim_core.vessel.sections import hull_shape, visual_shape
from sim_core.vessel.spec import DemiHull, Propeller, Rudder, VesselSpec
from sim_core.world.geometry import STEEL, UPRIGHT, Mesh, box, cylinder, merged, moved, prism, revolved, sphere

SHIP_SLENDERNESS = 3.8
"""Length over width from which a single hull is drawn as a ship."""
_FULL_FORM = 0.75
"""Mean share of the width from which a ship is drawn as a tanker."""
_STATIONS, _ROWS = 21, 7
_LARGEST_DETAIL_M = 8.0
"""Length of the vessel beyond which its fittings grow no more."""
MOST_DRAWN = 300_000
"""Triangles of one mesh. More would be most of any recording and too slow for a viewer."""


@dataclass(frozen=True, slots=True, eq=False)
class VesselPart:
    """Triangles of one paint, a key of `PAINTS`, in the axes of the vessel."""

    paint: str
    mesh: Mesh


def vessel_parts(vehicle: VesselSpec, water: Water) -> tuple[VesselPart, ...]:
    """Return everything but the propellers, see `propeller_mesh`. water: sets the waterline, down to which hulls have
    their bottom paint.

    Raises SpecificationError for a vessel that cannot float, or a mesh of the user that cannot be drawn.
    """
    if vehicle.visual is not None:
        shape = visual_shape(vehicle.visual, vehicle.length_m)
        return (VesselPart("hull", _as_mesh(shape.vertices_m, shape.faces)),)
    waterline_m = -floating_pose(vehicle, water).depth_m
    parts: list[VesselPart] = []
    for hull in vehicle.demi_hulls:
        parts += hull_parts(hull, waterline_m, len(vehicle.demi_hulls) > 1)
    parts += _Fittings(vehicle).parts()
    return tuple(parts)


def propeller_mesh(diameter_m: float, blades: int = 3) -> Mesh:
    """Return a propeller that turns about x: a hub along x, and blades at an angle to the flow."""
    radius = 0.5 * diameter_m
    outline = np.array([-0.15, -0.15, 0.05, 0.15]) * diameter_m, np.array([0.0, 0.11, 0.11, 0.0]) * diameter_m
    pieces = [revolved(*outline, STEEL, 12)]
    reach = np.linspace(0.1, 1.0, 6) * radius
    chord = np.array([0.14, 0.30, 0.37, 0.36, 0.28, 0.1]) * radius
    pitch = np.radians([60.0, 46.0, 37.0, 30.0, 25.0, 22.0])
    edges = [
        np.column_stack([sign * 0.5 * chord * np.sin(pitch), sign * 0.5 * chord * np.cos(pitch), -reach])
        for sign in (-1.0, 1.0)
    ]
    here, count = np.arange(len(reach) - 1), len(reach)
    face = np.concatenate(
        [np.stack([here, here + count, here + 1], -1), np.stack([here + 1, here + count, here + count + 1], -1)]
    )
    blade = Mesh(
        np.concatenate([*edges, *edges]), np.concatenate([face, face[:, ::-1] + 2 * count]).astype(int32), STEEL
    )
    pieces += [moved(blade, np.zeros(3), _about_ahead(2.0 * math.pi * number / blades)) for number in range(blades)]
    return merged(pieces)


def drawn_diameter_m(propeller: Propeller, length_m: float) -> float:
    """Return the diameter of a propeller; without one in the profile, a visible one for a vessel of this length."""
    curve = propeller.open_water
    known = curve.diameter_m if curve is not None else propeller.diameter_m
    return known or (0.25 if propeller.medium == "air" else 0.06) * length_m


def heading_of(propeller: Propeller) -> Array:
    """Return the (3, 3) rotation from the axes of `propeller_mesh` to those of the vessel."""
    angle = math.radians(propeller.angle_deg)
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _about_ahead(angle_rad: float) -> Array:
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])


def _as_mesh(vertices_m: Array, faces: object) -> Mesh:
    return Mesh(np.asarray(vertices_m), np.asarray(faces, dtype=int32), STEEL)


# Hulls


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """Lines of a hull at stations from stern to bow, each (S,): z down in body axes."""

    ahead_m: Array
    share: Array
    """Share of the section's width."""
    keel_m: Array
    deck_m: Array


def _lines(hull: DemiHull, several: bool) -> _Lines:
    place = 0.5 * np.sin(np.linspace(-0.5 * math.pi, 0.5 * math.pi, _STATIONS))  # closer at the ends
    places, shares = np.array(hull.taper).T
    if hull.prismatic:  # the ends of a hull that the profile gives none
        bow = np.clip((place - 0.22) / 0.28, 0.0, 1.0)
        stern = np.clip((-0.42 - place) / 0.08, 0.0, 1.0)
        share = np.sqrt(np.maximum(1.0 - bow**2.2, 0.0)) * (1.0 - 0.2 * stern)
        share = np.maximum(share, 0.04)
    else:
        wide = 0.06  # rounds the corners of the given widths
        share = np.mean([np.interp(place + shift, places, shares) for shift in np.linspace(-wide, wide, 7)], axis=0)
        share = np.where(np.abs(place) > 0.5 - wide, np.interp(place, places, shares), share)
        share *= max(shares) / share.max()
    depth_m, keel_m = hull.height_m, hull.keel_frd_m[2]
    rise = np.clip((place - 0.3) / 0.2, 0.0, 1.0) ** 2  # the forefoot
    run = np.clip((-0.3 - place) / 0.2, 0.0, 1.0) ** 2  # below the stern
    sheer = np.clip((place + 0.1) / 0.6, 0.0, 1.0) ** 2
    forefoot, counter, spring = (0.55, 0.22, 0.12) if several else (0.3, 0.3, 0.22)
    round_hull = hull.section is not None and hull.section.radius_m is not None
    spring = 0.35 if round_hull else spring
    keel = keel_m - depth_m * (forefoot * rise + counter * run + (spring * sheer**2 if round_hull else 0.0))
    deck = keel_m - depth_m * (1.0 + spring * (sheer**2 if round_hull else sheer))
    if round_hull:  # a tube that narrows to its raised nose
        middle = 0.5 * (keel + deck)
        half_m = 0.5 * depth_m * np.maximum(share, 0.04)
        tube = np.clip((place - 0.22) / 0.28, 0.0, 1.0)
        keel = np.where(tube > 0, middle + half_m, keel)
        deck = np.where(tube > 0, middle - half_m, deck)
    return _Lines(hull.keel_frd_m[0] + place * hull.length_m, share, keel, deck)


def _half_breadth_m(hull: DemiHull, height: Array) -> Array:
    """Return the half widths of the section at heights above the keel, as shares of the height of the deck."""
    section = hull.section
    assert section is not None
    if section.radius_m is not None:
        return section.radius_m * 2.0 * np.sqrt(np.clip(height * (1.0 - height), 0.0, 0.25))
    if section.offsets_m is not None:
        up_m, half_m = np.array(section.offsets_m).T
        return np.asarray(np.interp(height * hull.height_m, up_m, half_m))
    half, bilge = 0.5 * section.greatest_width_m, 0.16  # the bilge of a box is rounded
    low = np.clip(1.0 - height / bilge, 0.0, 1.0)
    return half * (1.0 - bilge * (1.0 - np.sqrt(1.0 - low**2)) * 1.6)


def hull_parts(hull: DemiHull, waterline_m: float, several: bool) -> Iterator[VesselPart]:
    """Yield bottom, topsides and deck of a hull. A mesh of the user is drawn as it is; one too large, by its box.

    waterline_m: z of the water in body axes. several: the vessel has more hulls.
    """
    if hull.mesh is not None:
        shape = hull_shape(hull)
        if len(shape.faces) > MOST_DRAWN:
            ahead, right, down = hull.keel_frd_m
            size = (hull.length_m, hull.width_m, hull.height_m)
            yield VesselPart("hull", moved(box(size, STEEL), (ahead, right, down - 0.5 * hull.height_m)))
        else:
            yield VesselPart("hull", _as_mesh(shape.vertices_m, shape.faces))
        return
    lines = _lines(hull, several)
    water_m = np.clip(waterline_m, lines.deck_m, lines.keel_m)
    ship = not several and hull.length_m >= SHIP_SLENDERNESS * hull.width_m
    bottom = _plating(hull, lines, lines.keel_m, water_m, keel=True, flare=ship)
    topsides = _plating(hull, lines, water_m, lines.deck_m, keel=False, flare=ship)
    yield VesselPart("bottom" if ship else "metal", bottom)
    yield VesselPart("topsides" if ship else "hull", topsides)
    deck = _deck(hull, lines, flare=ship)
    if len(deck.faces):  # the top of a round hull is a line
        yield VesselPart("deck", deck)


def _breadths(hull: DemiHull, lines: _Lines, down_m: Array, flare: bool) -> Array:
    """Return half widths (S, ...) at z `down_m` (S, ...). flare: the ends are finer below than at the deck."""
    keel, deck, share = (part[:, None] for part in (lines.keel_m, lines.deck_m, lines.share))
    height = np.clip((keel - down_m) / np.maximum(keel - deck, 1e-9), 0.0, 1.0)
    fine = 1.0 + 1.1 * (1.0 - height) if flare else 1.0
    return np.asarray(_half_breadth_m(hull, height) * share**fine)


def _plating(hull: DemiHull, lines: _Lines, low_m: Array, high_m: Array, *, keel: bool, flare: bool) -> Mesh:
    """Return both sides between two lines of z (S,), with the flat ends of the hull. keel: with the floor."""
    turn = 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, _ROWS))  # closer at keel and deck
    down = low_m[:, None] + (high_m - low_m)[:, None] * turn  # (S, R), from the keel up
    half = _breadths(hull, lines, down, flare)
    # Columns go from the port edge down to the keel and up to the starboard edge
    y = hull.keel_frd_m[1] + np.concatenate([-half[:, ::-1], half], axis=1)
    z = np.concatenate([down[:, ::-1], down], axis=1)
    x = np.broadcast_to(lines.ahead_m[:, None], y.shape)
    vertices = np.stack([x, y, z], axis=-1)
    count, columns = y.shape
    corner = np.arange(count * columns).reshape(count, columns)
    sides = np.arange(columns - 1)
    if not keel:  # no floor between the two sides
        sides = np.delete(sides, _ROWS - 1)
    here, ahead = corner[:-1, sides], corner[1:, sides]
    beside, across = corner[:-1, sides + 1], corner[1:, sides + 1]
    faces = [np.stack([here, ahead, across], -1).reshape(-1, 3), np.stack([here, across, beside], -1).reshape(-1, 3)]
    for end, order in ((corner[0], 1), (corner[-1], -1)):
        port, starboard = end[:_ROWS][::-1], end[_ROWS:]
        cap = np.concatenate(
            [
                np.stack([port[:-1], starboard[:-1], starboard[1:]], -1),
                np.stack([port[:-1], starboard[1:], port[1:]], -1),
            ]
        )
        faces.append(cap[:, ::order])
    return _without_slivers(vertices.reshape(-1, 3), np.concatenate(faces))


def _deck(hull: DemiHull, lines: _Lines, flare: bool) -> Mesh:
    half = _breadths(hull, lines, lines.deck_m[:, None], flare)[:, 0]
    y = hull.keel_frd_m[1] + np.stack([-half, half], -1)
    vertices = np.stack(
        [np.repeat(lines.ahead_m[:, None], 2, 1), y, np.repeat(lines.deck_m[:, None], 2, 1)], axis=-1
    ).reshape(-1, 3)
    port = 2 * np.arange(len(half) - 1)
    faces = np.concatenate([np.stack([port, port + 1, port + 3], -1), np.stack([port, port + 3, port + 2], -1)])
    return _without_slivers(vertices, faces)


def _without_slivers(vertices_m: Array, faces: Array) -> Mesh:
    """Return the mesh without triangles that have no area."""
    a, b, c = (vertices_m[faces[:, corner]] for corner in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    used, number = np.unique(faces[area > 1e-9 * max(area.max(initial=0.0), 1e-12)], return_inverse=True)
    return _as_mesh(vertices_m[used], number.reshape(-1, 3))


# Fittings


class _Fittings:
    """Parts other than the hulls."""

    def __init__(self, vehicle: VesselSpec) -> None:
        self._vehicle = vehicle
        self._hulls = vehicle.demi_hulls
        self._length_m, self._width_m = vehicle.length_m, vehicle.width_m
        self._midship_m = vehicle.midship_frd_x_m
        self._top_m = max(hull.keel_frd_m[2] - hull.height_m for hull in self._hulls)
        """z of the lowest deck."""
        self._size_m = min(self._length_m, _LARGEST_DETAIL_M)
        self._parts: list[VesselPart] = []

    def parts(self) -> list[VesselPart]:
        if len(self._hulls) > 1:
            self._platform()
        elif self._length_m >= SHIP_SLENDERNESS * self._width_m:
            self._ship()
        else:
            self._cabin()
        for propeller in self._vehicle.propellers:
            self._thruster(propeller)
        for rudder in self._vehicle.rudders:
            self._add("rudder", _blade(rudder))
        return self._parts

    def _add(self, paint: str, mesh: Mesh) -> None:
        self._parts.append(VesselPart(paint, mesh))

    def _box(self, paint: str, size: tuple[float, float, float], ahead: float, right: float, bottom: float) -> float:
        """Add a box with its bottom at z `bottom`. Return z of its top."""
        self._add(paint, moved(box(size, STEEL), (ahead, right, bottom - 0.5 * size[2])))
        return bottom - size[2]

    def _post(self, paint: str, radius: float, height: float, ahead: float, right: float, bottom: float) -> float:
        post = cylinder(radius, height, STEEL, 10)
        self._add(paint, moved(post, (ahead, right, bottom - 0.5 * height), UPRIGHT))
        return bottom - height

    def _mast(self, height: float, ahead: float, bottom: float) -> None:
        """Add a mast with an antenna and a white light all round, as COLREG 23 asks of a small vessel."""
        size = self._size_m
        top = self._post("metal", 0.008 * size, height, ahead, 0.0, bottom)
        yard = moved(cylinder(0.005 * size, 0.2 * size, STEEL, 8), (ahead, 0.0, bottom - 0.8 * height), _ACROSS)
        self._add("metal", yard)
        for side in (-1.0, 1.0):
            place = (ahead, side * 0.1 * size, bottom - 0.8 * height - 0.01 * size)
            self._add(
                "house", moved(revolved(_DOME[0] * 0.03 * size, _DOME[1] * 0.03 * size, STEEL, 14), place, UPRIGHT)
            )
        self._lamp("white light", ahead, 0.0, top - 0.016 * size)

    def _lamp(self, paint: str, ahead: float, right: float, down: float) -> None:
        self._add(paint, moved(sphere(0.012 * self._size_m, STEEL, 10, 6), (ahead, right, down)))

    def _sidelights(self, ahead: float, half: float, down: float) -> None:
        self._lamp("red light", ahead, -half, down)
        self._lamp("green light", ahead, half, down)

    def _platform(self) -> None:
        """Add cross-beams and a platform on several hulls, with the case of the electronics and a mast."""
        size, length = self._size_m, self._length_m
        sides = [hull.keel_frd_m[1] for hull in self._hulls]
        wide, middle = max(sides) - min(sides), 0.5 * (max(sides) + min(sides))
        beam = 0.016 * size
        level = self._top_m - beam
        for share in (-0.26, 0.2):
            ahead = self._midship_m + share * length
            self._add("metal", moved(cylinder(beam, wide, STEEL, 12), (ahead, middle, level), _ACROSS))
            for side in sides:  # saddles on the hulls
                self._box("metal", (0.09 * length, 0.05 * size, 3.0 * beam), ahead, side, self._top_m + 0.6 * beam)
        plate = (0.5 * length, 0.72 * wide, 0.012 * size)
        ahead = self._midship_m - 0.03 * length
        top = self._box("deck", plate, ahead, middle, level - beam)
        for side in (-1.0, 1.0):
            rail = moved(cylinder(0.6 * beam, plate[0], STEEL, 10), (ahead, middle + side * 0.5 * plate[1], top))
            self._add("metal", rail)
        case = (0.24 * length, 0.4 * plate[1], 0.085 * size)
        front = ahead + 0.04 * length
        lid = self._box("case", case, front, middle, top)
        self._box("metal", (0.94 * case[0], 0.94 * case[1], 0.008 * size), front, middle, lid)
        mast = front - 0.36 * case[0]
        self._mast(0.3 * size, mast, lid)
        puck = self._post("metal", 0.008 * size, 0.07 * size, front + 0.3 * case[0], middle, lid)
        self._post("glass", 0.026 * size, 0.035 * size, front + 0.3 * case[0], middle, puck)  # lidar or camera
        self._sidelights(front + 0.5 * case[0], 0.5 * case[1], lid)

    def _cabin(self) -> None:
        """Add the cabin of a launch, with windows."""
        length, wide = self._length_m, self._width_m
        ahead, size = self._midship_m + 0.02 * length, self._size_m
        house = (0.3 * length, 0.62 * wide, 0.09 * size)
        top = self._box("house", house, ahead, 0.0, self._top_m)
        glass = self._box("glass", (0.26 * length, 0.56 * wide, 0.06 * size), ahead - 0.01 * length, 0.0, top)
        roof = self._box("house", (0.29 * length, 0.62 * wide, 0.012 * size), ahead - 0.01 * length, 0.0, glass)
        self._mast(0.2 * size, ahead - 0.08 * length, roof)
        self._sidelights(ahead + 0.14 * length, 0.31 * wide, roof)

    def _ship(self) -> None:
        """Add deckhouse, funnel, masts, and hatches or the pipes of a tanker.

        The deckhouse is forward if a thruster pushes sideways in the fore part, as on supply ships, and aft otherwise.
        """
        length, wide, hull = self._length_m, self._width_m, self._hulls[0]
        supply = any(
            abs(math.sin(math.radians(one.angle_deg))) > 0.5 and one.position_frd_m[0] > self._midship_m
            for one in self._vehicle.propellers
        )
        storey = 0.0185 * length if length > 60.0 else 0.026 * length
        ahead = self._midship_m + (0.22 if supply else -0.36) * length
        top = self._top_m + 0.01 * hull.height_m
        storeys = 4 if supply or length < 200.0 else 5
        for floor in range(storeys):
            narrower = 1.0 - 0.05 * floor
            size = (0.13 * length * narrower, 0.86 * wide * narrower, storey)
            front = ahead - 0.004 * length * floor
            band = moved(
                box((size[0] * 1.004, size[1] * 1.004, 0.32 * storey), STEEL), (front, 0.0, top - 0.6 * storey)
            )
            top = self._box("house", size, front, 0.0, top)
            self._add("glass", band)
        bridge = (0.075 * length, 0.98 * wide, 0.8 * storey)
        front = ahead + 0.02 * length
        pane = moved(box((bridge[0] * 1.01, bridge[1] * 1.002, 0.4 * storey), STEEL), (front, 0.0, top - 0.45 * storey))
        self._add("glass", pane)
        top = self._box("house", bridge, front, 0.0, top)
        self._mast_of_ship(front, top, 0.07 * length)
        self._sidelights(front, 0.49 * wide, top)
        funnel = ahead - 0.06 * length
        self._box("case", (0.035 * length, 0.2 * wide, 1.5 * storey), funnel, 0.0, top + 0.9 * storey)
        self._box("metal", (0.036 * length, 0.21 * wide, 0.4 * storey), funnel, 0.0, top - 0.6 * storey)
        fore = self._midship_m + 0.42 * length
        # The sheer lifts the deck forward
        self._mast_of_ship(fore, self._top_m - 0.12 * hull.height_m, 0.075 * length)
        if not supply:
            self._cargo(storey)

    def _mast_of_ship(self, ahead: float, bottom: float, height: float) -> None:
        top = self._post("house", 0.0035 * self._length_m, height, ahead, 0.0, bottom)
        yard = cylinder(0.0018 * self._length_m, 0.35 * height, STEEL, 8)
        self._add("house", moved(yard, (ahead, 0.0, bottom - 0.75 * height), _ACROSS))
        radius = 0.006 * self._length_m
        self._add("white light", moved(sphere(radius, STEEL, 8, 4), (ahead, 0.0, top - radius)))

    def _cargo(self, storey: float) -> None:
        length, wide, hull = self._length_m, self._width_m, self._hulls[0]
        places, shares = np.array(hull.taper).T
        if float(np.trapezoid(shares, places)) > _FULL_FORM:  # a tanker: pipes along the middle, manifolds across
            for side in (-0.05, -0.02, 0.02, 0.05):
                pipe = cylinder(0.004 * length, 0.6 * length, STEEL, 8)
                place = (self._midship_m + 0.05 * length, side * wide, self._top_m - 0.012 * length)
                self._add("rudder", moved(pipe, place))
            for share in (-0.12, 0.08, 0.26):
                rack = cylinder(0.004 * length, 0.7 * wide, STEEL, 8)
                place = (self._midship_m + share * length, 0.0, self._top_m - 0.014 * length)
                self._add("case", moved(rack, place, _ACROSS))
            return
        for number in range(5):
            ahead = self._midship_m + (-0.2 + 0.125 * number) * length
            lift = 0.22 * hull.height_m * max((ahead - self._midship_m) / length + 0.1, 0.0) ** 2 / 0.36
            deck = self._top_m - lift
            self._box("case", (0.085 * length, 0.5 * wide * (1.0 - 0.07 * number), 0.3 * storey), ahead, 0.0, deck)
            if number % 2 == 0:
                for side in (-0.1, 0.1):
                    self._post("house", 0.0035 * length, 0.07 * length, ahead + 0.055 * length, side * wide, deck)

    def _thruster(self, propeller: Propeller) -> None:
        ahead, right, down = propeller.position_frd_m
        radius = 0.5 * drawn_diameter_m(propeller, self._length_m)
        turn = heading_of(propeller)
        if propeller.medium == "air":
            guard = merged([_ring(1.04 * radius, 0.98 * radius, 0.10 * radius), *_spokes(radius)])
            self._add("metal", moved(guard, (ahead, right, down), turn))
            motor = cylinder(0.1 * radius, 0.4 * radius, STEEL, 12)
            self._add("case", moved(motor, np.array([ahead, right, down]) + turn @ [0.2 * radius, 0.0, 0.0], turn))
            stand = max(self._top_m - down, 0.0)
            for side in (-0.35, 0.35):
                leg = (0.07 * radius, 0.07 * radius, stand)
                self._box("metal", leg, ahead, right + side * radius, self._top_m)
            return
        if self._length_m > _LARGEST_DETAIL_M or propeller.tunnel_speed_mps or abs(propeller.angle_deg) > 45.0:
            return  # the shaft of a ship and a tunnel are inside the hull
        if len(self._hulls) == 1 and self._vehicle.rudders:
            return  # a shaft
        self._pod(ahead, right, down, radius, turn)

    def _pod(self, ahead: float, right: float, down: float, radius: float, turn: Array) -> None:
        """Add the motor of a thruster on its strut, which ends in the hull above it or at a bracket at the stern."""
        outline = np.array([-0.2, -0.15, 0.9, 1.6, 1.9]) * radius, np.array([0.0, 0.24, 0.34, 0.26, 0.0]) * radius
        self._add("metal", moved(revolved(*outline, STEEL, 14), (ahead, right, down), turn))
        self._add("metal", moved(_ring(1.12 * radius, 1.04 * radius, 0.3 * radius), (ahead, right, down), turn))
        middle = ahead + 0.8 * radius
        above = [
            hull
            for hull in self._hulls
            if abs(right - hull.keel_frd_m[1]) < 0.5 * hull.width_m
            and abs(middle - hull.keel_frd_m[0]) < 0.48 * hull.length_m
        ]
        end = max(hull.keel_frd_m[2] - 0.6 * hull.height_m for hull in above) if above else self._top_m
        if down - end > 0.0:
            self._box("metal", (0.7 * radius, 0.2 * radius, down - end), middle, right, down)
        if not above:  # a bracket that holds it
            self._box("metal", (1.6 * radius, 0.6 * radius, 0.5 * radius), middle, right, end)


_ACROSS = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Turns a shape along x to lie across the vessel."""
_DOME = np.array([[-0.4, -0.4, 0.3, 0.4], [0.0, 1.0, 0.8, 0.0]])


def _blade(rudder: Rudder) -> Mesh:
    """Return a rudder with the outline of a symmetric foil, its stock at 30 % of the chord."""
    chord = math.sqrt(rudder.area_m2 / rudder.aspect_ratio)
    half = np.array([0.0, 0.045, 0.06, 0.05, 0.025]) * chord
    back = (0.3 - np.array([0.0, 0.08, 0.3, 0.6, 0.85])) * chord
    plan = [*zip(back, half, strict=True), (-0.7 * chord, 0.0), *zip(back[:0:-1], -half[:0:-1], strict=True)]
    height = rudder.aspect_ratio * chord
    return moved(prism(np.array(plan)[::-1], -0.5 * height, 0.5 * height, STEEL), rudder.position_frd_m)


def _spokes(radius: float) -> Iterator[Mesh]:
    """Yield the bars of a guard behind the disc."""
    for angle in (0.25 * math.pi, -0.25 * math.pi):
        bar = box((0.03 * radius, 0.03 * radius, 2.0 * radius), STEEL)
        yield moved(moved(bar, (-0.14 * radius, 0.0, 0.0)), np.zeros(3), _about_ahead(angle))


def _ring(outer_m: float, inner_m: float, half_m: float, sides: int = 24) -> Mesh:
    """Return a ring about x between two radii, from -half_m to half_m."""
    turn = 2.0 * math.pi * np.arange(sides) / sides
    rings = [
        np.column_stack([np.full(sides, x), radius * np.cos(turn), radius * np.sin(turn)])
        for x, radius in ((-half_m, inner_m), (-half_m, outer_m), (half_m, outer_m), (half_m, inner_m))
    ]
    here = np.arange(sides)
    following = (here + 1) % sides
    faces = []
    for ring in range(4):
        low, high = ring * sides, (ring + 1) % 4 * sides
        faces += [
            np.column_stack([low + here, low + following, high + here]),
            np.column_stack([low + following, high + following, high + here]),
        ]
    return _as_mesh(np.concatenate(rings), np.concatenate(faces))
