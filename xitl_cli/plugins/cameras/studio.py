"""Takes images: draws what a camera sees, encodes it, and measures its ground truth.

A run sends `Commission`s to a studio in another process, so that drawing has a processor of its own.
"""

from __future__ import annotations

import io
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy import float32, uint8, uint16
from numpy.typing import NDArray

from sim_core import frames
from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.sensors.camera_spec import CameraSpec
from sim_core.sensors.lens import Lens
from xitl_cli.plugins.cameras.detector import Detector
from xitl_cli.plugins.cameras.image_sensor import ImageResponse, ImageSensor
from xitl_cli.plugins.cameras.images import CameraImage, ObjectClass, SeenObject
from xitl_cli.plugins.cameras.models import TriangleModel, WorldObject
from xitl_cli.plugins.cameras.renderer import SEA_ID, SKY_ID, Renderer, Shot
from xitl_cli.registry import DETECTORS, guarded, load

THERMAL_NOISE_C = 0.05
KELVIN = 273.15
PALETTE = {
    ObjectClass.SKY: (135, 180, 230),
    ObjectClass.WATER: (30, 70, 120),
    ObjectClass.GROUND: (150, 120, 80),
    ObjectClass.VEGETATION: (50, 130, 50),
    ObjectClass.ROCK: (110, 105, 100),
    ObjectClass.DAM: (170, 170, 170),
    ObjectClass.BOOM: (240, 120, 20),
    ObjectClass.BUILDING: (210, 200, 180),
    ObjectClass.VESSEL: (220, 40, 40),
    ObjectClass.DEBRIS: (120, 60, 20),
    ObjectClass.BUOY: (250, 220, 40),
    ObjectClass.OTHER: (160, 60, 200),
    ObjectClass.OWN_VESSEL: (90, 90, 90),
}
"""Colours of segmentation images: their PNG has the class as value and these as its palette."""


@dataclass(frozen=True, slots=True, eq=False)
class Commission:
    """An image to take."""

    camera: str
    number: int
    stamp_ns: int
    shots: tuple[Shot, ...]
    """One, or several whose mean is the image: exposures within its time, each with its rows."""
    middle: Shot
    """At the time stamp, for ground truth, depth, segmentation and thermal images."""
    response: ImageResponse
    noise_seed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """An image before its noise, its truth and its encoding."""

    pixels: NDArray[Any]
    numbers: NDArray[uint16] | None
    """Objects, (H, W), of a camera with truth."""


class Studio:
    """Takes images with the cameras of one vessel. models: by name, for the renderer. still: those that never move.

    `draw` needs the thread that created the studio. Another thread may call `develop` at the same time.
    """

    def __init__(
        self, cameras: Sequence[CameraSpec], models: Mapping[str, TriangleModel], still: Collection[str] = ()
    ) -> None:
        self._cameras = {camera.name: camera for camera in cameras}
        self._lenses = {camera.name: lens_of(camera) for camera in cameras}
        self._detectors: dict[str, Detector] = {
            camera.name: guarded(
                DETECTORS,
                camera.detector.kind,
                load(DETECTORS, camera.detector.kind),
                camera,
                self._lenses[camera.name],
            )
            for camera in cameras
            if camera.detector is not None
        }
        self._sensors = {camera.name: ImageSensor(camera.width_px, camera.height_px) for camera in cameras}
        self._models = dict(models)
        self._renderer = Renderer(models, still)

    @property
    def device(self) -> str:
        """Name of the renderer."""
        return self._renderer.device

    def add(self, name: str, model: TriangleModel) -> None:
        """Add a model."""
        self._models[name] = model
        self._renderer.add(name, model)

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()

    def draw(self, wanted: Commission) -> Drawing:
        """Draw an image."""
        camera, lens, middle = self._cameras[wanted.camera], self._lenses[wanted.camera], wanted.middle
        if camera.kind != "colour":
            measured = self._renderer.measure(middle.view, lens, middle.world)
            return Drawing(self._value(camera.kind, measured, wanted), measured[..., 0].astype(uint16))
        pixels = self._renderer.colour(wanted.shots, lens, wanted.response.exposure)
        numbers = self._renderer.numbers(lens) if camera.truth and len(wanted.shots) == 1 else None
        if camera.truth and numbers is None:
            numbers = self._renderer.measure(middle.view, lens, middle.world)[..., 0].astype(uint16)
        return Drawing(pixels, numbers)

    def develop(self, wanted: Commission, drawing: Drawing) -> CameraImage:
        """Return the image of a drawing. Raises PluginError when the detector of a package fails."""
        camera, lens, view = self._cameras[wanted.camera], self._lenses[wanted.camera], wanted.middle.view
        pixels, numbers = drawing.pixels, drawing.numbers
        if camera.kind == "colour":
            pixels = self._sensors[camera.name].expose(pixels, wanted.response)
        known = {placed.model: self._models[placed.model].objects for placed in wanted.middle.world.placed}
        detector, name = self._detectors.get(camera.name), "" if camera.detector is None else camera.detector.kind
        find_horizon = getattr(detector, "find_horizon", None) if camera.kind == "colour" else None
        return CameraImage(
            camera=camera.name,
            kind=camera.kind,
            number=wanted.number,
            stamp_ns=wanted.stamp_ns,
            pixels=pixels,
            lens=lens,
            pos_ned_m=view.pos_ned_m,
            rot_ned_optical=view.rot_ned_optical,
            objects=seen_objects(numbers, known, wanted.middle) if camera.truth and numbers is not None else (),
            horizon_px=horizon_px(lens, view.rot_ned_optical) if camera.truth else None,
            found_horizon_px=None if find_horizon is None else guarded(DETECTORS, name, find_horizon, pixels),
            detections=() if detector is None else tuple(guarded(DETECTORS, name, detector.detect, pixels)),
            encoded=encoded(camera.kind, pixels, camera.quality),
        )

    def _value(self, kind: str, measured: NDArray[float32], wanted: Commission) -> NDArray[Any]:
        if kind == "depth":
            return np.ascontiguousarray(measured[..., 1])
        if kind == "thermal":
            rng = np.random.default_rng(wanted.noise_seed)
            noisy = measured[..., 2] + THERMAL_NOISE_C * rng.standard_normal(measured.shape[:2], dtype=float32)
            return np.rint(100.0 * (noisy + KELVIN)).astype(uint16)
        class_of = np.full(SKY_ID + 1, ObjectClass.OTHER, uint8)
        class_of[SKY_ID], class_of[SEA_ID] = ObjectClass.SKY, ObjectClass.WATER
        for placed in wanted.middle.world.placed:
            for number, seen in enumerate(self._models[placed.model].objects):
                class_of[placed.first_id + number] = seen.kind
        return class_of[measured[..., 0].astype(uint16)]


def lens_of(camera: CameraSpec) -> Lens:
    """Return the lens of a camera."""
    return Lens.from_spec(camera.lens, camera.width_px, camera.height_px)


def seen_objects(
    picture: NDArray[uint16], known: Mapping[str, Sequence[WorldObject]], shot: Shot
) -> tuple[SeenObject, ...]:
    """Return the visible objects.

    picture: (H, W) numbers of the renderer. known: objects by model.
    """
    runs = _Runs.of(picture)
    result: list[SeenObject] = []
    for placed in shot.world.placed:
        objects = known[placed.model]
        mine = slice(*np.searchsorted(runs.number, [placed.first_id, placed.first_id + len(objects)]))
        if mine.start == mine.stop:
            continue
        seen = [objects[number - placed.first_id] for number in runs.number[mine].tolist()]
        to_optical = shot.view.rot_ned_optical.T @ placed.rot_ned_model
        at_m = shot.view.rot_ned_optical.T @ (placed.pos_ned_m - shot.view.pos_ned_m)
        centres = np.array([one.centre_m for one in seen]) @ to_optical.T + at_m
        quats = frames.matrix_to_quat(to_optical @ np.array([one.rot_model_box for one in seen]))
        result += [
            SeenObject(one.name, one.kind, tuple(box), pixels, distance_m, tuple(centre), tuple(quat), one.size_m)
            for one, box, pixels, distance_m, centre, quat in zip(
                seen,
                runs.box_px[mine].tolist(),
                runs.pixels[mine].tolist(),
                np.linalg.norm(centres, axis=1).tolist(),
                centres.tolist(),
                quats.tolist(),
                strict=True,
            )
        ]
    return tuple(result)


@dataclass(frozen=True, slots=True, eq=False)
class _Runs:
    """Pixels and box of each number in a picture, from runs of equal pixels along its rows."""

    number: NDArray[np.intp]
    """(N,) in order, without water and sky."""
    pixels: NDArray[np.intp]
    box_px: Array
    """(N, 4)."""

    @classmethod
    def of(cls, picture: NDArray[uint16]) -> _Runs:
        """Return the numbers of a picture (H, W)."""
        changes = np.ones(picture.shape, bool)
        np.not_equal(picture[:, 1:], picture[:, :-1], out=changes[:, 1:])
        first = np.flatnonzero(changes)
        last = np.append(first[1:], picture.size) - 1
        number = picture.ravel()[first].astype(np.intp)
        afloat = number < SEA_ID
        row, left = np.divmod(first[afloat], picture.shape[1])
        right = last[afloat] - row * picture.shape[1]
        found, index = np.unique(number[afloat], return_inverse=True)
        box = np.tile([np.inf, np.inf, -np.inf, -np.inf], (len(found), 1))
        for edge, values in enumerate((left, row)):
            np.minimum.at(box[:, edge], index, values - 0.5)
        for edge, values in enumerate((right, row), start=2):
            np.maximum.at(box[:, edge], index, values + 0.5)
        pixels = np.bincount(index, weights=right - left + 1, minlength=len(found)).astype(np.intp)
        return cls(found, pixels, box)


def horizon_px(lens: Lens, rot_ned_optical: np.ndarray[Any, Any]) -> tuple[float, float] | None:
    """Return the row of the horizon at the first and the last column of an ideal pinhole; None for others.

    The horizon is where directions are level: the dip of 2 arc minutes at 1 m above the water is left out.
    """
    x, y, z = rot_ned_optical[2]
    if not lens.is_ideal or abs(y) < 1e-6:
        return None
    (middle_x, middle_y), focal = lens.centre_px, lens.focal_px
    rows = [middle_y - focal * (x * (column - middle_x) / focal + z) / y for column in (0, lens.width_px - 1)]
    return float(rows[0]), float(rows[1])


def encoded(kind: str, pixels: NDArray[Any], quality: int) -> bytes:
    """Return the file of an image: JPEG of colour, PNG of segmentation (with a palette) and thermal, empty of depth."""
    from PIL import Image

    if kind == "depth":
        return b""
    if kind == "colour":
        bgr = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
        return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    image, out = Image.fromarray(pixels), io.BytesIO()
    if kind == "segmentation":
        image.putpalette([part for name in ObjectClass for part in PALETTE[name]])
    image.save(out, "PNG", compress_level=1)
    return out.getvalue()
