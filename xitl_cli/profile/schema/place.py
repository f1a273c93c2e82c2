"""`site` and `world`: where the local origin is, and what stands around it (drawn, not collided with)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from xitl_cli.profile.schema.debris import Debris
from xitl_cli.profile.schema.group import Direction, Group, Positive, Vector


class Site(Group):
    """The local origin on the Earth; without a `magnetic_field_ned_gauss` the world magnetic model gives it."""

    name: str
    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    longitude_deg: Annotated[float, Field(ge=-180, le=180)]
    altitude_m: Annotated[float, Field(ge=-500, le=9000)]
    magnetic_field_ned_gauss: Vector | None = None
    year: Annotated[float, Field(ge=1980, le=2100)] = 2026.0


class LogBoom(Group):
    """A floating line of cylinders along `points_ned_m`."""

    points_ned_m: Annotated[tuple[Vector, ...], Field(min_length=2)]
    float_length_m: Positive
    float_radius_m: Positive


class Dam(Group):
    """A box; `size_m` is length along `heading_deg`, width and height."""

    centre_ned_m: Vector
    size_m: tuple[Positive, Positive, Positive]
    heading_deg: Direction = 0.0


class World(Group):
    """The surroundings of a site."""

    log_boom: LogBoom | None = None
    dam: Dam | None = None
    debris: Debris = Debris()
