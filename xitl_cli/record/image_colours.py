"""Colours for images without colour: depth and temperature, as recorded on the topics of cameras."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from sim_core.frames import Array

Picture = NDArray[np.uint8]
"""(H, W, 3), sRGB."""

NEAREST_M, FARTHEST_M = 0.5, 500.0
"""Ends of the scale of depth, which is logarithmic."""
LEAST_SPAN = 500
"""Smallest span of the scale of temperature, in 0.01 K. An image without contrast therefore shows no noise."""
_KEYS = np.array([[0, 0, 4], [66, 10, 104], [147, 38, 103], [221, 81, 58], [252, 165, 10], [252, 255, 164]])
"""Six points of a scale from black over red to yellow, whose brightness increases evenly."""


def coloured_depth(depth_m: NDArray[np.float32]) -> Picture:
    """Return the picture of a depth image (H, W), near is bright. Infinite depth and NaN are black."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.log(FARTHEST_M / depth_m) / np.log(FARTHEST_M / NEAREST_M)
    return _scaled(np.nan_to_num(share, nan=0.0, posinf=1.0, neginf=0.0))


def coloured_temperature(temperature: NDArray[np.uint16]) -> Picture:
    """Return the picture of a thermal image (H, W), scaled from its first to its last percentile."""
    low, high = np.percentile(temperature, (1.0, 99.0)).tolist()
    middle, half = 0.5 * (low + high), 0.5 * max(high - low, LEAST_SPAN)
    return _scaled((temperature - (middle - half)) / (2.0 * half))


def picture_of_file(data: bytes) -> Picture:
    """Return the picture in a JPEG or PNG of a recorded image. Raises OSError for a damaged file.

    A PNG of 16 bits has temperatures. The PNG of a segmentation image has a palette.
    """
    from PIL import Image

    with Image.open(BytesIO(data)) as image:
        if image.mode.startswith("I"):
            return coloured_temperature(np.asarray(image).astype(np.uint16))
        return np.asarray(image.convert("RGB"))


def _scaled(share: Array) -> Picture:
    at = np.clip(share, 0.0, 1.0) * (len(_KEYS) - 1)
    channels = [np.interp(at, np.arange(len(_KEYS)), key) for key in _KEYS.T]
    return np.stack(channels, axis=-1).astype(np.uint8)
