"""Networks that a test writes itself mark the pixels of a colour, so that the result of each is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim_core.sensors.camera_spec import CameraSpec, DetectorSpec
from xitl_cli.errors import UserError
from xitl_cli.plugins.cameras.onnx_detector import Letterbox, OnnxDetector
from xitl_cli.plugins.cameras.studio import lens_of

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
SIDE, BOX = 32, 9
"""Size of the input in pixels, and of each box of the output."""
IMAGE_PX = 64, 48
RED, GREEN = (230, 0, 0), (0, 200, 0)


def write_network(file: Path, shape: tuple[int, ...] = (1, 3, SIDE, SIDE), transposed: bool = False) -> str:
    """Write a network with the classes red and green: a box about each pixel, with the mean of the colour in it."""
    helper, of, float_ = onnx.helper, onnx.numpy_helper.from_array, onnx.TensorProto.FLOAT
    row, column = np.divmod(np.arange(SIDE * SIDE), SIDE)
    size = np.full(SIDE * SIDE, BOX)
    boxes = np.stack([column + 0.5, row + 0.5, size, size]).astype(np.float32)[None]
    weights = np.array([[1.0, -1.0, -1.0], [-1.0, 1.0, -1.0]], np.float32).reshape(2, 3, 1, 1)
    nodes = [
        helper.make_node("Conv", ["images", "weights"], ["colour"]),
        helper.make_node("Clip", ["colour", "zero", "one"], ["clipped"]),
        helper.make_node("AveragePool", ["clipped"], ["mean"], kernel_shape=[BOX, BOX], pads=[BOX // 2] * 4),
        helper.make_node("Reshape", ["mean", "flat"], ["scores"]),
        helper.make_node("Concat", ["boxes", "scores"], ["joined"], axis=1),
        helper.make_node("Transpose", ["joined"], ["output0"], perm=[0, 2, 1] if transposed else [0, 1, 2]),
    ]
    graph = helper.make_graph(
        nodes,
        "colours",
        [helper.make_tensor_value_info("images", float_, shape)],
        [helper.make_tensor_value_info("output0", float_, ("batch", "rows", "columns"))],
        [
            of(weights, "weights"),
            of(np.float32(0.0), "zero"),
            of(np.float32(1.0), "one"),
            of(np.array([1, 2, SIDE * SIDE]), "flat"),
            of(boxes, "boxes"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.checker.check_model(model)
    onnx.save(model, str(file))
    return str(file)


def detector(model: str, *classes: str, confidence: float = 0.6) -> OnnxDetector:
    keys = DetectorSpec(kind="onnx", model=model, classes=classes, confidence=confidence)
    camera = CameraSpec(width_px=IMAGE_PX[0], height_px=IMAGE_PX[1], detector=keys)
    return OnnxDetector(camera, lens_of(camera))


def picture(*squares: tuple[int, int, tuple[int, int, int]]) -> np.ndarray:
    """Return an image with squares of 18 pixels, whose boxes are 9 pixels in the input: half the size."""
    image = np.full((IMAGE_PX[1], IMAGE_PX[0], 3), 90, np.uint8)
    for left, top, colour in squares:
        image[top : top + 2 * BOX, left : left + 2 * BOX] = colour
    return image


def test_boxes_are_in_pixels_of_the_image_and_each_object_has_one(tmp_path: Path) -> None:
    finder = detector(write_network(tmp_path / "colours.onnx"), "buoy", "vessel")
    found = sorted(finder.detect(picture((6, 10, RED), (40, 22, GREEN))), key=lambda one: one.label)
    assert [one.label for one in found] == ["buoy", "vessel"]
    assert found[0].box_px == pytest.approx((5.5, 9.5, 23.5, 27.5))  # edges: the first pixel has its centre at 0, 0
    assert found[1].box_px == pytest.approx((39.5, 21.5, 57.5, 39.5))
    assert found[0].confidence == pytest.approx(230 / 255, abs=0.01)


def test_nothing_is_found_without_its_colour_and_the_same_image_gives_the_same(tmp_path: Path) -> None:
    finder = detector(write_network(tmp_path / "colours.onnx"), "buoy", "vessel")
    assert finder.detect(picture()) == ()
    image = picture((6, 10, RED))
    assert finder.detect(image) == finder.detect(image) != ()


def test_overlap_and_confidence_decide_how_many_boxes_stay(tmp_path: Path) -> None:
    model = write_network(tmp_path / "colours.onnx")
    image = picture((6, 10, RED))
    assert len(detector(model, "buoy", "vessel", confidence=0.6).detect(image)) == 1
    assert len(detector(model, "buoy", "vessel", confidence=0.2).detect(image)) > 1  # at its edges
    assert len(detector(model, "buoy", "vessel", confidence=0.95).detect(image)) == 0


def test_a_network_may_take_any_size(tmp_path: Path) -> None:
    box = Letterbox.fit((1280, 720), (640, 640))
    assert (box.scale, box.left_px, box.top_px, box.width_px, box.height_px) == (0.5, 0, 140, 640, 360)
    inside = np.array([[100.0, 240.0, 200.0, 340.0]], np.float32)
    assert box.to_image(inside, (1280, 720)).tolist() == [[199.5, 199.5, 399.5, 399.5]]


def test_what_does_not_fit_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = write_network(tmp_path / "colours.onnx")
    with pytest.raises(UserError, match=r"so 2 classes, and detector\.classes has 3; list the names"):
        detector(model, "buoy", "vessel", "debris")
    flat = write_network(tmp_path / "flat.onnx", transposed=True)
    with pytest.raises(UserError, match=r"an output of shape 1 x 1024 x 6, so 1020 classes"):
        detector(flat, "buoy", "vessel")
    text = tmp_path / "text.onnx"
    text.write_text("no network")
    with pytest.raises(UserError, match=r"text\.onnx is no network that onnxruntime reads"):
        detector(str(text), "buoy")
    grey = write_network(tmp_path / "grey.onnx", shape=(1, 4, SIDE, SIDE))
    with pytest.raises(UserError, match=r"an input of shape 1 x 4 x 32 x 32|is no network"):
        detector(grey, "buoy", "vessel")
    monkeypatch.setattr("xitl_cli.extras.find_spec", lambda package: None)
    with pytest.raises(UserError, match=r"needs onnxruntime, which is not installed; pip install 'xitl\[onnx\]'"):
        detector(model, "buoy", "vessel")
