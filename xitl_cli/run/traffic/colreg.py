"""Geometry of an encounter by the International Regulations for Preventing Collisions at Sea 1972, rules 13 to 15.

Bearings are relative to each vessel's heading, because the rules refer to lights, which are fixed to the ship:

- Rule 13 (b): a vessel overtakes when it approaches from more than 22.5 degrees abaft the other's beam. By night it
  would see only her stern light. Its bearing from her is then beyond 90 + 22.5 = 112.5 degrees, the end of the
  sidelights (21 (b)).
- Rule 14 (a): head-on means reciprocal or nearly reciprocal courses. (b) presumes it when each vessel sees the other
  ahead or nearly ahead, so that by night both sidelights would be visible. The rule gives no figure. Sidelights reach 1
  to 3 degrees across the bow (annex I, 9 (a)). We add 10 degrees for the yaw of a small vessel in waves. Both bearings,
  and the headings from reciprocal, must therefore be within 13 degrees. 14 (c): in doubt, the encounter is head-on. It
  is also head-on when both vessels have each other on the same side. Then neither overtakes, and rule 15 names no
  single vessel.
- Rule 15: of two crossing vessels, the one with the other on her own starboard side gives way.

Rule 13 (d): an encounter keeps its initial class, so classify it once. The rules apply to power-driven vessels under
way in sight of one another. The caller decides whether there is a risk of collision.
"""

from __future__ import annotations

import math
from typing import Literal

from sim_core.dataclass import dataclass

Geometry = Literal["overtaking", "head-on", "crossing"]
ABAFT_DEG = 112.5
NEARLY_DEG = 13.0
"""Rule 14: largest angle of the other vessel from ahead, and of the headings from reciprocal."""
RULES: dict[Geometry, int] = {"overtaking": 13, "head-on": 14, "crossing": 15}


@dataclass(frozen=True, slots=True)
class EncounterGeometry:
    """The class of an encounter of vessels 0 and 1."""

    geometry: Geometry
    gives_way: tuple[int, ...]
    """Vessels that give way; the other one keeps course and speed. Head-on, both turn to starboard."""
    bearings_deg: tuple[float, float]
    """Bearing of 1 from 0 and of 0 from 1, from their headings, -180 to 180, starboard positive."""

    @property
    def rule(self) -> int:
        """Number of the rule."""
        return RULES[self.geometry]

    @property
    def stands_on(self) -> int | None:
        """The vessel that keeps course and speed, by rule 17."""
        return None if len(self.gives_way) == 2 else 1 - self.gives_way[0]


def encounter_geometry(
    places_ne_m: tuple[tuple[float, float], tuple[float, float]],
    headings_rad: tuple[float, float],
    speeds_mps: tuple[float, float],
) -> EncounterGeometry:
    """Return the geometry of two approaching vessels.

    speeds_mps: over ground. If each is astern of the other, the faster one overtakes.
    """
    (north0, east0), (north1, east1) = places_ne_m
    bearing_rad = math.atan2(east1 - east0, north1 - north0)
    seen = (_degrees(bearing_rad - headings_rad[0]), _degrees(bearing_rad + math.pi - headings_rad[1]))
    astern = [abs(bearing) > ABAFT_DEG for bearing in seen]  # whether the other approaches from astern
    if any(astern):
        overtaken = astern.index(True) if not all(astern) else min((0, 1), key=lambda vessel: speeds_mps[vessel])
        return EncounterGeometry("overtaking", (1 - overtaken,), seen)
    from_reciprocal = _degrees(headings_rad[0] - headings_rad[1] + math.pi)
    ahead = all(abs(angle) <= NEARLY_DEG for angle in (*seen, from_reciprocal))
    if ahead or seen[0] * seen[1] >= 0.0:
        return EncounterGeometry("head-on", (0, 1), seen)
    return EncounterGeometry("crossing", (0,) if seen[0] > 0.0 else (1,), seen)


def _degrees(angle_rad: float) -> float:
    return math.degrees(math.remainder(angle_rad, 2.0 * math.pi))
