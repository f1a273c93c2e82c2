"""Specification of obstacles and traffic in the river: boom, dam, bed and banks, scripted vessels."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from sim_core.dataclass import dataclass
from sim_core.keys import (
    Bounds,
    Direction,
    Items,
    NonNegative,
    Place,
    Positive,
    Seed,
    Size,
    Specification,
    SpecificationError,
    ValueProblem,
    Vector,
)

MaterialName = Literal[
    "concrete", "steel", "plastic", "wood", "leaves", "hide", "earth", "rock", "wall", "bed"
]  # fmt: skip
DebrisName = Literal["trunk", "branch", "plants", "animal", "plank", "plastic"]
"""Kinds of drifting bodies."""
BuoyShape = Literal["can", "cone", "sphere", "pillar", "spar"]
BuoyColour = Literal[
    "red", "green", "yellow", "orange", "white", "black", "blue", "port-a", "starboard-a", "port-b", "starboard-b",
    "north", "east", "south", "west", "isolated-danger", "safe-water", "special", "wreck",
]  # fmt: skip
"""Plain colours, and marks of the IALA maritime buoyage system (R1001) with their regions A and B."""
NEAREST_TREE_M = 4.0
"""Least distance of a tree from the waterline."""
AIS_NAME = 20  # characters
LAST_MMSI = 999_999_999
FLEET_MMSI, SCRIPTED_MMSI = 200_000_000, 200_001_000
"""Added to system ids and to the numbers of scripted vessels. ITU has assigned 200 to no country."""


def _ais_text(most: int) -> ValueProblem:
    """Check text of up to `most` characters of six-bit ASCII (ITU-R M.1371). AIS sends lower case as capitals."""

    def problem(value: object) -> str | None:
        if not isinstance(value, str):
            return "is not text; put it in quotes"
        if len(value) > most:
            return f"is too long for AIS; use at most {most} characters"
        if not all(" " <= letter <= "_" and letter != "@" for letter in value.upper()):
            return "has characters that AIS does not have; use letters, digits, blanks and punctuation of ASCII"
        return None

    return ValueProblem(problem)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogBoomSpec(Specification):
    """A floating line of cylinders, either along points or between anchors at the level of the water."""

    points_ned_m: Annotated[
        Annotated[tuple[Vector, ...], Items(2)] | None, "points of a line with straight segments"
    ] = None
    anchors_ne_m: Annotated[
        Annotated[tuple[Place, ...], Items(2)] | None, "instead: anchors of a line at the water's level"
    ] = None
    sag_m: Annotated[NonNegative, "sag between two anchors, to the right of the direction along the line"] = 0.0
    float_length_m: Positive
    float_radius_m: Positive
    pile_radius_m: Annotated[NonNegative, "radius of a pile at each anchor, from the bed up; 0: no piles"] = 0.0
    pile_height_m: Annotated[Positive, "height of the piles above the water"] = 3.0

    def check(self) -> None:
        if self.points_ned_m is None and self.anchors_ne_m is None:
            raise SpecificationError((), "has no position; give anchors_ne_m (or points_ned_m)")
        if self.points_ned_m is not None and self.anchors_ne_m is not None:
            raise SpecificationError(
                ("anchors_ne_m",), "and points_ned_m exclude each other; leave out one of them (null)"
            )
        key = "anchors_ne_m" if self.anchors_ne_m is not None else "points_ned_m"
        for number, (point, following) in enumerate(pairwise(self.anchors_ne_m or self.points_ned_m or ())):
            if point[:2] == following[:2]:
                raise SpecificationError(
                    (key, number + 1), f"= {_numbers(following)} repeats the point before it; leave one of them out"
                )


@dataclass(frozen=True, slots=True)
class Intakes(Specification):
    """Openings in the left side of a dam, seen along its heading, each behind vertical bars."""

    count: Annotated[int, Bounds(at_least=1, at_most=500)]
    width_m: Positive
    height_m: Positive
    down_m: Annotated[float, "depth of their middles below the local origin"]
    bars: Annotated[int, Bounds(at_least=0, at_most=200), "number of bars in front of each opening"] = 0


@dataclass(frozen=True, slots=True)
class DamSpec(Specification):
    """A box."""

    centre_ned_m: Vector
    size_m: Annotated[Size, "length along the heading, width and height"]
    heading_deg: Direction = 0.0
    intakes: Intakes | None = None

    def check(self) -> None:
        intakes = self.intakes
        if intakes is None:
            return
        most = self.size_m[0] / intakes.count
        if intakes.width_m > most:
            raise SpecificationError(
                ("intakes", "width_m"),
                f"= {intakes.width_m:g} is too wide for {intakes.count} intakes along "
                f"{self.size_m[0]:g} m; use {most:g} or less",
            )
        middle, half = self.centre_ned_m[2], self.size_m[2] / 2
        top_m, bottom_m = intakes.down_m - intakes.height_m / 2, intakes.down_m + intakes.height_m / 2
        if top_m < middle - half or bottom_m > middle + half:
            raise SpecificationError(
                ("intakes", "height_m"),
                f"= {intakes.height_m:g} puts the intakes at {top_m:g} to {bottom_m:g} m down, outside the dam at "
                f"{middle - half:g} to {middle + half:g}; change down_m or height_m",
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class RiverSpec(Specification):
    """The bed and the land next to it as triangles: a straight channel and its banks with trees and rocks."""

    direction_deg: Annotated[Direction, "direction towards which the water flows"] = 0.0
    through_ne_m: Annotated[Place, "a point of the channel's middle line"] = (0.0, 0.0)
    width_m: Annotated[Positive, "width between the waterlines"]
    depth_m: Annotated[
        Positive, "depth at the deepest point; may differ from `environment.water.depth_m`, which the waves use"
    ]
    bank_slope: Annotated[float, Bounds(above=0.01, at_most=10)] = 0.5
    bank_height_m: Annotated[NonNegative, "height of the land above the water"] = 4.0
    undulation_m: Annotated[NonNegative, "standard deviation of bed and land about that shape"] = 0.3
    along_m: Annotated[tuple[float, float], "start and end of the triangles along the channel"] = (-200.0, 200.0)
    beside_m: Annotated[Positive, "distance of the triangles beyond the waterlines"] = 30.0
    cell_m: Annotated[float, Bounds(at_least=0.2, at_most=100), "size of the triangles near the waterlines"] = 2.5
    trees: Annotated[int, Bounds(at_least=0, at_most=5000)] = 0
    rocks: Annotated[int, Bounds(at_least=0, at_most=5000)] = 0
    seed: Annotated[Seed, "seed of undulation, trees and rocks; it belongs to the site, not to the run"] = 1

    def check(self) -> None:
        if self.along_m[0] >= self.along_m[1]:
            raise SpecificationError(
                ("along_m",),
                f"= {_numbers(self.along_m)} has its ends in the wrong order; put the smaller number first",
            )
        if self.trees and self.beside_m <= NEAREST_TREE_M:
            raise SpecificationError(
                ("beside_m",), f"= {self.beside_m:g} leaves no room for trees; use more than {NEAREST_TREE_M:g}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class ShoalSpec(Specification):
    """Rocks from the bed to above the water, in a strip."""

    count: Annotated[int, Bounds(at_least=1, at_most=1000)]
    from_ne_m: Place
    to_ne_m: Place
    width_m: Annotated[NonNegative, "width of the strip"] = 0.0
    radius_m: Annotated[tuple[Positive, Positive], "smallest and largest radius at the waterline"] = (1.0, 3.0)
    height_m: Annotated[tuple[Positive, Positive], "smallest and largest height above the water"] = (0.5, 2.0)
    seed: Seed = 1


@dataclass(frozen=True, slots=True)
class BuildingSpec(Specification):
    """A box on the ground."""

    centre_ne_m: Place
    size_m: Annotated[Size, "length along the heading, width and height"]
    heading_deg: Direction = 0.0


@dataclass(frozen=True, slots=True)
class MeshFileSpec(Specification):
    """A mesh from a file (STL, DAE, OBJ, PLY, glTF, GLB).

    Sensors see it, and with `contact` the vessel collides with it.
    """

    file: Annotated[str, "path relative to the profile"]
    position_ned_m: Annotated[Vector, "position of its origin"] = (0.0, 0.0, 0.0)
    heading_deg: Annotated[Direction, "rotation of the mesh, clockwise"] = 0.0
    scale: Annotated[Positive, "metres per unit of the mesh"] = 1.0
    up: Annotated[Literal["y", "z"], "z: axes x east, y north, z up; y: axes x east, y up"] = "z"
    material: MaterialName = "concrete"


@dataclass(frozen=True, slots=True, kw_only=True)
class BuoySpec(Specification):
    """A moored buoy. It moves up and down with the waves, and its mooring holds it against current and wind."""

    pos_ned_m: Annotated[Place, "position of the anchor, north and east"]
    shape: Annotated[BuoyShape, "can, cone and sphere are about as high as wide; pillar and spar are taller"] = "can"
    diameter_m: Annotated[float, Bounds(at_least=0.1, at_most=5)] = 0.8
    colour: Annotated[
        BuoyColour, "a plain colour, or a mark of the IALA maritime buoyage system; a and b are its regions"
    ] = "red"
    swing_m: Annotated[NonNegative, "distance from the anchor, in plan, at which the mooring becomes taut"] = 0.5
    reflector_m2: Annotated[NonNegative, "radar cross section of its reflector, in addition to the hull"] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AisSpec(Specification):
    """Static AIS data that a vessel sends in addition to its position, course and speed."""

    transponder: Annotated[
        Literal["class-a", "class-b", "none"],
        "class of the transponder: class A sends every 2 to 10 s under way, class B every 30 s",
    ] = "class-a"
    mmsi: Annotated[
        Annotated[int, Bounds(at_least=1, at_most=LAST_MMSI)] | None,
        "null: 200000000 plus the system id, for a scripted vessel 200001000 plus its number. These belong to no "
        "country",
    ] = None
    callsign: Annotated[str, _ais_text(7), "at most 7 characters"] = ""
    name: Annotated[str, _ais_text(AIS_NAME), "at most 20 characters; empty: its name in the profile"] = ""
    ship_type: Annotated[
        int,
        Bounds(at_least=0, at_most=255),
        "type by ITU-R M.1371: 30 fishing, 37 pleasure craft, 52 tug, 70 cargo, 80 tanker",
    ] = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TrafficSpec(Specification):
    """A scripted vessel: it follows its track under all conditions, without actuators, sensors and autopilot."""

    track_ned_m: Annotated[tuple[Place, ...], Items(1, 1000), "a list of [north, east]; one point for a vessel at rest"]
    speed_mps: Annotated[Annotated[float, Bounds(above=0, at_most=30)] | None, "speed over ground, along the track"] = (
        None
    )
    heading_deg: Annotated[
        Direction | None, "heading of a vessel at rest; under way, the heading follows the track"
    ] = None
    loop: Annotated[
        bool, "true: from the last point back to the first, again and again; false: it stops at the last point"
    ] = False
    start_s: Annotated[NonNegative, "departure in simulation time"] = 0.0
    length_m: Positive
    beam_m: Positive
    height_m: Annotated[Positive, "height above the water"] = 3.0
    draft_m: Annotated[Positive, "depth below the water"] = 1.0
    ais: AisSpec = AisSpec()

    def check(self) -> None:
        track = self.track_ned_m
        if len(track) == 1 and (self.speed_mps is not None or self.loop):
            key = "loop" if self.loop else "speed_mps"
            raise SpecificationError((key,), "needs a track of several points; give track_ned_m another point")
        if len(track) > 1 and self.speed_mps is None:
            raise SpecificationError((), "needs 'speed_mps', because its track has several points; add it in m/s")
        if len(track) > 1 and self.heading_deg is not None:
            raise SpecificationError(
                ("heading_deg",), "is only for a vessel at rest; leave it out, or give a single point"
            )
        for number, (point, following) in enumerate(pairwise([*track, track[0]] if self.loop else track)):
            if point == following:
                raise SpecificationError(
                    ("track_ned_m", (number + 1) % len(track)),
                    f"= {_numbers(following)} repeats the point before it; leave one of them out",
                )


def _numbers(values: tuple[float, ...]) -> str:
    return f"[{', '.join(f'{value:g}' for value in values)}]"
