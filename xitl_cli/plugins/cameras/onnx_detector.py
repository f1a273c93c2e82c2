"""Detector that runs a network in the format ONNX, with the input and output of an export of YOLOv8.

Input: (1, 3, H, W), red, green and blue from 0 to 1. The image is scaled to fit and padded with grey. Output:
(1, 4 + classes, N) with the middle, width and height of N boxes in pixels of the input, then a score for each class.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy import float32, uint8
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.sensors.camera_spec import CameraSpec
from sim_core.sensors.lens import Lens
from xitl_cli.errors import UserError
from xitl_cli.extras import ONNX
from xitl_cli.plugins.cameras.images import Detection

USUAL_PX = 640
"""Input size of a network that accepts any."""
GREY = 114


@dataclass(frozen=True, slots=True)
class Letterbox:
    """An image scaled by `scale` into a network's input, with its corner at `left_px`, `top_px`."""

    scale: float
    left_px: int
    top_px: int
    width_px: int
    height_px: int
    """Size of the scaled image."""

    @classmethod
    def fit(cls, image_px: tuple[int, int], input_px: tuple[int, int]) -> Letterbox:
        """Return the letterbox of an image in an input, both (width, height)."""
        scale = min(input_px[0] / image_px[0], input_px[1] / image_px[1])
        width, height = (max(round(scale * side), 1) for side in image_px)
        return cls(scale, (input_px[0] - width) // 2, (input_px[1] - height) // 2, width, height)

    def to_image(self, boxes_px: NDArray[float32], image_px: tuple[int, int]) -> NDArray[float32]:
        """Return boxes (N, 4) of left, top, right and bottom in an image, whose first pixel has its centre at 0, 0."""
        corner = np.array([self.left_px, self.top_px] * 2, float32)
        most = np.array(image_px * 2, float32)
        boxes: NDArray[float32] = np.clip((boxes_px - corner) / float32(self.scale), 0.0, most) - float32(0.5)
        return boxes


class OnnxDetector:
    """Runs the network on one thread, so that the same image gives the same detections.

    Raises UserError for a missing package, a file that is no network, and shapes that do not match the classes.
    """

    def __init__(self, camera: CameraSpec, lens: Lens) -> None:
        assert camera.detector is not None
        assert camera.detector.model is not None
        self._keys = camera.detector
        self._file = camera.detector.model
        self._session = _session(self._file)
        self._input = self._session.get_inputs()[0]
        self._size_px = self._input_size()
        self._image_px = lens.width_px, lens.height_px
        self._letterbox = Letterbox.fit(self._image_px, self._size_px)
        self._check_output(self._run(np.zeros((lens.height_px, lens.width_px, 3), uint8)))

    def detect(self, image: NDArray[uint8]) -> Sequence[Detection]:
        """Return the objects in an image: see Detector."""
        rows = self._run(image)[0].T
        scores = rows[:, 4:]
        best = scores.argmax(axis=1)
        confidence = scores[np.arange(len(rows)), best]
        sure = np.flatnonzero(np.isfinite(rows).all(axis=1) & (confidence >= self._keys.confidence))
        if not len(sure):
            return ()
        middle, half = rows[sure, :2], 0.5 * rows[sure, 2:4]
        boxes = self._letterbox.to_image(np.concatenate([middle - half, middle + half], axis=1), self._image_px)
        corner_and_size = np.concatenate([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]], axis=1)
        kept = cv2.dnn.NMSBoxesBatched(
            corner_and_size.tolist(),
            confidence[sure].tolist(),
            best[sure].tolist(),
            self._keys.confidence,
            self._keys.overlap,
        )
        return [
            Detection(self._keys.classes[best[sure[row]]], tuple(boxes[row].tolist()), float(confidence[sure[row]]))
            for row in np.asarray(kept, int).ravel()
        ]

    def _run(self, image: NDArray[uint8]) -> NDArray[float32]:
        box = self._letterbox
        padded = np.full((self._size_px[1], self._size_px[0], 3), GREY, uint8)
        scaled = cv2.resize(image, (box.width_px, box.height_px), interpolation=cv2.INTER_LINEAR)
        padded[box.top_px : box.top_px + box.height_px, box.left_px : box.left_px + box.width_px] = scaled
        planes = np.ascontiguousarray(padded.transpose(2, 0, 1)[None], float32) / float32(255.0)
        try:
            output = self._session.run(None, {self._input.name: planes})[0]
        except Exception as error:  # onnxruntime raises classes of its own extension module
            raise UserError(f"{self._file} cannot run on an image ({_first_line(error)}); export it again") from error
        return np.asarray(output)

    def _input_size(self) -> tuple[int, int]:
        """Return width and height of the network's input."""
        shape, kind = self._input.shape, self._input.type
        if kind != "tensor(float)":
            raise UserError(f"{self._file} has an input of {kind}; export it with 32-bit floats")
        sides = [side if isinstance(side, int) and side > 0 else None for side in shape]
        if len(shape) != 4 or sides[0] not in (1, None) or sides[1] not in (3, None):
            raise UserError(
                f"{self._file} has an input of shape {_shape(shape)}; export it with 1 x 3 x height x width"
            )
        return sides[3] or USUAL_PX, sides[2] or USUAL_PX

    def _check_output(self, output: NDArray[float32]) -> None:
        names = self._keys.classes
        wanted = f"1 x {4 + len(names)} x N"
        if output.ndim != 3 or output.shape[0] != 1 or output.shape[1] < 5:
            raise UserError(
                f"{self._file} has an output of shape {_shape(output.shape)}, and a detector needs {wanted}; "
                "export it as YOLOv8 does, without its own suppression of overlaps"
            )
        if output.shape[1] != 4 + len(names):
            raise UserError(
                f"{self._file} has an output of shape {_shape(output.shape)}, so {output.shape[1] - 4} classes, and "
                f"detector.classes has {len(names)}; list the names of the network's classes in their order"
            )


def _session(file: str) -> Any:
    """Return the network of a file."""
    ONNX.require("detector of kind onnx needs")
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # errors are raised too
    try:
        return onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises classes of its own extension module
        raise UserError(
            f"{file} is no network that onnxruntime reads ({_first_line(error)}); export it again"
        ) from error


def _shape(shape: Sequence[object]) -> str:
    return " x ".join(map(str, shape))


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0].rstrip(".;")
