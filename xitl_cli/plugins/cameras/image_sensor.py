"""From drawn pictures to the image of a sensor behind a lens: distortion, vignetting and noise.

A renderer draws planes. An ideal pinhole needs one plane that is the image. Other lenses need one larger plane, or the
faces of a cube, from which OpenCV's `remap` takes the pixels.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy import float32, uint8
from numpy.random import default_rng
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.sensors.lens import Lens

MOST_BENT_DEG = 75.0
"""Half of the widest view that is drawn as one plane. Wider lenses are drawn as the faces of a cube."""
GRAIN_PX = 512
GRAIN_STEPS = 32
"""Of the pattern of noise in one standard deviation."""


@dataclass(frozen=True, slots=True)
class ImageResponse:
    """From light to the values of an image."""

    exposure: float = 1.0
    vignetting: float = 0.0
    read_noise: float = 0.0
    shot_noise: float = 0.0
    grain_at: tuple[int, int] = (0, 0)
    """Where the noise of this image begins in the pattern of the sensor, drawn at random for each image."""


@dataclass(frozen=True, slots=True, eq=False)
class FacePixels:
    """The N pixels of an image that look at a face, and where."""

    here: NDArray[np.bool_]
    """(H, W) whether a pixel looks at this face."""
    maps: tuple[Any, Any]
    """Places in the face, as OpenCV's fixed-point maps, (H, W)."""
    nearest: tuple[NDArray[np.intp], NDArray[np.intp]]
    """Row and column of the nearest pixel of the face, (N,) each."""
    depth: Array
    """Depth along the axis of the camera for a depth of 1 along the axis of the face, (N,)."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewFace:
    """A plane on which a part of the view is drawn."""

    rot_optical_face: Array
    """Turns the axes of the face into those of the camera, (3, 3)."""
    size_px: tuple[int, int]
    tangent: tuple[float, float]
    """Of half the view, to the right and down."""
    pixels: FacePixels | None
    """None: the face is the image."""

    def seen(self, picture: NDArray[uint8], rows: tuple[int, int], image: NDArray[uint8]) -> None:
        """Write the pixels that look at this face into some rows of an image.

        picture: the face, (h, w, 3); of an image that is the face, only its rows.
        """
        part = slice(*rows)
        if self.pixels is None:
            image[part] = picture
            return
        first, second = self.pixels.maps
        shown = cv2.remap(picture, first[part], second[part], cv2.INTER_LINEAR)
        np.copyto(image[part], shown, where=self.pixels.here[part, :, None])


def faces_of(lens: Lens) -> tuple[ViewFace, ...]:
    """Return the planes that together show what a lens sees."""
    if lens.is_ideal:
        tangent = 0.5 * lens.width_px / lens.focal_px, 0.5 * lens.height_px / lens.focal_px
        return (ViewFace(np.eye(3), (lens.width_px, lens.height_px), tangent, None),)
    directions = lens.all_directions()
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(directions).all(axis=-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = directions[..., 2] > math.cos(math.radians(MOST_BENT_DEG))
        plane = np.abs(directions[..., :2] / directions[..., 2:])
    if bool(ahead[seen].all()):  # one plane, as fine in its middle as the image
        tangent = float(plane[seen][:, 0].max() * 1.01), float(plane[seen][:, 1].max() * 1.01)
        size = math.ceil(2 * tangent[0] * lens.focal_px), math.ceil(2 * tangent[1] * lens.focal_px)
        shrink = min(1.0, 2.0 * lens.width_px / size[0], 2.0 * lens.height_px / size[1])
        size = round(size[0] * shrink), round(size[1] * shrink)
        return (_face(directions, seen, np.eye(3), size, tangent),)
    x, y, z = np.eye(3)
    turns = [(x, y, z), (-z, y, x), (z, y, -x), (x, -z, y), (x, z, -y), (-x, y, -z)]
    side = math.ceil(2.0 * lens.focal_px)
    largest = np.abs(np.where(seen[..., None], directions, 0.0)).max(axis=-1)
    faces, left = [], seen.copy()
    for axes in turns:
        rotation = np.column_stack(axes)
        along = np.where(seen, directions @ rotation[:, 2], 0.0)
        here = left & (along >= largest - 1e-12)
        left &= ~here
        if here.any():
            faces.append(_face(directions, here, rotation, (side, side), (1.0, 1.0)))
    return tuple(faces)


def _face(
    directions: Array, here: NDArray[np.bool_], rotation: Array, size: tuple[int, int], tangent: tuple[float, float]
) -> ViewFace:
    local = directions[here] @ rotation
    places = (0.5 + 0.5 * local[:, :2] / local[:, 2:] / np.array(tangent)) * np.array(size)
    column, row = np.clip(places.astype(np.intp), 0, np.array(size) - 1).T
    centres = np.zeros((*here.shape, 2), float32)  # the centre of the first pixel is at 0, 0
    centres[here] = np.clip(places - 0.5, 0.0, np.array(size) - 1)
    maps = cv2.convertMaps(centres[..., 0], centres[..., 1], cv2.CV_16SC2)
    depth = directions[here][:, 2] / local[:, 2]
    return ViewFace(rotation, size, tangent, FacePixels(here, maps, (row, column), depth))


class ImageSensor:
    """Adds vignetting and noise to images of one size."""

    def __init__(self, width_px: int, height_px: int) -> None:
        rng = default_rng(1)  # the same pattern in all runs
        column, row = np.arange(width_px) + 0.5 - 0.5 * width_px, np.arange(height_px) + 0.5 - 0.5 * height_px
        self._off = (column**2 + row[:, None] ** 2) / (0.25 * (width_px**2 + height_px**2))
        """Square of the distance from the middle; 1 in the corners."""
        pattern = np.rint(GRAIN_STEPS * rng.standard_normal((GRAIN_PX, GRAIN_PX, 3))).clip(-127, 127).astype(np.int16)
        repeats = -(-height_px // GRAIN_PX) + 1, -(-width_px // GRAIN_PX) + 1, 1
        self._grain = np.tile(pattern, repeats)

    def expose(self, image: NDArray[uint8], response: ImageResponse) -> NDArray[uint8]:
        """Return an image (H, W, 3) of this sensor. image: without vignetting and noise."""
        if response.vignetting > 0.0:  # values are nearly the roots of light
            gain = np.sqrt(1.0 - response.vignetting * self._off).astype(float32)
            image = np.rint(image * gain[..., None]).astype(uint8)
        if response.read_noise or response.shot_noise:
            image = self._noisy(image, response)
        return image

    def _noisy(self, image: NDArray[uint8], response: ImageResponse) -> NDArray[uint8]:
        """Add noise of a deviation by value, in integers: a table of the deviation times the pattern."""
        deviation = 255.0 * np.sqrt(response.read_noise**2 + response.shot_noise**2 * np.arange(256) / 255.0)
        shift = math.floor(math.log2((32767 - 256) / (127.0 * deviation.max())))  # the product has 16 bits
        table = np.rint(deviation * 2.0**shift).astype(np.int16)
        column, row = response.grain_at
        height, width = image.shape[:2]
        grain = self._grain[row % GRAIN_PX :][:height, column % GRAIN_PX :][:, :width]
        added: NDArray[np.int16] = np.asarray(cv2.LUT(image, table), np.int16)
        added *= grain
        bits = shift + round(math.log2(GRAIN_STEPS))
        added += 1 << (bits - 1)
        added >>= bits
        return np.asarray(cv2.add(image, added, dtype=cv2.CV_8U), uint8)
