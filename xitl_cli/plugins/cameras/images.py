"""An image of a camera with its ground truth, and the topics on which it is recorded."""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

from numpy import float32, uint8, uint16
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.sensors.lens import Lens
from xitl_cli.record import topics
from xitl_cli.record.cdr import Float64, Float64x3, Float64x4, Int64, String, Uint32
from xitl_cli.record.topics import CameraDetection, Topic, camera_topic


class ObjectClass(IntEnum):
    """Classes of a segmentation image, by the value of a pixel."""

    SKY = 0
    WATER = 1
    GROUND = 2
    VEGETATION = 3
    ROCK = 4
    DAM = 5
    BOOM = 6
    BUILDING = 7
    VESSEL = 8
    DEBRIS = 9
    BUOY = 10
    OTHER = 11
    OWN_VESSEL = 12

    @property
    def label(self) -> str:
        """Name for people and data sets."""
        return self.name.lower().replace("_", " ")


Box = tuple[float, float, float, float]
"""Left, top, right and bottom edge in pixels. The centre of the first pixel is at 0, 0."""


@dataclass(frozen=True, slots=True)
class Detection:
    """An object that a detector found."""

    label: str
    """Label of an ObjectClass."""
    box_px: Box
    confidence: float
    """0 to 1."""


@dataclass(frozen=True, slots=True)
class SeenObject:
    """An object of which at least one pixel is visible."""

    name: str
    """Unique in the run, such as `boom` or `body 3`, or the name of a vessel."""
    kind: ObjectClass
    box_px: Box
    """Of the visible part."""
    pixels: int
    """Visible pixels."""
    distance_m: float
    """From the camera to the middle of the object's box."""
    centre_optical_m: tuple[float, float, float]
    """Middle of the object's box in the optical axes (x right, y down, z ahead)."""
    quat_optical_box: tuple[float, float, float, float]
    """Turns the axes of the box into the optical axes, w x y z."""
    size_m: tuple[float, float, float]
    """Size of the box along its axes."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraImage:
    """An image of one camera."""

    camera: str
    """Name of the camera."""
    kind: str
    """colour, depth, segmentation or thermal."""
    number: int
    """Counts from 1 with each exposure, so that a missing number is a lost image."""
    stamp_ns: int
    """Simulation time of the middle of the exposure."""
    pixels: NDArray[uint8] | NDArray[uint16] | NDArray[float32]
    """colour: (H, W, 3) uint8, sRGB; depth: (H, W) float32 in metres along the axis, inf for the sky; segmentation:
    (H, W) uint8, `ObjectClass`; thermal: (H, W) uint16 in 0.01 K. Empty in a run where nobody wants them decoded."""
    lens: Lens
    pos_ned_m: Array
    """Position of the camera, (3,)."""
    rot_ned_optical: Array
    """Turns the optical axes (x right, y down, z ahead) into NED, (3, 3)."""
    objects: tuple[SeenObject, ...] = ()
    """Ground truth, of a camera with `truth`."""
    horizon_px: tuple[float, float] | None = None
    """Ground truth: row of the horizon at the first and at the last column, of an ideal pinhole; None for none."""
    found_horizon_px: tuple[float, float] | None = None
    """The same, as the detector found it."""
    detections: tuple[Detection, ...] = ()
    """Of a camera with `detector`."""
    encoded: bytes = b""
    """Recorded file: JPEG of a colour image, PNG of segmentation and thermal, empty of depth."""

    @property
    def file_format(self) -> str:
        """`jpeg`, `png`, or empty for depth."""
        return {"colour": "jpeg", "depth": ""}.get(self.kind, "png")


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """An image: its pose and its horizon."""

    camera: Annotated[String, "name of the camera"]
    image: Annotated[Int64, "number of the image, counted from 1; a missing number is a lost image"]
    position_ned_m: Float64x3
    quat_ned_optical: Annotated[Float64x4, "w x y z; optical axes are x right, y down, z ahead"]
    horizon_left_px: Annotated[Float64, "row of the horizon at the first column; NaN for none"]
    horizon_right_px: Annotated[Float64, "row of the horizon at the last column; NaN for none"]
    found_left_px: Annotated[Float64, "row of the horizon at the first column, as the detector found it; NaN for none"]
    found_right_px: Annotated[Float64, "the same at the last column"]


@dataclass(frozen=True, slots=True)
class CameraTruth:
    """An object in an image, exactly: where it is seen, and its box in the camera's optical axes."""

    camera: Annotated[String, "name of the camera"]
    image: Annotated[Int64, "number of the image"]
    label: Annotated[String, "class"]
    object: Annotated[String, "unique name"]
    left_px: Float64
    top_px: Float64
    right_px: Float64
    bottom_px: Float64
    pixels: Annotated[Uint32, "visible pixels"]
    centre_optical_m: Annotated[Float64x3, "middle of the box: x right, y down, z ahead"]
    quat_optical_box: Annotated[Float64x4, "w x y z"]
    size_m: Annotated[Float64x3, "of the box"]


FRAMES = Topic("/cameras/frames", "xitl_msgs/msg/CameraFrame", "each image", "pose and horizon", CameraFrame)
TRUTH = Topic("/cameras/truth", "xitl_msgs/msg/CameraTruth", "each image", "visible objects", CameraTruth)

DETECTIONS = Topic(
    topics.DETECTIONS,
    "xitl_msgs/msg/CameraDetection",
    "each image",
    "objects that a detector found",
    CameraDetection,
)


def image_topic(camera: str, kind: str) -> Topic:
    """Return the topic of a camera's images."""
    schema = "foxglove.RawImage" if kind == "depth" else "foxglove.CompressedImage"
    return Topic(camera_topic(camera, "image"), schema, "each image", f"{kind} image")


def calibration_topic(camera: str) -> Topic:
    """Return the topic of a camera's lens."""
    return Topic(camera_topic(camera, "calibration"), "foxglove.CameraCalibration", "each image", "lens")


def annotations_topic(camera: str) -> Topic:
    """Return the topic of the boxes that Foxglove draws over a camera's images."""
    return Topic(camera_topic(camera, "annotations"), "foxglove.ImageAnnotations", "each image", "boxes")
