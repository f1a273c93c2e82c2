"""Cameras as data: mount, gimbal, lens, exposure, noise and limits.

The optical axes of a camera are x right, y down and z ahead, as in OpenCV and ROS. Without rotation it looks ahead.
"""

from __future__ import annotations

import re
from typing import Annotated, Literal

from sim_core.dataclass import dataclass
from sim_core.keys import (
    Bounds,
    Direction,
    Items,
    NonNegative,
    Positive,
    Share,
    ShortForm,
    Specification,
    SpecificationError,
    Vector,
)

_NAME = re.compile(r"[a-z][a-z0-9_]*")
WIDEST_PINHOLE_DEG = 150.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LensSpec(Specification):
    """A pinhole with the distortion of OpenCV's `calib3d`, or a fisheye of OpenCV's `fisheye` (Kannala and Brandt)."""

    model: Literal["pinhole", "fisheye"] = "pinhole"
    view_deg: Annotated[
        float, Bounds(at_least=5, at_most=220), "horizontal field of view of the lens without its distortion"
    ] = 70.0
    distortion: Annotated[
        tuple[float, ...],
        Items(0, 5),
        "pinhole: k1, k2, p1, p2, k3; fisheye: k1 to k4; missing coefficients are 0",
    ] = ()
    vignetting: Annotated[Share, "share of the light that is lost in the corners"] = 0.0

    def check(self) -> None:
        if self.model == "pinhole" and self.view_deg > WIDEST_PINHOLE_DEG:
            raise SpecificationError(
                ("view_deg",),
                f"= {self.view_deg:g} is too wide for a pinhole; use at most {WIDEST_PINHOLE_DEG:g}, or model: fisheye",
            )
        if self.model == "fisheye" and len(self.distortion) > 4:
            raise SpecificationError(("distortion",), "has five coefficients; a fisheye has k1 to k4")


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalSpec(Specification):
    """A gimbal that follows MAVLink's commands, or keeps its direction in the world."""

    rate_degps: Positive = 60.0
    stabilised: Annotated[bool, "keep roll and pitch level and the commanded pitch over the horizon"] = True
    pitch_limits_deg: Annotated[tuple[Direction, Direction], "lowest and highest pitch angle"] = (-90.0, 30.0)
    yaw_limits_deg: Annotated[tuple[Direction, Direction], "from the mount, clockwise"] = (-180.0, 180.0)

    def check(self) -> None:
        for key in ("pitch_limits_deg", "yaw_limits_deg"):
            low, high = getattr(self, key)
            if low > high:
                raise SpecificationError((key,), f"= [{low:g}, {high:g}] is not in order; give the lower limit first")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureSpec(Specification):
    """Light of an image: brightness, blur by motion, rolling shutter and noise."""

    time_s: Annotated[float, Bounds(at_least=0, at_most=0.5), "motion during it blurs the image; 0: no blur"] = 0.0
    readout_s: Annotated[
        float, Bounds(at_least=0, at_most=0.5), "from the first to the last row of a rolling shutter; 0: global"
    ] = 0.0
    compensation_ev: Annotated[float, Bounds(at_least=-6, at_most=6), "brighter or darker than automatic"] = 0.0
    read_noise: Annotated[Share, "standard deviation in the dark, share of full scale"] = 0.004
    shot_noise: Annotated[Share, "standard deviation at full scale; it grows with the root of the light"] = 0.01


ONNX = "onnx"


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorSpec(Specification):
    """Finds objects in colour images. The keys after `kind` are for onnx."""

    kind: Annotated[str, "colour, onnx, or the name of a package's detector"] = "colour"
    model: Annotated[str | None, "file of a network in the format ONNX, relative to the profile"] = None
    classes: Annotated[
        tuple[str, ...], "names of the network's classes, in order: boom, buoy, vessel, debris, or others without score"
    ] = ()
    confidence: Annotated[Share, "least confidence of a detection"] = 0.25
    overlap: Annotated[Share, "of two boxes with a larger intersection over union, one is dropped"] = 0.45

    def check(self) -> None:
        if self.kind == ONNX:
            for key in ("model", "classes"):
                if not getattr(self, key):
                    raise SpecificationError((), f"of kind onnx needs {key!r}; add it")
        elif self.model is not None or self.classes:
            key = "classes" if self.model is None else "model"
            raise SpecificationError((key,), f"is for kind: onnx, and this detector is kind: {self.kind}; remove it")


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSpec(Specification):
    """A camera; roll, pitch and yaw turn its axis from straight ahead."""

    name: Annotated[str, "part of its topics, `/cameras/NAME/image`"] = "front"
    kind: Annotated[
        Literal["colour", "depth", "segmentation", "thermal"],
        "depth: metres along the optical axis; segmentation: class of each pixel; thermal: temperature",
    ] = "colour"
    width_px: Annotated[int, Bounds(at_least=16, at_most=4096)] = 640
    height_px: Annotated[int, Bounds(at_least=16, at_most=4096)] = 480
    rate_hz: Annotated[float, Bounds(above=0, at_most=120), "images per second"] = 10.0
    latency_s: Annotated[NonNegative, "from the middle of the exposure until the image is available"] = 0.1
    position_frd_m: Vector = (0.5, 0.0, -0.8)
    roll_deg: Direction = 0.0
    pitch_deg: Annotated[Direction, "pitch angle, up positive"] = 0.0
    yaw_deg: Direction = 0.0
    lens: LensSpec = LensSpec()
    gimbal: Annotated[GimbalSpec | None, "null: fixed"] = None
    exposure: ExposureSpec = ExposureSpec()
    drop_share: Annotated[Share, "share of the images that are lost at random"] = 0.0
    quality: Annotated[int, Bounds(at_least=1, at_most=100), "of the recorded JPEG"] = 85
    truth: Annotated[bool, "record boxes of the visible objects, and the horizon, with each image"] = True
    detector: Annotated[
        DetectorSpec | None, ShortForm("kind"), "null: none; a text is its kind, so `detector: colour`"
    ] = None
    serve: Annotated[
        str | None,
        "address that serves the images as MJPEG to browsers and ground stations, `http://127.0.0.1:8600`; null: none",
    ] = None

    def check(self) -> None:
        if self.detector is not None and self.kind != "colour":
            raise SpecificationError(
                ("detector",), f"= {self.detector.kind} needs colours, and this camera is kind: {self.kind}; remove it"
            )
        if not _NAME.fullmatch(self.name):
            raise SpecificationError(
                ("name",), f"= {self.name!r} cannot be part of a topic; use small letters, digits and _, such as front"
            )
