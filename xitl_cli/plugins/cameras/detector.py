"""Detectors of objects in colour images, and their score against the truth.

A package may add one: an entry point of the group `xitl.detectors` is a function `make(camera, lens)` that returns a
`Detector`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import cv2
import numpy as np
from numpy import float32, uint8
from numpy.typing import NDArray

from sim_core.sensors.camera_spec import CameraSpec
from sim_core.sensors.lens import Lens
from xitl_cli.plugins.cameras.images import Box, Detection, ObjectClass, SeenObject


class Detector(Protocol):
    """Finds objects in images."""

    def detect(self, image: NDArray[uint8]) -> Sequence[Detection]:
        """Return the objects in an image (H, W, 3), sRGB."""


SLICE_PX = 24
"""Width of the pieces into which the line of a boom is cut: a box around a slanting line would be mostly water."""
LEAST_PX = 24
"""Smallest area of an object."""
PITCHING_DEG = 4.0
SHORE_PX = 8
"""Rows below the horizon that may show a shore, far away."""
LEAST_RED, FEWEST_SPREADS = 5.0, 7.0
"""Of colour in CIELAB: orange over the water, and anything that differs from it."""


class ColourDetector:
    """Finds a boom by its orange floats, and other objects on the water by their colour.

    Water looks much the same along a row, so that the median and the spread of each band of rows describe it. Above
    the horizon nothing is reported. The method is classical and knows the colours of the simulated world: a start, and
    a measure for better ones.
    """

    def __init__(self, camera: CameraSpec, lens: Lens) -> None:
        # The horizon of a level vessel: the camera may look elsewhere by as much as the vessel pitches.
        level_row = lens.centre_px[1] + lens.focal_px * math.tan(math.radians(camera.pitch_deg))
        pitching_px = lens.focal_px * math.radians(PITCHING_DEG)
        self._highest_row = int(np.clip(level_row - pitching_px, 0, lens.height_px))
        self._open_row = int(np.clip(level_row + pitching_px + SHORE_PX, 0, lens.height_px))

    def detect(self, image: NDArray[uint8]) -> Sequence[Detection]:
        """Return the objects in an image: see Detector."""
        lab = cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), 1.0), cv2.COLOR_RGB2LAB).astype(float32)
        found = list(self._boom(lab))
        # The mirror image of a float is as high as the float, longer in waves.
        mirrored = [(left, top, right, bottom + 3.0 * (bottom - top)) for left, top, right, bottom in boxes_of(found)]
        found += self._afloat(lab, mirrored)
        return found

    def _boom(self, lab: NDArray[float32]) -> Sequence[Detection]:
        red = lab[..., 1] - np.median(lab[self._highest_row :, :, 1])
        # Fog takes the colour of everything alike, so that the reddest pixels below the horizon set the threshold.
        least = max(LEAST_RED, 0.5 * float(np.percentile(red[self._highest_row :], 99.5)))
        mask = red >= least
        mask[: self._highest_row] = False
        # The mirror image below a float is darker than the float.
        brightest = np.where(mask, lab[..., 0], 0.0).max(axis=0, keepdims=True)
        mask &= lab[..., 0] >= 0.8 * brightest
        # An opening by two by two pixels, whose second half has the opposite anchor, so that nothing moves
        square = np.ones((2, 2), uint8)
        orange = cv2.dilate(cv2.erode(mask.astype(uint8), square, anchor=(0, 0)), square, anchor=(1, 1))
        found = []
        for left in range(0, orange.shape[1], SLICE_PX):
            count, _, stats, _ = cv2.connectedComponentsWithStats(orange[:, left : left + SLICE_PX])
            if count < 2:
                continue
            # Smaller pieces of a slice are mirror images.
            x, y, width, height, area = max(stats[1:].tolist(), key=lambda one: one[4])
            if area >= LEAST_PX:
                box = left + x - 0.5, y - 0.5, left + x + width - 0.5, y + height - 0.5
                found.append(Detection(ObjectClass.BOOM.label, box, min(area / 200.0, 1.0)))
        return found

    def _afloat(self, lab: NDArray[float32], taken: Sequence[Box]) -> Sequence[Detection]:
        below = lab[self._open_row :, :, 1:]
        if len(below) < 20:
            return []
        middle = np.median(below, axis=1, keepdims=True)
        spread = 1.0 + 1.4826 * np.median(np.abs(below - middle), axis=1, keepdims=True)
        # By colour alone: waves and glitter differ from the water around them in brightness only.
        mask = (np.abs(below - middle) / spread).max(axis=2) > FEWEST_SPREADS
        joined = cv2.morphologyEx(mask.astype(uint8), cv2.MORPH_CLOSE, np.ones((5, 5), uint8))
        joined = cv2.morphologyEx(joined, cv2.MORPH_OPEN, np.ones((3, 3), uint8))
        count, _, stats, _ = cv2.connectedComponentsWithStats(joined)
        found = []
        for x, y, width, height, area in stats[1:count].tolist():
            box = x - 0.5, self._open_row + y - 0.5, x + width - 0.5, self._open_row + y + height - 0.5
            if area < LEAST_PX or y == 0 or width > 0.5 * lab.shape[1] or covered(box, taken) > 0.3:
                continue
            found.append(Detection(ObjectClass.DEBRIS.label, box, min(area / 400.0, 1.0)))
        return found


def boxes_of(detections: Sequence[Detection]) -> list[Box]:
    """Return the boxes of detections."""
    return [one.box_px for one in detections]


def covered(box: Box, others: Sequence[Box]) -> float:
    """Return the share of a box that other boxes cover, on a grid of pixels."""
    left, top, right, bottom = (round(edge + 0.5) for edge in box)
    grid = np.zeros((max(bottom - top, 1), max(right - left, 1)), bool)
    for other in others:
        first_x, first_y, last_x, last_y = (round(edge + 0.5) for edge in other)
        grid[max(first_y - top, 0) : max(last_y - top, 0), max(first_x - left, 0) : max(last_x - left, 0)] = True
    return float(grid.mean())


@dataclass(slots=True)
class ClassScore:
    """Detections and objects of one class over a run."""

    right: int = 0
    """Detections of which at least half is on objects of the class."""
    wrong: int = 0
    found: int = 0
    """Objects of which detections of the class cover at least half."""
    missed: int = 0

    def report(self) -> dict[str, Any]:
        """Return counts, precision and recall; None for a ratio without counts."""
        detections, objects = self.right + self.wrong, self.found + self.missed
        return {
            "detections": detections,
            "objects": objects,
            "precision": self.right / detections if detections else None,
            "recall": self.found / objects if objects else None,
        }


SCORED = (ObjectClass.BOOM, ObjectClass.VESSEL, ObjectClass.DEBRIS, ObjectClass.BUOY)
FEWEST_PX = 60
"""Objects with fewer visible pixels are not counted as missed."""
ENOUGH = 0.5


@dataclass(slots=True)
class DetectorScore:
    """Precision and recall of a detector, by class."""

    classes: dict[str, ClassScore] = field(default_factory=dict)

    def add(self, detections: Sequence[Detection], objects: Sequence[SeenObject]) -> None:
        """Count the detections and the objects of one image."""
        for kind in SCORED:
            ours = [one.box_px for one in detections if one.label == kind.label]
            theirs = [one for one in objects if one.kind is kind]
            if not ours and not theirs:
                continue
            score = self.classes.setdefault(kind.label, ClassScore())
            boxes = [one.box_px for one in theirs]
            for box in ours:
                if covered(box, boxes) >= ENOUGH:
                    score.right += 1
                else:
                    score.wrong += 1
            for seen in theirs:
                if seen.pixels >= FEWEST_PX:
                    if covered(seen.box_px, ours) >= ENOUGH:
                        score.found += 1
                    else:
                        score.missed += 1

    def report(self) -> dict[str, Any]:
        """Return the scores by class."""
        return {name: score.report() for name, score in sorted(self.classes.items())}
