"""`vessels`: the keys of one of several vessels, and the places of several vessels of one entry."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Annotated, Literal

from sim_core.dataclass import dataclass
from sim_core.keys import Bounds, Positive, Specification, SpecificationError
from xitl_cli.profile.schema.agents import MOST_VESSELS

SAILED = ("vehicle", "ais", "sensors", "mission", "driver", "autopilot", "companion", "faults", "plugins")
"""Groups that a vessel may have separately. It inherits missing keys from the profile."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FormationSpec(Specification):
    """Positions relative to each other, along the axes of the heading at the start.

    `mission.start` is the position of the first vessel. In a line abreast it is the middle, in a wedge the point,
    in a circle the centre, and in a grid the middle of the first row.
    """

    shape: Literal["column", "line_abreast", "wedge", "circle", "grid"]
    spacing_m: Annotated[
        Positive, "distance from each vessel to the next; in a wedge along its arms, which go back at 45 degrees"
    ] = 10.0
    waypoints: Annotated[
        Literal["shifted", "shared"],
        "waypoints, offsets and tracks move with the start, or are the same for all vessels",
    ] = "shifted"


@dataclass(frozen=True, slots=True, kw_only=True)
class SpreadSpec(Specification):
    """Positions drawn from `clock.seed`, uniform over the free area of a circle about `mission.start`."""

    radius_m: Positive
    apart_m: Annotated[Positive, "smallest distance between two vessels"] = 10.0
    waypoints: Annotated[Literal["shifted", "shared"], "as in a formation"] = "shifted"


@dataclass(frozen=True, slots=True, kw_only=True)
class SeveralSpec(Specification):
    """One vessel, or several alike: `follower` with a `count` becomes `follower_1`, `follower_2` and so on.

    A given system id or MMSI belongs to the first vessel, and the others count up from it.
    """

    count: Annotated[
        Annotated[int, Bounds(at_least=1, at_most=MOST_VESSELS)] | None,
        "number of vessels; null: one vessel, without a number in its name",
    ] = None
    formation: FormationSpec | None = None
    spread: SpreadSpec | None = None

    def check(self) -> None:
        if self.formation is not None and self.spread is not None:
            raise SpecificationError(("spread",), "and formation exclude each other; remove one of them (null)")
        if self.count is None and (self.formation is not None or self.spread is not None):
            key = "formation" if self.formation is not None else "spread"
            raise SpecificationError((key,), "needs several vessels; add count")
        if self.count is not None and self.count > 1 and self.formation is None and self.spread is None:
            raise SpecificationError(
                ("count",), f"= {self.count} puts all in the same place; add formation: {{shape: column}} or a spread"
            )


Offset = tuple[float, float]
"""Two coordinates in metres: forward and to starboard, or north and east, as the function says."""

_DRAWS = 10_000
"""Draws for each vessel. If a hundredth of the circle is free, one vessel in 10⁴³ gets no place."""


def formation_offsets(shape: str, count: int, spacing_m: float) -> list[Offset]:
    """Return the offset of each vessel from the start, forward and to starboard."""
    across = [place - (count - 1) / 2 for place in range(count)]
    if shape == "column":
        return [(0.0 - number * spacing_m, 0.0) for number in range(count)]
    if shape == "line_abreast":
        return [(0.0, place * spacing_m) for place in across]
    if shape == "wedge":
        arm_m = spacing_m / math.sqrt(2)
        ranks = [((number + 1) // 2, -1 if number % 2 else 1) for number in range(count)]
        return [(0.0 - rank * arm_m, side * rank * arm_m) for rank, side in ranks]
    if shape == "circle":
        radius_m = 0.0 if count == 1 else spacing_m / (2 * math.sin(math.pi / count))
        turns = [2 * math.pi * number / count for number in range(count)]
        return [(radius_m * math.cos(turn), radius_m * math.sin(turn)) for turn in turns]
    columns = math.ceil(math.sqrt(count))
    return [
        (0.0 - number // columns * spacing_m, (number % columns - (columns - 1) / 2) * spacing_m)
        for number in range(count)
    ]


def spread_offsets(
    count: int, radius_m: float, apart_m: float, seed: str, free: Callable[[Offset], bool] = lambda place: True
) -> list[Offset] | None:
    """Return the offset of each vessel from the middle, north and east. None if no more free places were found.

    Offsets are distributed evenly over the circle. seed: of the draw. free: returns True if an offset is free.
    """
    draw = random.Random(seed)
    places: list[Offset] = []
    for _ in range(_DRAWS * count):
        if len(places) == count:
            break
        distance_m, turn = radius_m * math.sqrt(draw.random()), 2 * math.pi * draw.random()
        place = (distance_m * math.cos(turn), distance_m * math.sin(turn))
        if all(math.dist(place, other) >= apart_m for other in places) and free(place):
            places.append(place)
    return places if len(places) == count else None


def in_north_east(offset_frd_m: Offset, heading_deg: float) -> Offset:
    """Return forward and starboard along a heading as north and east."""
    forward_m, starboard_m = offset_frd_m
    cos, sin = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
    return cos * forward_m - sin * starboard_m, sin * forward_m + cos * starboard_m


def in_forward_starboard(offset_ne_m: Offset, heading_deg: float) -> Offset:
    """Return the inverse of `in_north_east`."""
    return in_north_east(offset_ne_m, -heading_deg)


def ahead_of(place_ne_m: Offset, heading_deg: float, offset_frd_m: Offset) -> Offset:
    """Return the place at an offset from another place with a heading, north and east."""
    north_m, east_m = in_north_east(offset_frd_m, heading_deg)
    return place_ne_m[0] + north_m, place_ne_m[1] + east_m
