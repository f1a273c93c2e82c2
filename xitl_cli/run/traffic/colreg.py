"""Geometry of an encounter by the International Regulations for Preventing Collisions at Sea 1972, rules 13 to 15.

Bearings are from each vessel's heading, as the rules speak of lights, which are fixed to the ship:

- Rule 13 (b): overtaking is coming up from more than 22.5 degrees abaft the other's beam, so that by night her stern
  light alone would be seen: seen from her on a bearing beyond 90 + 22.5 = 112.5 degrees, where sidelights end (21 (b)).
- Rule 14 (a): head-on is meeting on reciprocal or nearly reciprocal courses; (b) presumes it where each sees the other
  ahead or nearly ahead, so that by night both sidelights would be seen. The rule gives no figure. Sidelights reach 1 to
  3 degrees across the bow (annex I, 9 (a)). We add 10 degrees for the yaw of a small vessel in waves: both bearings,
  and the headings from reciprocal, are within 13 degrees. 14 (c): where there is doubt, it is head-on. So is an
  encounter in which each has the other on the same side: neither overtakes, and not only one has the other to
  starboard.
- Rule 15: of two that cross the one gives way that has the other on her own starboard side.

Rule 13 (d) has an encounter stay what it was when it began: classify it once. The rules hold between power-driven
vessels under way in sight of one another; whether there is a risk of collision is for the caller to say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Geometry = Literal["overtaking", "head-on", "crossing"]
ABAFT_DEG = 112.5
NEARLY_DEG = 13.0
"""Rule 14: so near to ahead the other is, and so near to reciprocal the headings are."""
RULES: dict[Geometry, int] = {"overtaking": 13, "head-on": 14, "crossing": 15}


@dataclass(frozen=True, slots=True)
class EncounterGeometry:
    """Which of the two, 0 and 1, give way; the other one stands on. Head-on both give way, and turn to starboard.

    bearings_deg: how 0 sees 1 and 1 sees 0, from their headings, -180 to 180, starboard positive.
    """

    geometry: Geometry
    gives_way: tuple[int, ...]
    bearings_deg: tuple[float, float]

    @property
    def rule(self) -> int:
        """Its number."""
        return RULES[self.geometry]

    @property
    def stands_on(self) -> int | None:
        """Who keeps course and speed, by rule 17."""
        return None if len(self.gives_way) == 2 else 1 - self.gives_way[0]


def encounter_geometry(
    places_ne_m: tuple[tuple[float, float], tuple[float, float]],
    headings_rad: tuple[float, float],
    speeds_mps: tuple[float, float],
) -> EncounterGeometry:
    """Of two vessels that close. speeds_mps: over ground; they tell who overtakes of two that show each their stern."""
    (north0, east0), (north1, east1) = places_ne_m
    bearing_rad = math.atan2(east1 - east0, north1 - north0)
    seen = (_degrees(bearing_rad - headings_rad[0]), _degrees(bearing_rad + math.pi - headings_rad[1]))
    astern = [abs(bearing) > ABAFT_DEG for bearing in seen]  # the other comes from astern of this one
    if any(astern):
        overtaken = astern.index(True) if not all(astern) else min((0, 1), key=lambda one: speeds_mps[one])
        return EncounterGeometry("overtaking", (1 - overtaken,), seen)
    from_reciprocal = _degrees(headings_rad[0] - headings_rad[1] + math.pi)
    ahead = all(abs(angle) <= NEARLY_DEG for angle in (*seen, from_reciprocal))
    if ahead or seen[0] * seen[1] >= 0.0:
        return EncounterGeometry("head-on", (0, 1), seen)
    return EncounterGeometry("crossing", (0,) if seen[0] > 0.0 else (1,), seen)


def _degrees(angle_rad: float) -> float:
    return math.degrees(math.remainder(angle_rad, 2.0 * math.pi))
