"""Places of several vessels beside each other: formations, and places drawn from a seed."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

Offset = tuple[float, float]
"""Two coordinates in metres: forward and to starboard, or north and east, as the function says."""

_DRAWS = 10_000
"""For each vessel: with a hundredth of the circle free one in 10⁴³ finds no place."""


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

    Offsets are distributed evenly over the circle.

    seed: what the draw depends on. free: whether a vessel may lie at an offset.
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
    """Forward and starboard along a heading as north and east."""
    forward_m, starboard_m = offset_frd_m
    cos, sin = math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))
    return cos * forward_m - sin * starboard_m, sin * forward_m + cos * starboard_m


def in_forward_starboard(offset_ne_m: Offset, heading_deg: float) -> Offset:
    """The way back of `in_north_east`."""
    return in_north_east(offset_ne_m, -heading_deg)


def ahead_of(place_ne_m: Offset, heading_deg: float, offset_frd_m: Offset) -> Offset:
    """A place by its offset from another one with that heading, north and east."""
    north_m, east_m = in_north_east(offset_frd_m, heading_deg)
    return place_ne_m[0] + north_m, place_ne_m[1] + east_m
