"""Detectors of objects in colour images, and their score against the truth.

A package may add one: an entry point of the group `xitl.detectors` is a function `make(camera, lens)` that returns a
`Detector`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import field
from typing import Any, Protocol

import cv2
import numpy as np
from numpy import float32, uint8
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.sensors.camera_spec import CameraSpec
from sim_core.sensors.lens import Lens
from xitl_cli.plugins.cameras.images import Box, Detection, ObjectClass, SeenObject


class Detector(Protocol):
    """Finds objects in images.

    It may also have `find_horizon(image)`, which returns the rows of the horizon at the first and the last column, or
    None.
    """

    def detect(self, image: NDArray[uint8]) -> Sequence[Detection]:
        """Return the objects in an image (H, W, 3), sRGB."""


SLICE_PX = 24
"""Width of the pieces into which the line of a boom is cut: a box around a slanting line would be mostly water."""
LEAST_PX = 24
"""Smallest area of an object."""
PITCHING_DEG, ROLLING_DEG, USUAL_DEG = 5.0, 6.0, 2.5
"""By which a camera may look higher or lower than on a level vessel, by which its horizon may slant, and the standard
deviation of the first."""
LEAST_RED, FEWEST_SPREADS = 5.0, 7.0
"""Of colour in CIELAB: orange over the water, and anything that differs from it."""
EDGE_PX, LEAST_EDGE = 4, 1.5
"""Of the horizon: rows on either side that are compared, and the least mean root of their difference."""
SKY_PX, SKY_CHANGE, SKY_SHARE = ((3, 8), (16, 40)), 4.0, 0.7
"""Of the sky above a horizon: rows above the line that are compared, the least change of colour by which they are not
both sky, and the share of columns with sky."""
WATER_PX, WATER_SPREAD = (4, 40), 3.8
"""Of the water below a horizon: rows below the line, and the least standard deviation of their lightness. A wall has
less."""
SHORE_PX = 3
"""Rows below the horizon that may show a shore, far away."""
HAZY = 85.0
"""Lightness of the darkest hundredth of an image in fog, at least, in OpenCV's CIELAB."""
FOG_BLUR_PX, FOG_SPREAD, FOG_SPREADS = 1.5, 0.3, 3.0
"""In fog: blur, least spread of the red of a row, and by how many spreads an object differs."""
FOG_LEAST_PX, FOG_SLIM = 40, 3.0
"""In fog: smallest area, and how much longer than wide a buoy may be."""
FOG_ORANGE = (1.7, 3.75), (0.4, 0.65)
"""In fog: the red that is left of an object, and the least ratio of yellow to red of floats for it."""
MIRROR_SHARE, FLOAT_SHARE = 0.85, 0.7
"""Brightness of a mirror image, relative to its object, at most, and least redness of a float, relative to its reddest
pixel in the same column."""
LARGEST_M = {ObjectClass.VESSEL: (20.0, 8.0), ObjectClass.BUOY: (3.0, 6.0), ObjectClass.DEBRIS: (12.0, 1.5)}
"""Width and height of the largest object of each class."""
HULL_M, FARTHEST_M, FARTHEST_BOAT_M = 1.2, 60.0, 100.0
"""Width of the narrowest boat. Farther objects are a few pixels, next to the mirror image of the shore."""
MOST_FILLED = 0.4
"""Share of a row that a boom may fill where other objects are searched by their difference from the row."""
WATERLINE_M = 0.15
"""From the body's origin down to the water: a usual value for small boats."""


class ColourDetector:
    """Finds the horizon, a boom by its orange floats, and other objects on the water by their colour.

    Water looks much the same along a row, so that the median and the spread of each row describe it. Mirror images are
    darker than their objects and below them. The row of its waterline gives the distance of an object, and so its size.
    Bright colours are buoys, wide white objects are boats, and everything else is debris. In fog, it finds a boom and
    buoys that are redder or greener than the water. The method is classical and knows the colours of the simulated
    world: a start, and a measure for better ones.
    """

    def __init__(self, camera: CameraSpec, lens: Lens) -> None:
        # The horizon of a level vessel: the camera may look elsewhere by as much as the vessel pitches.
        self._focal_px = lens.focal_px
        self._level_row = lens.centre_px[1] + lens.focal_px * math.tan(math.radians(camera.pitch_deg))
        pitching_px = lens.focal_px * math.radians(PITCHING_DEG)
        self._highest_row = int(np.clip(self._level_row - pitching_px, 0, lens.height_px))
        self._lowest_row = int(np.clip(self._level_row + pitching_px, 0, lens.height_px))
        self._height_m = max(-camera.position_frd_m[2] + WATERLINE_M, 0.2)

    def detect(self, image: NDArray[uint8]) -> Sequence[Detection]:
        """Return the objects in an image: see Detector."""
        if self._highest_row >= len(image):
            return []  # the camera looks above the water
        lab = _lab(image)
        if self._is_hazy(lab):
            return self._in_fog(image)
        found = self._boom(lab)
        horizon = self._horizon(lab) or (self._level_row, self._level_row)
        return [*found, *self._afloat(lab, horizon, boxes_of(found))]

    def find_horizon(self, image: NDArray[uint8]) -> tuple[float, float] | None:
        """Return the rows of the horizon at the first and the last column.

        None where no line is clear, where land is above it, as a shore is lower than the horizon, and where it is the
        top of a wall.
        """
        lab = _lab(image)
        line = None if self._is_hazy(lab) else self._horizon(lab)
        return line if line is not None and self._is_between_sky_and_water(lab, line) else None

    def _is_hazy(self, lab: NDArray[float32]) -> bool:
        """Return whether even the darkest parts of the image are bright (He, Sun and Tang 2009)."""
        return float(np.percentile(lab[::4, ::4, 0], 1.0)) > HAZY

    def _in_fog(self, image: NDArray[uint8]) -> Sequence[Detection]:
        """Return the objects whose red or green differs from the water in the same row, in an image without contrast.

        The ratio of yellow to red tells a float from a red buoy. Fog takes the yellow of an object first.
        """
        smooth = cv2.GaussianBlur(image.astype(float32) / float32(255.0), (0, 0), FOG_BLUR_PX)
        below = cv2.cvtColor(smooth, cv2.COLOR_RGB2LAB)[..., 1:]
        below[: self._highest_row] = 0.0
        off = below - np.median(below, axis=1, keepdims=True)
        red = off[..., 0]
        least = FOG_SPREADS * np.maximum(1.4826 * np.median(np.abs(red), axis=1, keepdims=True), FOG_SPREAD)
        found, boom = [], np.zeros(red.shape, bool)
        for mask in (red > least, red < -least):
            count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(uint8))
            for number, (x, y, width, height, area) in enumerate(stats[1:count].tolist(), start=1):
                if area < FOG_LEAST_PX:
                    continue
                where = slice(y, y + height), slice(x, x + width)
                part = labels[where] == number
                redness, yellowness = np.median(off[where][part], axis=0).tolist()
                if redness > 0.0 and yellowness > np.interp(redness, *FOG_ORANGE) * redness:
                    boom[where] |= part
                elif width < FOG_SLIM * height and height < FOG_SLIM * width:
                    box = x - 0.5, y - 0.5, x + width - 0.5, y + height - 0.5
                    found.append(Detection(ObjectClass.BUOY.label, box, min(area / 400.0, 1.0)))
        return [*_floats(boom, red), *found]

    def _horizon(self, lab: NDArray[float32]) -> tuple[float, float] | None:
        """Return the straight line across which most columns change their colour."""
        rows, columns = lab.shape[:2]
        first = max(self._highest_row, EDGE_PX)
        last = min(self._lowest_row, rows - EDGE_PX)
        if last - first < 2 * EDGE_PX:
            return None
        across = np.arange(2, columns, 4)
        sums = np.concatenate([np.zeros((1, len(across), 3), float32), np.cumsum(lab[:, across], axis=0)])
        row = np.arange(first, last)
        above, below = sums[row] - sums[row - EDGE_PX], sums[row + EDGE_PX] - sums[row]
        # The root: many columns with a weak edge count more than few with a strong one.
        edge = np.sqrt(np.linalg.norm(above - below, axis=2) / EDGE_PX)
        # The horizon is above the floats of a boom, which are lower than the camera.
        red, yellow = lab[:, across, 1] - 128.0, lab[:, across, 2] - 128.0
        floats = np.logical_or.accumulate((red > 0.5 * VIVID) & (np.hypot(red, yellow) > VIVID), axis=0)
        edge[floats[row + EDGE_PX]] = 0.0
        offset = across - 0.5 * (columns - 1)
        off_deg = np.degrees((row - self._level_row) / self._focal_px)
        usual = np.exp(-0.5 * (off_deg / USUAL_DEG) ** 2)
        best = LEAST_EDGE, 0.0, 0.0
        for slope in np.tan(np.radians(np.arange(-ROLLING_DEG, ROLLING_DEG + 0.1, 0.5))):
            shifted = np.arange(len(row))[:, None] + np.rint(slope * offset).astype(int)
            inside = (shifted >= 0) & (shifted < len(row))
            on_line = np.take_along_axis(edge, np.clip(shifted, 0, len(row) - 1), axis=0) * inside
            strength = on_line.mean(axis=1) * usual * math.exp(-0.5 * (slope / math.radians(ROLLING_DEG)) ** 2)
            number = int(strength.argmax())
            if strength[number] > best[0]:
                best = float(strength[number]), float(row[number]) - 0.5, float(slope)
        strength, middle, slope = best
        if strength <= LEAST_EDGE:
            return None
        half = 0.5 * slope * (columns - 1)
        return middle - half, middle + half

    def _is_between_sky_and_water(self, lab: NDArray[float32], line: tuple[float, float]) -> bool:
        rows, columns = lab.shape[:2]
        across = np.arange(2, columns, 4)
        on_line = np.rint(np.linspace(*line, columns)[across]).astype(int)

        def below(first: int, last: int) -> NDArray[float32]:
            return lab[np.clip(on_line + np.arange(first, last)[:, None], 0, rows - 1), across]

        near, far = (below(-last, -first).mean(axis=0) for first, last in SKY_PX)
        is_sky = np.mean(np.linalg.norm(near - far, axis=1) < SKY_CHANGE) >= SKY_SHARE
        return bool(is_sky and np.median(below(*WATER_PX)[..., 0].std(axis=0)) > WATER_SPREAD)

    def _boom(self, lab: NDArray[float32]) -> list[Detection]:
        red = lab[..., 1] - np.median(lab[self._highest_row :, :, 1])
        # Fog takes the colour of everything alike, so that the reddest pixels below the horizon set the threshold.
        least = max(LEAST_RED, 0.5 * float(np.percentile(red[self._highest_row :], 99.5)))
        mask = red >= least
        mask[: self._highest_row] = False
        # Floats are orange: a red buoy is less yellow than red.
        mask &= lab[..., 2] - 128.0 > ORANGE * (lab[..., 1] - 128.0)
        return list(_floats(mask, red))

    def _afloat(self, lab: NDArray[float32], horizon: tuple[float, float], boom: Sequence[Box]) -> Sequence[Detection]:
        rows, columns = lab.shape[:2]
        line = np.linspace(*horizon, columns)
        open_row = int(np.clip(min(horizon) + SHORE_PX, 0, rows))
        if rows - open_row < 20:
            return []
        below = np.arange(rows)[:, None] >= line + SHORE_PX
        polar = cv2.cartToPolar(lab[..., 1] - 128.0, lab[..., 2] - 128.0, angleInDegrees=True)
        chroma, hue_deg = (np.asarray(part, float32) for part in polar)
        vivid = (chroma > VIVID) & (np.arange(rows)[:, None] >= line - HIGHEST_PX)
        paints = [vivid & _is_between(hue_deg, low, high) for low, high in HUES_DEG]
        lightness = lab[..., 0]
        bright = np.maximum(BRIGHT, BRIGHTER * np.median(lightness, axis=1, keepdims=True))
        pale = (chroma < PALE) & (lightness > bright) & below
        # Where a boom fills half of a row, the median of the row is not the water.
        filled = np.zeros(rows)
        for left, top, right, bottom in boom:
            filled[round(top + 0.5) : round(bottom + 0.5)] += (right - left) / columns
        differs = below & self._differs(lab, open_row) & (filled < MOST_FILLED)[:, None]
        # The mirror image of a float is as high as the float, longer in waves. No paint looks like it.
        mirrored = [(left, top, right, bottom + 3.0 * (bottom - top)) for left, top, right, bottom in boom]
        masks = [
            *((paint, chroma, boom) for paint in paints),
            (pale, lightness, mirrored),
            (differs, lightness, mirrored),
        ]
        found: list[Detection] = []
        shadowed: list[Box] = []
        for mask, strength, taken in masks:
            for box, colour in _objects(lab, mask, strength, [*taken, *shadowed]):
                horizon_row = float(line[int(np.clip(0.5 * (box[0] + box[2]), 0, columns - 1))])
                waterline_px = box[3] - horizon_row
                if waterline_px < self._height_m * self._focal_px / FARTHEST_BOAT_M:
                    continue
                metres = self._height_m / waterline_px  # of a pixel at the object
                width_m, height_m = (box[2] - box[0]) * metres, (box[3] - box[1]) * metres
                kind = _class_of(colour, width_m)
                if kind is not ObjectClass.VESSEL and waterline_px < self._height_m * self._focal_px / FARTHEST_M:
                    continue
                if kind is ObjectClass.VESSEL and box[1] > horizon_row - 1.0:
                    continue  # a boat is higher than the camera, and sky in the water is below the horizon
                if kind is None or width_m > LARGEST_M[kind][0] or height_m > LARGEST_M[kind][1]:
                    continue
                found.append(Detection(kind.label, box, min((box[2] - box[0]) * (box[3] - box[1]) / 400.0, 1.0)))
                left, top, right, bottom = box
                shadowed.append((left - 2.0, top, right + 2.0, bottom + 1.5 * (bottom - top)))
        return found

    def _differs(self, lab: NDArray[float32], open_row: int) -> NDArray[np.bool_]:
        """Return the pixels (H, W) that differ from the water around them.

        By colour alone: waves and glitter differ in brightness only.
        """
        below = lab[open_row:, :, 1:]
        middle = np.median(below, axis=1, keepdims=True)
        spread = 1.0 + 1.4826 * np.median(np.abs(below - middle), axis=1, keepdims=True)
        mask = np.zeros(lab.shape[:2], bool)
        mask[open_row:] = (np.abs(below - middle) / spread).max(axis=2) > FEWEST_SPREADS
        return mask


ORANGE = 0.95
"""Least ratio of yellow to red of the floats of a boom."""
VIVID, PALE, BRIGHT, BRIGHTER = 28.0, 14.0, 150.0, 1.3
"""In OpenCV's CIELAB: chroma of paint, and of white; lightness of white, also as a multiple of the water's in its row.
"""
HUES_DEG = (320.0, 45.0), (70.0, 101.0), (135.0, 200.0), (200.0, 320.0)
"""Of red, yellow, green and blue paint. Grass and leaves are between yellow and green."""
SIMILAR, HIGHEST_SHARE, HIGHEST_PX = 22.0, 1.0, 80.0
"""Largest difference of colour within an object; how much higher than wide it may be; how far above the horizon."""


def _floats(mask: NDArray[np.bool_], red: NDArray[float32]) -> Iterator[Detection]:
    """Yield the floats of a boom in an orange mask (H, W), in slices and without their mirror images."""
    # The mirror image below a float is paler than the float, because water reflects the sky too.
    deepest = np.where(mask, red, 0.0).max(axis=0, keepdims=True)
    mask = mask & (red >= FLOAT_SHARE * deepest)
    # An opening by two by two pixels, whose second half has the opposite anchor, so that nothing moves
    square = np.ones((2, 2), uint8)
    orange = cv2.dilate(cv2.erode(mask.astype(uint8), square, anchor=(0, 0)), square, anchor=(1, 1))
    for left in range(0, orange.shape[1], SLICE_PX):
        piece = orange[:, left : left + SLICE_PX]
        if not piece.any():
            continue
        _, _, stats, _ = cv2.connectedComponentsWithStats(piece)
        # Smaller pieces of a slice are mirror images.
        x, y, width, height, area = max(stats[1:].tolist(), key=lambda one: one[4])
        if area >= LEAST_PX:
            box = left + x - 0.5, y - 0.5, left + x + width - 0.5, y + height - 0.5
            yield Detection(ObjectClass.BOOM.label, box, min(area / 200.0, 1.0))


def _is_between(hue_deg: Any, low_deg: float, high_deg: float) -> Any:
    """Return whether hues from 0 to 360 are between two others, clockwise from the first."""
    above, below = hue_deg >= low_deg, hue_deg < high_deg
    return above & below if low_deg < high_deg else above | below


def _lab(image: NDArray[uint8]) -> NDArray[float32]:
    return cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), 1.0), cv2.COLOR_RGB2LAB).astype(float32)


def _objects(
    lab: NDArray[float32], mask: NDArray[np.bool_], strength: NDArray[float32], taken: Sequence[Box]
) -> Iterator[tuple[Box, NDArray[float32]]]:
    """Yield box and colour of each connected part of a mask (H, W), without its mirror image.

    strength: (H, W), less in a mirror image than in its object. taken: boxes of other objects.
    """
    if not mask.any():
        return
    joined = cv2.morphologyEx(mask.astype(uint8), cv2.MORPH_CLOSE, np.ones((3, 3), uint8))
    joined = cv2.morphologyEx(joined, cv2.MORPH_OPEN, np.ones((2, 3), uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(joined)
    for number, (x, y, width, height, area) in enumerate(stats[1:count].tolist(), start=1):
        if area < LEAST_PX or width > 0.5 * mask.shape[1]:
            continue
        where = slice(y, y + height), slice(x, x + width)
        part = labels[where] == number
        height = _without_mirror(strength[where], part)
        colour = np.median(lab[where][:height][part[:height]], axis=0)
        top = _upward(lab, colour, x, y, width)
        box = x - 0.5, top - 0.5, x + width - 0.5, y + height - 0.5
        if np.count_nonzero(part[:height]) >= LEAST_PX and covered(box, taken) <= 0.3:
            yield box, colour


def _without_mirror(strength: NDArray[float32], part: NDArray[np.bool_]) -> int:
    """Return the rows of an object without its mirror image: the weaker lower part of a split as by Otsu 1979."""
    counts, sums = part.sum(axis=1), np.where(part, strength, 0.0).sum(axis=1)
    above, total = np.cumsum(counts)[:-1], np.cumsum(sums)[:-1]
    below = counts.sum() - above
    upper, lower = total / np.maximum(above, 1), (sums.sum() - total) / np.maximum(below, 1)
    between = np.where(lower < MIRROR_SHARE * upper, above * below * (upper - lower) ** 2, 0.0)
    between[: len(part) // 3] = 0.0
    return int(between.argmax()) + 1 if len(between) and between.max() > 0.0 else len(part)


def _upward(lab: NDArray[float32], colour: NDArray[float32], x: int, y: int, width: int) -> int:
    """Return the top row of an object that rises from row y with this colour."""
    inner = slice(x + width // 4, x + 3 * width // 4)
    top = y
    while top > 0 and y - top < HIGHEST_SHARE * width:
        if np.median(np.linalg.norm(lab[top - 1, inner] - colour, axis=1)) > SIMILAR:
            break
        top -= 1
    return top


def _class_of(colour: NDArray[float32], width_m: float) -> ObjectClass | None:
    """Return the class of an object by its colour and width. Blue plastic and green plants are debris.

    Small and pale is the sky in the water, or a white buoy: None.
    """
    lightness, red, yellow = (colour - (0.0, 128.0, 128.0)).tolist()
    chroma, hue_deg = math.hypot(red, yellow), math.degrees(math.atan2(yellow, red)) % 360.0
    if lightness > BRIGHT and chroma < PALE:
        return ObjectClass.VESSEL if width_m > HULL_M else None
    painted = any(_is_between(np.float32(hue_deg), low, high) for low, high in HUES_DEG[:-1])
    return ObjectClass.BUOY if chroma > VIVID and painted else ObjectClass.DEBRIS


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


SCORED = (ObjectClass.BOOM, ObjectClass.VESSEL, ObjectClass.DEBRIS, ObjectClass.BUOY)
FEWEST_PX = 8**2
"""Objects with fewer visible pixels are not counted as missed."""
ENOUGH = 0.5
AREAS_PX = {"tiny": 16**2, "small": 32**2, "medium": 96**2, "large": math.inf}
"""Visible pixels below which an object is of a size. The last three are those of COCO; tiny is of AI-TOD (Wang et al.
2021, "Tiny Object Detection in Aerial Images")."""
RANGES_M = {"to 15 m": 15.0, "to 30 m": 30.0, "to 60 m": 60.0, "beyond 60 m": math.inf}


@dataclass(slots=True)
class Recall:
    """Objects of a kind, and how many of them were found."""

    objects: int = 0
    found: int = 0
    """Detections of the class cover at least half of the object."""

    def report(self) -> dict[str, Any]:
        """Return the number of objects and the recall; None without objects."""
        return {"objects": self.objects, "recall": self.found / self.objects if self.objects else None}


@dataclass(slots=True)
class ClassScore:
    """Detections and objects of one class over a run."""

    right: int = 0
    """Detections of which at least half is on objects of the class."""
    wrong: int = 0
    all: Recall = field(default_factory=Recall)
    by_area: dict[str, Recall] = field(default_factory=lambda: {name: Recall() for name in AREAS_PX})
    by_range: dict[str, Recall] = field(default_factory=lambda: {name: Recall() for name in RANGES_M})

    def add_object(self, seen: SeenObject, found: bool) -> None:
        """Count an object of the truth."""
        area = next(name for name, most_px in AREAS_PX.items() if seen.pixels < most_px)
        distance = next(name for name, most_m in RANGES_M.items() if seen.distance_m < most_m)
        for recall in (self.all, self.by_area[area], self.by_range[distance]):
            recall.objects += 1
            recall.found += found

    def report(self) -> dict[str, Any]:
        """Return counts, precision and recall, and the recall by size and by range; None for a ratio without counts."""
        detections = self.right + self.wrong
        return {
            "detections": detections,
            **self.all.report(),
            "precision": self.right / detections if detections else None,
            **{
                name: {key: recall.report() for key, recall in parts.items() if recall.objects}
                for name, parts in (("by_area", self.by_area), ("by_range", self.by_range))
            },
        }


@dataclass(slots=True)
class HorizonScore:
    """Rows of the horizon at the first and the last column against the truth."""

    images: int = 0
    """Images with a true horizon."""
    found: int = 0
    squares_px2: float = 0.0

    def add(self, found: tuple[float, float] | None, truth: tuple[float, float] | None) -> None:
        """Count an image."""
        if truth is None:
            return
        self.images += 1
        if found is not None:
            self.found += 1
            self.squares_px2 += 0.5 * sum((row - true) ** 2 for row, true in zip(found, truth, strict=True))

    def report(self) -> dict[str, Any]:
        """Return counts and the RMS error in pixels; None without a horizon."""
        rms_px = math.sqrt(self.squares_px2 / self.found) if self.found else None
        return {"images": self.images, "found": self.found, "rms_px": rms_px}


@dataclass(slots=True)
class DetectorScore:
    """Precision and recall of a detector, by class, and its error of the horizon."""

    classes: dict[str, ClassScore] = field(default_factory=dict)
    horizon: HorizonScore = field(default_factory=HorizonScore)

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
                    score.add_object(seen, covered(seen.box_px, ours) >= ENOUGH)

    def report(self) -> dict[str, Any]:
        """Return the scores by class, and of the horizon if it was found once."""
        scores = {name: score.report() for name, score in sorted(self.classes.items())}
        return scores | ({"horizon": self.horizon.report()} if self.horizon.found else {})
