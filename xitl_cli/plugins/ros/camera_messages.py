"""Recorded images and lenses of cameras as messages of sensor_msgs, as image_transport and image_pipeline expect them.

Sources: REP 104 (CameraInfo); compressed_image_transport, for the text in `CompressedImage.format`.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np

from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.extras import CAMERA
from xitl_cli.plugins.ros import msg
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.foxglove_types import foxglove_type

IMAGE, COMPRESSED = "cameras/{camera}/image_raw", "cameras/{camera}/image_raw/compressed"
CAMERA_INFO = "cameras/{camera}/camera_info"
_RECORDED = re.compile(r"/cameras/([a-z][a-z0-9_]*)/(image|calibration)")
_MODELS = {"plumb_bob": "plumb_bob", "rational_polynomial": "rational_polynomial", "kannala_brandt": "equidistant"}
"""Names of distortion models in ROS by those in Foxglove."""
_PNG_DEPTH = struct.Struct(">BB")
"""Bits of a channel, and colour type, at `_PNG_DEPTH_AT` of a PNG (W3C, Portable Network Graphics, 11.2.2)."""
_PNG_DEPTH_AT = 24
_PALETTE = 3
_PIXELS = {(8, 0): "mono8", (16, 0): "mono16", (8, 2): "rgb8", (8, 6): "rgba8"}


class CameraMessage(NamedTuple):
    """A message of one camera."""

    topic: str
    """IMAGE, COMPRESSED or CAMERA_INFO."""
    message: Any


def cameras_of(profile: RunProfile) -> tuple[CameraSpec, ...]:
    """Return the cameras of a vessel."""
    return () if profile.sensors is None else profile.sensors.cameras


def camera_topics(camera: CameraSpec) -> tuple[str, str]:
    """Return the topics of a camera, of OUTPUTS."""
    return IMAGE if camera.kind == "depth" else COMPRESSED, CAMERA_INFO


def camera_frame(camera: str) -> str:
    """Return the frame of a camera: x right, y down, z ahead (REP 103)."""
    return f"camera_{camera}_optical"


def camera_of_topic(topic: str) -> str:
    """Return the camera of a recorded topic without the vessel, such as /cameras/front/image; empty for none."""
    found = _RECORDED.fullmatch(topic)
    return "" if found is None else found[1]


def camera_messages(topic: str, payload: bytes, frame: str) -> Iterator[CameraMessage]:
    """Yield the messages of a recorded image or lens. topic: without the vessel. frame: its name in messages."""
    if topic.endswith("/calibration"):
        yield CameraMessage(CAMERA_INFO, _camera_info(foxglove_type("CameraCalibration").FromString(payload), frame))
        return
    compressed = foxglove_type("CompressedImage").FromString(payload)
    if compressed.format:
        data = classes_in_grey(compressed.data)
        file = msg.CompressedImage(
            header=_header(compressed, frame),
            format=compressed_format(compressed.format, data),
            data=np.frombuffer(data, dtype=np.uint8),
        )
        yield CameraMessage(COMPRESSED, file)
        return
    raw = foxglove_type("RawImage").FromString(payload)
    image = msg.Image(
        header=_header(raw, frame),
        height=raw.height,
        width=raw.width,
        encoding=raw.encoding,
        is_bigendian=0,
        step=raw.step,
        data=np.frombuffer(raw.data, dtype=np.uint8),
    )
    yield CameraMessage(IMAGE, image)


def classes_in_grey(data: bytes) -> bytes:
    """Return a PNG with a palette as a grey one, and other files unchanged.

    The colours of a segmentation image are for people. Decoders of ROS would return them instead of the classes.
    """
    if data[:1] != b"\x89" or _png_pixels(data)[1] != _PALETTE:
        return data
    CAMERA.require("images of segmentation cameras need")
    from PIL import Image

    with Image.open(BytesIO(data)) as image:
        grey, file = Image.fromarray(np.asarray(image)), BytesIO()
    grey.save(file, "PNG", compress_level=1)
    return file.getvalue()


def _png_pixels(data: bytes) -> tuple[int, int]:
    """Return the bits of a channel and the colour type of a PNG, zeros for a file that is too short."""
    found = _PNG_DEPTH.unpack_from(data, _PNG_DEPTH_AT) if len(data) >= _PNG_DEPTH_AT + _PNG_DEPTH.size else (0, 0)
    return int(found[0]), int(found[1])


def compressed_format(codec: str, data: bytes) -> str:
    """Return `CompressedImage.format`: pixels before the compression, codec, and the pixels in the file."""
    if codec == "jpeg":
        return "rgb8; jpeg compressed bgr8"
    pixels = _PIXELS.get(_png_pixels(data), "rgb8")
    return f"{pixels}; {codec} compressed {'bgr8' if pixels == 'rgb8' else ''}"


def _camera_info(lens: Any, frame: str) -> Any:
    return msg.CameraInfo(
        header=_header(lens, frame),
        height=lens.height,
        width=lens.width,
        distortion_model=_MODELS.get(lens.distortion_model, lens.distortion_model),
        d=np.array(lens.D, dtype=np.float64),
        k=np.array(lens.K, dtype=np.float64),
        r=np.array(lens.R, dtype=np.float64),
        p=np.array(lens.P, dtype=np.float64),
        binning_x=0,
        binning_y=0,
        roi=msg.RegionOfInterest(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def _header(message: Any, frame: str) -> Any:
    return msg.header(message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos, frame)
