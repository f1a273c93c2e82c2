"""Images of a camera with known content, without a renderer."""

from __future__ import annotations

import numpy as np

from sim_core.sensors.camera_spec import CameraSpec
from sim_core.sensors.lens import Lens
from xitl_cli.plugins.cameras.images import CameraImage, ObjectClass, SeenObject
from xitl_cli.plugins.cameras.studio import encoded

BOX_PX = (9.5, 19.5, 49.5, 39.5)
"""Of the vessel: columns 10 to 49 and rows 20 to 39."""
VESSEL = SeenObject(
    "alpha", ObjectClass.VESSEL, BOX_PX, 800, 25.0, (-1.5, 0.2, 25.0), (1.0, 0.0, 0.0, 0.0), (4.0, 1.5, 1.2)
)
BUOY = SeenObject(
    "body 3",
    ObjectClass.BUOY,
    (59.5, 29.5, 63.5, 35.5),
    20,
    40.0,
    (1.0, 0.3, 40.0),
    (1.0, 0.0, 0.0, 0.0),
    (0.5, 0.5, 0.9),
)
OWN = SeenObject(
    "sitl",
    ObjectClass.OWN_VESSEL,
    (-0.5, 59.5, 95.5, 63.5),
    384,
    1.0,
    (0.0, 1.0, 0.5),
    (1.0, 0.0, 0.0, 0.0),
    (4.0, 1.5, 1.2),
)
"""Part of every image, and therefore no object of a training set."""


def make_image(spec: CameraSpec, number: int, noise: int = 0) -> CameraImage:
    """Return an image of a camera; the red channel of a colour image is its number. noise: largest random level."""
    height, width = spec.height_px, spec.width_px
    pixels: np.ndarray
    if spec.kind == "colour":
        pixels = np.zeros((height, width, 3), np.uint8)
        pixels[..., 0] = number
        if noise:
            pixels = np.random.default_rng(number).integers(0, noise, pixels.shape, np.uint8)
    elif spec.kind == "depth":
        pixels = np.full((height, width), 12.5, np.float32)
        pixels[: height // 2] = np.inf
    elif spec.kind == "segmentation":
        pixels = np.full((height, width), ObjectClass.WATER, np.uint8)
        pixels[20:40, 10:50] = ObjectClass.VESSEL
    else:
        pixels = np.full((height, width), 29_315, np.uint16)
        pixels[20:40, 10:50] = 31_315
    return CameraImage(
        camera=spec.name,
        kind=spec.kind,
        number=number,
        stamp_ns=number * 100_000_000,
        pixels=pixels,
        lens=Lens.from_spec(spec.lens, width, height),
        pos_ned_m=np.array([1.0, 2.0, -1.5]),
        rot_ned_optical=np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        objects=(VESSEL, BUOY, OWN),
        horizon_px=(10.0, 12.0),
        encoded=encoded(spec.kind, pixels, spec.quality),
    )
