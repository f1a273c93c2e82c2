"""Light and colours of a scene, and the script that gives the browser's scene its look: water, sky and wakes."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from xitl_cli.plugins.view.model import Colour


@dataclass(frozen=True, slots=True)
class Lighting:
    """Light and colours around the scene. The sky blends from zenith to haze. Distant objects fade to haze."""

    zenith: Colour
    haze: Colour
    water: Colour
    sun: Colour
    sun_intensity: float
    sky_light: Colour
    sky_intensity: float
    ground_light: Colour
    glow: Colour
    """Light of the sun, or of the moon, on the sky and the water."""


DAY = Lighting(
    (88, 148, 205),
    (214, 227, 236),
    (30, 96, 118),
    (255, 244, 224),
    2.1,
    (214, 227, 236),
    2.3,
    (150, 152, 140),
    (255, 238, 205),
)
NIGHT = Lighting(
    (10, 16, 30),
    (46, 61, 82),
    (72, 116, 128),
    (190, 208, 255),
    0.95,
    (150, 172, 205),
    1.15,
    (84, 94, 110),
    (90, 105, 135),
)


def look_html() -> str:
    """Return the script for the head of a page. The page works without it, with plain colours."""
    colours = {
        name: {"zenith": lighting.zenith, "haze": lighting.haze, "glow": lighting.glow}
        for name, lighting in (("day", DAY), ("night", NIGHT))
    }
    script = (files("xitl_cli.plugins.view") / "look.js").read_text(encoding="utf-8")
    data = f'<script type="application/json" id="xitl-look">{json.dumps(colours)}</script>'
    return f"{data}<script>{script}</script>"


def sky_rows(lighting: Lighting) -> NDArray[np.uint8]:
    """Return the sky colours (192, 3) from the top of a picture to its bottom, independent of the camera."""
    share = np.linspace(0.0, 1.0, 72)[:, None] ** 0.9
    sky = np.asarray(lighting.zenith) * (1.0 - share) + np.asarray(lighting.haze) * share
    return np.round(np.concatenate([sky, np.repeat(sky[-1:], 120, axis=0)])).astype(np.uint8)


def show_lighting(api: Any, lighting: Lighting) -> None:
    """Set sky, light and haze in the scene of a server, or of one browser."""
    api.set_background_image(np.repeat(sky_rows(lighting)[:, None], 4, axis=1), format="png")
    api.configure_fog(60.0, 1100.0, color=lighting.haze)
    sun, strength = lighting.sun, lighting.sun_intensity
    api.add_light_directional("/light/sun", color=sun, intensity=strength, position=(-0.6, -0.75, 0.6))
    # A second light at a low angle makes waves visible, because the material of a mesh has no gloss.
    api.add_light_directional("/light/glance", color=sun, intensity=0.75 * strength, position=(-0.9, 0.5, 0.13))
    api.add_light_hemisphere(
        "/light/sky",
        sky_color=lighting.sky_light,
        ground_color=lighting.ground_light,
        intensity=lighting.sky_intensity,
        position=(0.0, 0.0, 1.0),
    )
