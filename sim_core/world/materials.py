"""What surfaces are made of, as light and sound see it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Material:
    """reflectivity: diffuse, of light of 905 nm, 0 to 1. backscatter: of sound, 0 to 1 of what a rigid wall returns."""

    name: str
    reflectivity: float
    backscatter: float


CONCRETE = Material("concrete", 0.35, 0.8)
STEEL = Material("steel", 0.45, 1.0)
PLASTIC = Material("plastic", 0.5, 0.4)
WOOD = Material("wood", 0.3, 0.3)
LEAVES = Material("leaves", 0.5, 0.08)
HIDE = Material("hide", 0.25, 0.2)
EARTH = Material("earth", 0.25, 0.25)
ROCK = Material("rock", 0.3, 0.6)
WALL = Material("wall", 0.6, 0.8)
BED = Material("bed", 0.1, 0.15)

MATERIALS = (CONCRETE, STEEL, PLASTIC, WOOD, LEAVES, HIDE, EARTH, ROCK, WALL, BED)
"""By number, as `Hits.material` has them."""
