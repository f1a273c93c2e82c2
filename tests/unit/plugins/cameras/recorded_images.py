"""Recordings with images of cameras, as a run writes them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from foxglove import messages

from sim_core.frames import matrix_to_quat
from xitl_cli.plugins.cameras.images import (
    FRAMES,
    TRUTH,
    CameraFrame,
    CameraImage,
    CameraTruth,
    calibration_topic,
    image_topic,
)
from xitl_cli.profile.files.catalogue import PROFILE
from xitl_cli.profile.load import load_profile
from xitl_cli.profile.resolved import resolved_yaml
from xitl_cli.record.mcap_file import McapFile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.truth import timestamp

NAN = float("nan")


def foxglove_image(image: CameraImage, frame: str) -> messages.CompressedImage | messages.RawImage:
    """The message on the topic of the image."""
    stamp = timestamp(image.stamp_ns)
    if image.encoded:
        return messages.CompressedImage(timestamp=stamp, frame_id=frame, data=image.encoded, format=image.file_format)
    height, width = image.pixels.shape[:2]
    data = image.pixels.astype("<f4").tobytes()
    return messages.RawImage(
        timestamp=stamp, frame_id=frame, width=width, height=height, encoding="32FC1", step=4 * width, data=data
    )


def foxglove_calibration(image: CameraImage, frame: str) -> messages.CameraCalibration:
    """The message on the topic of the lens."""
    lens = image.lens
    matrix = lens.matrix.ravel().tolist()
    return messages.CameraCalibration(
        timestamp=timestamp(image.stamp_ns),
        frame_id=frame,
        width=lens.width_px,
        height=lens.height_px,
        distortion_model="kannala_brandt" if lens.fisheye else "plumb_bob",
        D=list(lens.distortion),
        K=matrix,
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[*matrix[:3], 0.0, *matrix[3:6], 0.0, *matrix[6:], 0.0],
    )


def record(path: Path, images: Iterable[CameraImage], vessel: str = "", truth: bool = True) -> Path:
    """Write a recording with these images. vessel: prefix of the topics."""
    file = McapFile(path)
    file.metadata("xitl", {"version": "1"} | ({"vessels": vessel} if vessel else {}))
    file.attach(PROFILE, "application/yaml", resolved_yaml(load_profile("sitl")).encode())
    recorder = Recorder(file, links=(), vessel=vessel)
    for topic in (FRAMES, TRUTH):
        recorder.add_topic(topic)
    known: set[str] = set()
    prefix = f"{vessel}/" if vessel else ""
    for image in images:
        topics = image_topic(image.camera, image.kind), calibration_topic(image.camera)
        for topic in topics if image.camera not in known else ():
            recorder.add_topic(topic)
        known.add(image.camera)
        frame = f"{prefix}camera_{image.camera}_optical"
        recorder.message(topics[0].name, image.stamp_ns, foxglove_image(image, frame))
        recorder.message(topics[1].name, image.stamp_ns, foxglove_calibration(image, frame))
        quat = tuple(matrix_to_quat(image.rot_ned_optical).tolist())
        horizon = image.horizon_px or (NAN, NAN)
        recorder.write(
            image.stamp_ns,
            CameraFrame(image.camera, image.number, tuple(image.pos_ned_m.tolist()), quat, *horizon, NAN, NAN),
        )
        for seen in image.objects if truth else ():
            pose = seen.centre_optical_m, seen.quat_optical_box, seen.size_m
            row = CameraTruth(image.camera, image.number, seen.kind.label, seen.name, *seen.box_px, seen.pixels, *pose)
            recorder.write(image.stamp_ns, row)
    recorder.close()
    return path
