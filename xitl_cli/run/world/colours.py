"""Colours of everything that a view, a picture, Foxglove or a camera draws: red, green and blue in sRGB, 0 to 1."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy import float64

from sim_core.frames import Array
from sim_core.world.debris import Body, BodyKind
from sim_core.world.geometry import EARTH, MATERIALS, Mesh
from sim_core.world.spec import BuoyColour

Rgb: TypeAlias = tuple[float, float, float]

MATERIAL_COLOURS: dict[str, Rgb] = {
    "concrete": (0.66, 0.65, 0.62),
    "steel": (0.45, 0.47, 0.5),
    "plastic": (0.95, 0.45, 0.1),
    "wood": (0.4, 0.28, 0.18),
    "leaves": (0.2, 0.42, 0.14),
    "hide": (0.45, 0.3, 0.2),
    "earth": (0.47, 0.44, 0.26),
    "rock": (0.4, 0.38, 0.36),
    "wall": (0.85, 0.82, 0.75),
    "bed": (0.3, 0.25, 0.18),
}
assert set(MATERIAL_COLOURS) == {material.name for material in MATERIALS}

BODY_COLOURS: dict[BodyKind, Rgb] = {
    BodyKind.TRUNK: (0.4, 0.26, 0.13),
    BodyKind.BRANCH: (0.5, 0.36, 0.2),
    BodyKind.PLANTS: (0.27, 0.46, 0.17),
    BodyKind.ANIMAL: (0.55, 0.42, 0.35),
    BodyKind.PLANK: (0.68, 0.56, 0.38),
    BodyKind.PLASTIC: (0.08, 0.27, 0.62),
}
"""Of drifting bodies. Buoys have `BUOY_MARKS`."""

_RED, _GREEN, _YELLOW, _BLACK = (0.75, 0.06, 0.05), (0.04, 0.45, 0.18), (0.95, 0.78, 0.05), (0.06, 0.06, 0.07)
_WHITE, _BLUE, _ORANGE = (0.92, 0.92, 0.9), (0.05, 0.2, 0.6), (0.95, 0.42, 0.08)
BUOY_MARKS: dict[BuoyColour, tuple[Rgb, ...]] = {
    "red": (_RED,),
    "green": (_GREEN,),
    "yellow": (_YELLOW,),
    "orange": (_ORANGE,),
    "white": (_WHITE,),
    "black": (_BLACK,),
    "blue": (_BLUE,),
    "port-a": (_RED,),
    "starboard-a": (_GREEN,),
    "port-b": (_GREEN,),
    "starboard-b": (_RED,),
    "north": (_BLACK, _YELLOW),
    "east": (_BLACK, _YELLOW, _BLACK),
    "south": (_YELLOW, _BLACK),
    "west": (_YELLOW, _BLACK, _YELLOW),
    "isolated-danger": (_BLACK, _RED, _BLACK),
    "safe-water": (_RED, _WHITE),
    "special": (_YELLOW,),
    "wreck": (_BLUE, _YELLOW),
}
"""Colours of bands from the top down to the water (IALA R1001). Those of `STRIPED` are upright stripes."""
STRIPED = ("safe-water", "wreck")
_STRIPES = 8

PAINTS: dict[str, Rgb] = {
    "hull": (0.90, 0.91, 0.92),
    "topsides": (0.10, 0.17, 0.28),
    "bottom": (0.46, 0.10, 0.08),
    "deck": (0.33, 0.36, 0.38),
    "house": (0.93, 0.93, 0.90),
    "glass": (0.07, 0.10, 0.14),
    "case": (0.95, 0.40, 0.06),
    "metal": (0.13, 0.14, 0.16),
    "rudder": (0.45, 0.06, 0.05),
    "boom": (0.95, 0.42, 0.08),
    "white light": (1.0, 0.98, 0.9),
    "red light": (1.0, 0.1, 0.08),
    "green light": (0.1, 1.0, 0.3),
}
"""Paints of vessels, of the floats of a log boom, and of lamps."""


def coloured_parts(body: Body) -> tuple[tuple[Mesh, Rgb], ...]:
    """Return the surface of a floating body in parts of one colour, in its axes."""
    mesh = body.mesh
    if body.buoy is None:
        return ((mesh, BODY_COLOURS[body.kind]),)
    colours = BUOY_MARKS[body.buoy.colour]
    middle = mesh.vertices_m[mesh.faces].mean(axis=1)
    if body.buoy.colour in STRIPED:
        turn = (np.arctan2(middle[:, 1], middle[:, 0]) / (2.0 * np.pi)) % 1.0
        number = np.floor(turn * _STRIPES).astype(int) % len(colours)
    else:
        top_m = float(mesh.vertices_m[:, 2].min())
        share = (middle[:, 2] - top_m) / body.height_m
        number = np.clip(np.floor(share * len(colours)).astype(int), 0, len(colours) - 1)
    return tuple(
        (Mesh(mesh.vertices_m, mesh.faces[number == chosen], mesh.material), colour)
        for chosen, colour in enumerate(colours)
    )


def linear_colour(colour: Sequence[float]) -> Array:
    """Return linear red, green and blue of an sRGB colour (IEC 61966-2-1), all from 0 to 1."""
    value = np.asarray(colour, dtype=float64)
    result: Array = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return result


GRASS: Rgb = (0.33, 0.43, 0.17)
SHORE_M = 0.7
"""Height above the mean water to which the ground is bare."""


def ground_colours(mesh: Mesh, water_down_m: float) -> tuple[tuple[Mesh, Rgb], ...]:
    """Return ground in NED in parts of one colour: bare at the shore and below the water, and grass above."""
    high = mesh.vertices_m[mesh.faces, 2].mean(axis=1) < water_down_m - SHORE_M
    parts = ((~high, MATERIAL_COLOURS[mesh.material.name]), (high & (mesh.material is EARTH), GRASS))
    return tuple(
        (Mesh(mesh.vertices_m, mesh.faces[chosen], mesh.material), colour) for chosen, colour in parts if chosen.any()
    )


_CLEAR_WATER, _MUDDY_WATER = np.array([0.006, 0.030, 0.040]), np.array([0.105, 0.090, 0.048])


def water_reflectance(water_reflectivity: float) -> Array:
    """Return the diffuse reflectance (3,) of water, linear red, green and blue.

    water_reflectivity: of the environment. Clear water has little backscatter; at 0.05, it is a river with mud.
    """
    muddy = min(water_reflectivity / 0.05, 1.0)
    return np.asarray(_CLEAR_WATER + muddy * (_MUDDY_WATER - _CLEAR_WATER))


_DAYLIGHT = 1.5
"""Radiance of a white surface in daylight, in the units of a picture."""


def water_colour(water_reflectivity: float) -> Rgb:
    """Return the colour of water in daylight without its reflections, in sRGB."""
    red, green, blue = np.sqrt(_DAYLIGHT * water_reflectance(water_reflectivity)).tolist()
    return red, green, blue
