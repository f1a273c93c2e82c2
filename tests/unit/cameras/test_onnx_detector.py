"""Networks that a test writes itself mark the pixels of a colour, so that the result of each is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim_core.sensors.camera_spec import CameraSpec, DetectorSpec
from tests.colour_network import BOX, SIDE, write_network
from xitl_cli.errors import UserError
from xitl_cli.plugins.cameras.onnx_detector import Letterbox, OnnxDetector
from xitl_cli.plugins.cameras.studio import lens_of

IMAGE_PX = 64, 48
RED, GREEN = (230, 0, 0), (0, 200, 0)


def detector(model: str, *classes: str, confidence: float = 0.65) -> OnnxDetector:
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
    assert found[0].confidence == pytest.approx(1.0)


def test_nothing_is_found_without_its_colour_and_the_same_image_gives_the_same(tmp_path: Path) -> None:
    finder = detector(write_network(tmp_path / "colours.onnx"), "buoy", "vessel")
    assert finder.detect(picture()) == ()
    image = picture((6, 10, RED))
    assert finder.detect(image) == finder.detect(image) != ()


def test_overlap_and_confidence_decide_how_many_boxes_stay(tmp_path: Path) -> None:
    model = write_network(tmp_path / "colours.onnx")
    image = picture((6, 10, RED))
    assert len(detector(model, "buoy", "vessel", confidence=0.65).detect(image)) == 1
    assert len(detector(model, "buoy", "vessel", confidence=0.2).detect(image)) > 1  # at its edges


def test_a_network_may_take_any_size(tmp_path: Path) -> None:
    box = Letterbox.fit((1280, 720), (640, 640))
    assert (box.scale, box.left_px, box.top_px, box.width_px, box.height_px) == (0.5, 0, 140, 640, 360)
    outside = np.array([[-10.0, 130.0, 650.0, 510.0]], np.float32)
    np.testing.assert_allclose(box.to_image(outside, (1280, 720)), [[-0.5, -0.5, 1279.5, 719.5]])
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
