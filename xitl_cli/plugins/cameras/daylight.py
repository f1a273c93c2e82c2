"""Light of the day, of dusk and of the night, for a renderer.

Radiances are relative: a white surface across the light of a high sun has about 1. The colours between the heights of
the sun are chosen by eye; the attenuation by the air is computed.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array

Colour: TypeAlias = Array
"""Red, green and blue, linear, (3,)."""

SUN_RADIUS_RAD = math.radians(0.266)
CLEAR_VISIBILITY_M = 40_000.0
_OPTICAL_DEPTH = np.array([0.10, 0.15, 0.28])
"""Of clean air at sea level with some haze, for red, green and blue."""
_DARKEST = 0.0012
"""Light of a clear night over that of the day; the true one is a thousand times less. A camera would see nothing."""

# Height of the sun in degrees, then zenith and horizon, and the light around the sun.
_SKIES = (
    (-18.0, (0.0003, 0.0004, 0.0009), (0.0006, 0.0007, 0.0012), (0.0, 0.0, 0.0)),
    (-8.0, (0.004, 0.007, 0.018), (0.030, 0.022, 0.024), (0.040, 0.014, 0.004)),
    (-2.0, (0.030, 0.050, 0.110), (0.260, 0.150, 0.100), (0.700, 0.260, 0.060)),
    (4.0, (0.080, 0.150, 0.320), (0.620, 0.470, 0.340), (1.300, 0.750, 0.300)),
    (15.0, (0.120, 0.240, 0.520), (0.620, 0.680, 0.700), (1.000, 0.850, 0.600)),
    (60.0, (0.140, 0.290, 0.640), (0.560, 0.680, 0.780), (0.900, 0.880, 0.800)),
)


@dataclass(frozen=True, slots=True, eq=False)
class Daylight:
    """Light of one instant."""

    sun_ned: Array
    """Unit vector to the sun, (3,)."""
    sun: Colour
    """Radiance of a white surface across the direct light."""
    sky: Colour
    """Radiance of a white surface that sees only the sky."""
    zenith: Colour
    horizon: Colour
    glow: Colour
    """Light scattered around the sun."""
    cloud: Colour
    clouds: float
    """Share of the sky."""
    stars: float
    """Brightness."""
    exposure: float
    """Factor that makes a grey surface in this light a middle value of an image."""


def daylight(sun_ned: Array, clouds: float) -> Daylight:
    """Return the light of a sun in a direction, under a sky with a share of clouds from 0 to 1."""
    height_deg = math.degrees(math.asin(float(np.clip(-sun_ned[2], -1.0, 1.0))))
    heights, zeniths, horizons, glows = (np.array(column) for column in zip(*_SKIES, strict=True))
    zenith, horizon, glow = (
        np.array([np.interp(height_deg, heights, part) for part in column.T]) for column in (zeniths, horizons, glows)
    )
    # Direct light: attenuation along the air mass of Kasten and Young 1989
    above_deg = max(height_deg, -0.8)
    air_mass = 1.0 / (math.sin(math.radians(max(above_deg, 0.0))) + 0.50572 * (above_deg + 6.07995) ** -1.6364)
    overcast = float(np.clip((clouds - 0.55) / 0.45, 0.0, 1.0))
    risen = float(np.clip((height_deg + 0.6) / 1.2, 0.0, 1.0))
    sun = 1.2 * np.exp(-_OPTICAL_DEPTH * air_mass) * risen * (1.0 - 0.96 * overcast)
    # An overcast sky is grey, and brighter at the zenith than at the horizon.
    grey = np.full(3, 0.55 * zenith.mean() + 0.45 * horizon.mean())
    zenith, horizon = zenith + overcast * (grey - zenith), horizon + overcast * (0.85 * grey - horizon)
    glow = glow * (1.0 - overcast)
    sky = 0.62 * zenith + 0.38 * horizon + _DARKEST * np.array([0.8, 0.9, 1.2])
    cloud = 0.85 * sun * max(-float(sun_ned[2]), 0.15) + 0.9 * sky
    light = float((sky + sun * max(-float(sun_ned[2]), 0.0)).mean())
    stars = 0.02 * float(np.clip((-height_deg - 6.0) / 8.0, 0.0, 1.0)) * (1.0 - overcast)
    exposure = 1.0 / max(light, 0.006)
    return Daylight(sun_ned, sun, sky, zenith, horizon, glow, cloud, clouds, stars, exposure)


def visible_extinction_per_m(visibility_m: float | None, rain_mmph: float = 0.0) -> float:
    """Return the extinction of visible light, 1/m. None: clear air.

    Koschmieder's law, and rain as in LOWTRAN 7: 0.365 R^0.63 per kilometre.
    """
    air = 3.912 / (CLEAR_VISIBILITY_M if visibility_m is None else visibility_m)
    return air + 0.365e-3 * float(rain_mmph**0.63)
