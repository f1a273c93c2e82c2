"""`site` and `world`: where the local origin is, and what stands around it."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from xitl_cli.profile.schema.debris import Debris
from xitl_cli.profile.schema.group import Direction, Group, NonNegative, Positive, Vector

Place: TypeAlias = tuple[float, float]
Size: TypeAlias = tuple[Positive, Positive, Positive]
MaterialName = Literal[
    "concrete", "steel", "plastic", "wood", "leaves", "hide", "earth", "rock", "wall", "bed"
]  # fmt: skip

MESH_FORMATS = ("stl", "dae", "obj", "ply", "gltf", "glb")


class Site(Group):
    """The local origin on the Earth; without a `magnetic_field_ned_gauss` the world magnetic model gives it."""

    name: str
    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    longitude_deg: Annotated[float, Field(ge=-180, le=180)]
    altitude_m: Annotated[float, Field(ge=-500, le=9000)]
    magnetic_field_ned_gauss: Vector | None = None
    year: Annotated[float, Field(ge=1980, le=2100)] = 2026.0


class LogBoom(Group):
    """A floating line of cylinders, along `points_ned_m`, or at the water's level between `anchors_ne_m`.

    Between two anchors the line sags by `sag_m` to the right of the way along them. With a `pile_radius_m` each
    anchor is a pile that reaches from the bed to `pile_height_m` above the water.
    """

    points_ned_m: Annotated[tuple[Vector, ...], Field(min_length=2)] | None = None
    anchors_ne_m: Annotated[tuple[Place, ...], Field(min_length=2)] | None = None
    sag_m: NonNegative = 0.0
    float_length_m: Positive
    float_radius_m: Positive
    pile_radius_m: NonNegative = 0.0
    pile_height_m: Positive = 3.0


class Intakes(Group):
    """`count` openings in the left side of a dam, as seen along its heading, each behind `bars` upright bars."""

    count: Annotated[int, Field(ge=1, le=500)]
    width_m: Positive
    height_m: Positive
    down_m: float
    bars: Annotated[int, Field(ge=0, le=200)] = 0


class Dam(Group):
    """A box; `size_m` is length along `heading_deg`, width and height."""

    centre_ned_m: Vector
    size_m: Size
    heading_deg: Direction = 0.0
    intakes: Intakes | None = None


class River(Group):
    """The bed and the land beside it: a straight channel toward `direction_deg`, its banks with trees and rocks.

    `width_m`: between the waterlines, half of it on either side of `through_ne_m`. `undulation_m`: standard deviation
    of bed and land about that shape, drawn from `seed`, which is of the site and not of the run. As triangles it goes
    from `along_m[0]` to `along_m[1]` along the channel and to `beside_m` beyond the waterlines, in cells of `cell_m`
    near those. `depth_m` is where it is deepest, and may differ from that of environment.water, which waves go by.
    """

    direction_deg: Direction = 0.0
    through_ne_m: Place = (0.0, 0.0)
    width_m: Positive
    depth_m: Positive
    bank_slope: Annotated[float, Field(gt=0.01, le=10)] = 0.5
    bank_height_m: NonNegative = 4.0
    undulation_m: NonNegative = 0.3
    along_m: tuple[float, float] = (-200.0, 200.0)
    beside_m: Positive = 30.0
    cell_m: Annotated[float, Field(ge=0.2, le=100)] = 2.5
    trees: Annotated[int, Field(ge=0, le=5000)] = 0
    rocks: Annotated[int, Field(ge=0, le=5000)] = 0
    seed: Annotated[int, Field(ge=0)] = 1


class Shoal(Group):
    """`count` rocks from the bed to above the water in a strip `width_m` wide.

    Each is of a radius at the waterline and of a height above the water between the two numbers given.
    """

    count: Annotated[int, Field(ge=1, le=1000)]
    from_ne_m: Place
    to_ne_m: Place
    width_m: NonNegative = 0.0
    radius_m: tuple[Positive, Positive] = (1.0, 3.0)
    height_m: tuple[Positive, Positive] = (0.5, 2.0)
    seed: Annotated[int, Field(ge=0)] = 1


class Building(Group):
    """A box on the ground; `size_m` is length along `heading_deg`, width and height."""

    centre_ne_m: Place
    size_m: Size
    heading_deg: Direction = 0.0


class MeshFile(Group):
    """A mesh from a file (STL, DAE, OBJ, PLY, glTF, GLB), `scale` metres to its unit.

    Its axes are x east, y north, z up, or with `up: y` x east, y up; a heading turns it clockwise.
    """

    file: str
    position_ned_m: Vector = (0.0, 0.0, 0.0)
    heading_deg: Direction = 0.0
    scale: Positive = 1.0
    up: Literal["y", "z"] = "z"
    material: MaterialName = "concrete"


class World(Group):
    """The surroundings of a site. With `contact` the vessel runs into them; debris always does."""

    log_boom: LogBoom | None = None
    dam: Dam | None = None
    river: River | None = None
    shoals: tuple[Shoal, ...] = ()
    buildings: tuple[Building, ...] = ()
    meshes: tuple[MeshFile, ...] = ()
    contact: bool = False
    debris: Debris = Debris()
