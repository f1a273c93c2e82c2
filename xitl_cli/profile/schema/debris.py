"""`world.debris`: what is put into the water, and when."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from xitl_cli.profile.schema.group import Direction, Group, NonNegative, Positive

BodyKind = Literal["trunk", "branch", "plants", "animal"]


class Launch(Group):
    """One body at `at_s`; without a `length_m` it is of the usual size of its kind."""

    at_s: NonNegative = 0.0
    kind: BodyKind = "trunk"
    pos_ned_m: tuple[float, float]
    heading_deg: Direction = 0.0
    length_m: Positive | None = None


class Encounters(Group):
    """`count` bodies, of kinds, sizes, places and instants drawn from the seed.

    Each is launched so that it drifts onto the mission's legs about when the vessel is there at mission.speed_mps:
    between `ahead_m[0]` and `ahead_m[1]` before the vessel gets there, off the leg by up to `off_m`.
    """

    count: Annotated[int, Field(ge=0, le=200)] = 0
    kinds: tuple[BodyKind, ...] = ("trunk", "branch", "plants", "animal")
    ahead_m: tuple[Positive, Positive] = (40.0, 60.0)
    off_m: NonNegative = 1.0


class Debris(Group):
    """Bodies adrift: a list of launches, and others drawn. `control`: where `xitl world launch` is heard, null: not."""

    launches: tuple[Launch, ...] = ()
    encounters: Encounters = Encounters()
    control: str | None = None
