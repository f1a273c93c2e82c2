"""Drops of rain in front of a camera, as streaks as long as the drops fall during the exposure.

Number by diameter: Marshall and Palmer 1948. Speed of fall: Atlas, Srivastava and Sekhon 1973, which fits the
measurements of Gunn and Kinzer 1949. A drop is a moving disc, so the light that it replaces is its area times its time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy import float32
from numpy.random import default_rng
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array

DIAMETER_EDGES_MM = np.arange(0.5, 6.01, 0.25)
APERTURE_M = 0.001
"""Opening of the lens, such as 4 mm at f/4. It is focused far away, so a near drop is blurred by as much."""
NEAREST_M, FARTHEST_M = 0.15, 25.0
LEAST_OPACITY = 0.03
"""Fainter streaks are left out. The extinction of the air contains their light."""
MARGIN = 1.2
"""Width of the space with drops, over that of the view."""


@dataclass(frozen=True, slots=True, eq=False)
class Rain:
    """Rain during an exposure, or a part of one."""

    mmph: float
    exposure_s: float
    """The whole exposure of an image, which decides which drops can be seen."""
    part_s: float
    """Length of the part."""
    after_s: float
    """From the time stamp of the image to the middle of the part."""
    camera_ned_mps: Array
    """Velocity of the camera, (3,)."""
    seed: int
    """Of the drops of an image."""


def number_per_m3_mm(diameter_mm: Array, mmph: float) -> Array:
    """Return drops per cubic metre and per millimetre of diameter (Marshall and Palmer 1948)."""
    number: Array = 8000.0 * np.exp(-4.1 * mmph**-0.21 * diameter_mm)
    return number


def fall_mps(diameter_mm: Array) -> Array:
    """Return the terminal speed of drops of 0.5 to 6 mm (Atlas, Srivastava and Sekhon 1973)."""
    speed_mps: Array = 9.65 - 10.3 * np.exp(-0.6 * diameter_mm)
    return speed_mps


def streaks(
    rain: Rain, wind_ne_mps: Array, rot_ned_face: Array, size_px: tuple[int, int], tangent: tuple[float, float]
) -> NDArray[float32]:
    """Return the corners of streaks, (S, 4, 7): x and y from -1 to 1 across the face, depth in metres, place across and
    along the streak and half of the length of its path, by half of its width, opacity in the middle.

    rot_ned_face: turns the axes of the face (x right, y down, z ahead) into NED. tangent: of half the view.
    """
    rng = default_rng(rain.seed)
    px_per_m = 0.5 * size_px[0] / tangent[0]  # at a depth of 1 m
    diameter_mm, depth_m = _drops(rng, rain, px_per_m, tangent)
    count = len(depth_m)
    aside = rng.uniform(-MARGIN, MARGIN, (count, 2)) * np.array(tangent) * depth_m[:, None]
    velocity = np.zeros((count, 3))
    velocity[:, :2], velocity[:, 2] = wind_ne_mps, fall_mps(diameter_mm)
    velocity = (velocity - rain.camera_ned_mps) @ rot_ned_face
    middle = np.column_stack([aside, depth_m]) + rain.after_s * velocity
    ends = np.stack([middle - 0.5 * rain.part_s * velocity, middle + 0.5 * rain.part_s * velocity])
    ahead = (ends[..., 2] > NEAREST_M).all(axis=0)
    ends, middle, diameter_m = ends[:, ahead], middle[ahead], 1e-3 * diameter_mm[ahead]
    # In pixels: the path of the middle, and half of the width
    first, last = px_per_m * ends[..., :2] / ends[..., 2:]
    path = last - first
    length = np.hypot(*path.T)
    along = np.where(length[:, None] > 1e-3, path, [0.0, 1.0])
    along /= np.hypot(*along.T)[:, None]
    across = np.column_stack([-along[:, 1], along[:, 0]])
    half = _half_px(diameter_m, middle[:, 2], px_per_m)
    opacity = _opacity(diameter_m, middle[:, 2], length, px_per_m)
    core = 0.5 * length / half
    corners = np.empty((len(half), 4, 7), float32)
    for corner, (end, sign, side) in enumerate(((first, -1, -1), (first, -1, 1), (last, 1, -1), (last, 1, 1))):
        place = end + half[:, None] * (sign * along + side * across)
        corners[:, corner, :2] = place / (0.5 * np.array(size_px))
        corners[:, corner, 3], corners[:, corner, 4] = side, sign * (core + 1.0)
    corners[..., 2], corners[..., 5], corners[..., 6] = middle[:, 2:], core[:, None], opacity[:, None]
    return corners


def _drops(rng: np.random.Generator, rain: Rain, px_per_m: float, tangent: tuple[float, float]) -> tuple[Array, Array]:
    """Return diameters (mm) and depths (m) of the drops that can be seen, (N,) each."""
    low, high = DIAMETER_EDGES_MM[:-1], DIAMETER_EDGES_MM[1:]
    size_mm = 0.5 * (low + high)
    depth_m = np.geomspace(NEAREST_M, FARTHEST_M, 64)
    path_px = px_per_m * fall_mps(size_mm)[:, None] * rain.exposure_s / depth_m
    seen = _opacity(1e-3 * size_mm[:, None], depth_m, path_px, px_per_m) > LEAST_OPACITY
    far_m = (seen * depth_m).max(axis=1)
    volume_m3 = 4.0 / 3.0 * MARGIN**2 * tangent[0] * tangent[1] * far_m**3
    counts = rng.poisson(number_per_m3_mm(size_mm, rain.mmph) * (high - low) * volume_m3)
    diameter_mm = rng.uniform(np.repeat(low, counts), np.repeat(high, counts))
    return diameter_mm, np.repeat(far_m, counts) * np.cbrt(rng.uniform(size=counts.sum()))


def _half_px(diameter_m: Array, depth_m: Array, px_per_m: float) -> Array:
    """Return half of the drawn width, with the blur of the lens and at least a pixel."""
    return np.maximum(px_per_m * (diameter_m + APERTURE_M) / depth_m, 1.0)


def _opacity(diameter_m: Array, depth_m: Array, path_px: Array, px_per_m: float) -> Array:
    """Return the opacity in the middle of a streak that falls to 0 at its edge, so that its sum is that of a disc."""
    area_px = 0.25 * math.pi * (px_per_m * diameter_m / depth_m) ** 2
    half = _half_px(diameter_m, depth_m, px_per_m)
    return np.minimum(area_px / (half * (path_px + math.pi / 3.0 * half)), 1.0)
