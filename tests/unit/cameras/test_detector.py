"""The detector by colour, and the score of detectors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng

from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.plugins.cameras.detector import ColourDetector, DetectorScore, covered
from xitl_cli.plugins.cameras.images import Box, Detection, ObjectClass, SeenObject
from xitl_cli.plugins.cameras.studio import lens_of

CAMERA = CameraSpec(width_px=320, height_px=240)


def seen(box: Box, kind: ObjectClass = ObjectClass.BOOM, pixels: int = 500) -> SeenObject:
    return SeenObject("one", kind, box, pixels, 10.0, (0.0, 0.0, 10.0), (1.0, 0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


def river() -> np.ndarray:
    """Grey sky over brown water with noise."""
    image = np.empty((240, 320, 3))
    image[:120], image[120:] = (180.0, 190.0, 200.0), (80.0, 75.0, 60.0)
    return np.clip(image + default_rng(1).normal(0.0, 3.0, image.shape), 0, 255).astype(np.uint8)


@pytest.mark.medium
def test_an_orange_line_on_the_water_is_a_boom() -> None:
    image = river()
    image[150:160, 96:240] = (225, 95, 25)
    found = [one for one in ColourDetector(CAMERA, lens_of(CAMERA)).detect(image) if one.label == "boom"]
    boxes = [one.box_px for one in found]
    assert covered((95.5, 149.5, 239.5, 159.5), boxes) > 0.95
    assert min(left for left, _, _, _ in boxes) >= 94.0
    assert max(bottom for _, _, _, bottom in boxes) <= 162.0


@pytest.mark.parametrize(
    ("colour", "label"),
    [
        ((190, 20, 15), "buoy"),
        ((240, 200, 20), "buoy"),
        ((15, 115, 50), "buoy"),
        ((25, 70, 160), "debris"),
        ((69, 117, 43), "debris"),
    ],
)
def test_colour_and_size_decide_the_class(colour: tuple[int, int, int], label: str) -> None:
    image = river()
    # 30 px below the horizon, at a focal length of 229 px and 0.95 m over the water: 7 m away and 1.6 m wide
    image[140:150, 60:110] = colour
    found = ColourDetector(CAMERA, lens_of(CAMERA)).detect(image)
    assert [one.label for one in found] == [label]
    assert covered(found[0].box_px, [(59.5, 139.5, 109.5, 149.5)]) > 0.6
    assert covered((59.5, 139.5, 109.5, 149.5), [found[0].box_px]) > 0.6


def test_a_white_object_that_rises_above_the_horizon_is_a_boat() -> None:
    image = river()
    image[100:150, 60:140] = (80, 75, 60)  # a bank behind it
    image[108:150, 60:120] = (235, 235, 232)
    found = ColourDetector(CAMERA, lens_of(CAMERA)).detect(image)
    assert [one.label for one in found] == ["vessel"]
    assert covered((59.5, 107.5, 119.5, 149.5), [found[0].box_px]) > 0.7
    below = river()
    below[140:150, 60:110] = (235, 235, 232)  # sky in the water
    assert not ColourDetector(CAMERA, lens_of(CAMERA)).detect(below)


def test_the_mirror_image_is_no_part_of_a_buoy() -> None:
    image = river()
    image[140:152, 100:112], image[152:164, 100:112] = (190, 20, 15), (120, 55, 45)
    found = ColourDetector(CAMERA, lens_of(CAMERA)).detect(image)
    assert [one.label for one in found] == ["buoy"]
    assert found[0].box_px[3] == pytest.approx(151.5, abs=2.0)


def test_a_float_against_the_sun_is_darker_than_its_mirror_image() -> None:
    image = river()
    image[150:170, 96:240], image[170:200, 96:240] = (110, 40, 10), (190, 150, 120)  # water reflects the sky too
    boxes = [one.box_px for one in ColourDetector(CAMERA, lens_of(CAMERA)).detect(image) if one.label == "boom"]
    assert covered((95.5, 149.5, 239.5, 169.5), boxes) > 0.95
    assert max(bottom for _, _, _, bottom in boxes) <= 172.0


def test_a_buoy_in_front_of_a_boom_is_no_mirror_image() -> None:
    image = river()
    image[134:142, 40:280], image[142:160, 100:116] = (225, 95, 25), (15, 115, 50)
    found = [one for one in ColourDetector(CAMERA, lens_of(CAMERA)).detect(image) if one.label != "boom"]
    assert [one.label for one in found] == ["buoy"]
    assert covered((99.5, 141.5, 115.5, 159.5), [found[0].box_px]) > 0.8


RED, BLUE, WHITE = (190, 20, 15), (25, 70, 160), (235, 235, 232)


@pytest.mark.parametrize(
    ("colour", "width_px", "height_px", "below_px", "label"),
    [
        # 30 px below the horizon: 39 m away, 0.172 m per pixel
        (RED, 14, 10, 30, "buoy"),  # 2.4 m wide, up to 3 m
        (RED, 20, 10, 30, None),
        (BLUE, 66, 8, 30, "debris"),  # 11.3 m wide, up to 12 m; 1.4 m high, up to 1.5 m
        (BLUE, 75, 8, 30, None),
        (BLUE, 60, 11, 30, None),
        (WHITE, 112, 40, 30, "vessel"),  # 19.2 m wide, up to 20 m
        (WHITE, 120, 40, 30, None),
        (WHITE, 100, 45, 30, "vessel"),  # 7.7 m high, up to 8 m
        (WHITE, 100, 50, 30, None),
        (WHITE, 9, 36, 30, "vessel"),  # 1.5 m wide, at least 1.2 m
        (WHITE, 6, 36, 30, None),
        # Up to 60 m, which is 19.6 px, and for boats 100 m, which is 11.8 px
        (RED, 6, 5, 22, "buoy"),
        (RED, 6, 5, 17, None),
        (WHITE, 30, 18, 14, "vessel"),
        (WHITE, 20, 13, 9, None),
    ],
)
def test_an_object_has_a_plausible_size_and_distance(
    colour: tuple[int, int, int], width_px: int, height_px: int, below_px: int, label: str | None
) -> None:
    # 5.15 m over the water, at a focal length of 228.5 px
    camera, image = replace(CAMERA, position_frd_m=(0.0, 0.0, -5.0)), river()
    image[120 + below_px - height_px : 120 + below_px, 100 : 100 + width_px] = colour
    found = ColourDetector(camera, lens_of(camera)).detect(image)
    assert [one.label for one in found] == ([label] if label else [])
    for one in found:
        box = 99.5, 119.5 + below_px - height_px, 99.5 + width_px, 119.5 + below_px
        assert one.box_px == pytest.approx(box, abs=0.1 if label == "debris" else 1.5)
        left, top, right, bottom = one.box_px
        assert one.confidence == pytest.approx(min((right - left) * (bottom - top) / 400.0, 1.0))


def in_fog(colour: tuple[int, int, int]) -> np.ndarray:
    """An object of 20 by 16 pixels in fog that leaves little of its colour."""
    fog, left = np.array([190.0, 192.0, 194.0]), 0.06
    image = np.empty((240, 320, 3))
    image[:] = fog
    image[125:] += left * (np.array([80.0, 75.0, 60.0]) - fog)
    image[150:166, 100:120] = fog + left * (np.array(colour) - fog)
    return np.clip(image + default_rng(2).normal(0.0, 1.5, image.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("colour", "label"), [((225, 95, 25), "boom"), ((190, 20, 60), "buoy"), ((15, 115, 50), "buoy")]
)
def test_in_fog_a_trace_of_red_or_green_is_enough(colour: tuple[int, int, int], label: str) -> None:
    detector = ColourDetector(CAMERA, lens_of(CAMERA))
    found = detector.detect(in_fog(colour))
    assert {one.label for one in found} == {label}
    assert covered((99.5, 149.5, 119.5, 165.5), [one.box_px for one in found]) > 0.7
    assert detector.find_horizon(in_fog(colour)) is None
    assert not detector.detect(in_fog((80, 75, 60)))


def test_a_camera_that_looks_up_finds_nothing() -> None:
    upward = CameraSpec(width_px=320, height_px=240, pitch_deg=60.0)
    assert not ColourDetector(upward, lens_of(upward)).detect(river())


def sky_and_water(line: np.ndarray) -> np.ndarray:
    """Return an image whose water reflects the sky less and less below a line (240, 320)."""
    below = np.mgrid[:240, :320][0] - line
    water = np.array([60, 60, 50]) + 60.0 * np.exp(-np.maximum(below, 0.0) / 20.0)[..., None]
    return np.where((below < 0)[..., None], (180, 190, 200), water).astype(np.uint8)


@pytest.mark.parametrize("slope", [0.0, 0.05, -0.04, 0.085, -0.085])
def test_the_horizon_is_the_line_between_sky_and_water(slope: float) -> None:
    line = 116.0 + slope * (np.mgrid[:240, :320][1] - 159.5)
    found = ColourDetector(CAMERA, lens_of(CAMERA)).find_horizon(sky_and_water(line))
    assert found == pytest.approx((116.0 - 159.5 * slope, 116.0 + 159.5 * slope), abs=2.0)
    assert ColourDetector(CAMERA, lens_of(CAMERA)).find_horizon(np.full((240, 320, 3), 90, np.uint8)) is None


@pytest.mark.parametrize(
    ("column", "below_px", "found"), [(40, 24, True), (40, 16, False), (270, 24, True), (270, 16, False)]
)
def test_the_distance_of_an_object_is_from_the_horizon_above_it(column: int, below_px: int, found: bool) -> None:
    """60 m are 19.6 px below a horizon that slants by 13 px to both sides."""
    camera = replace(CAMERA, position_frd_m=(0.0, 0.0, -5.0))
    line = 119.5 + 0.08 * (np.mgrid[:240, :320][1] - 159.5)
    image = np.where((np.mgrid[:240, :320][0] < line)[..., None], (180, 190, 200), (80, 75, 60)).astype(np.uint8)
    bottom = round(line[0, column + 3]) + below_px
    image[bottom - 5 : bottom, column : column + 6] = RED
    detections = ColourDetector(camera, lens_of(camera)).detect(image)
    assert [one.label for one in detections] == ["buoy"] * found


def test_orange_far_above_the_horizon_is_no_boom() -> None:
    image = river()
    image[60:70, 96:240] = (225, 95, 25)
    assert not ColourDetector(CAMERA, lens_of(CAMERA)).detect(image)


@pytest.mark.parametrize(("horizon_row", "found"), [(190, True), (222, False)])
def test_objects_need_some_rows_of_water(horizon_row: int, found: bool) -> None:
    pitch_deg = math.degrees(math.atan((horizon_row - 120) / 228.5))
    camera, image = replace(CAMERA, pitch_deg=pitch_deg), np.roll(river(), horizon_row - 120, axis=0)
    image[:horizon_row] = (180, 190, 200)
    image[horizon_row + 8 : horizon_row + 14, 100:106] = RED
    assert [one.label for one in ColourDetector(camera, lens_of(camera)).detect(image)] == ["buoy"] * found


def test_a_shore_and_the_top_of_a_wall_are_no_horizons() -> None:
    detector, image = ColourDetector(CAMERA, lens_of(CAMERA)), sky_and_water(np.full((240, 320), 112.0))
    shore, wall = image.copy(), image.copy()
    shore[100:112, 160:] = 40, 70, 30
    wall[112:160] = 120, 120, 125
    assert detector.find_horizon(image) == pytest.approx((112.0, 112.0), abs=2.0)
    assert detector.find_horizon(shore) is None
    assert detector.find_horizon(wall) is None


def test_the_score_of_the_horizon_is_its_rms_over_both_ends() -> None:
    score = DetectorScore()
    assert score.report() == {}
    score.horizon.add((103.0, 96.0), (100.0, 100.0))
    score.horizon.add(None, (100.0, 100.0))
    score.horizon.add((50.0, 50.0), None)
    assert score.report() == {"horizon": {"images": 2, "found": 1, "rms_px": pytest.approx(12.5**0.5)}}


def test_empty_water_has_nothing() -> None:
    assert not ColourDetector(CAMERA, lens_of(CAMERA)).detect(river())


def test_the_covered_share_counts_each_pixel_once() -> None:
    assert covered((-0.5, -0.5, 9.5, 9.5), [(-0.5, -0.5, 4.5, 9.5), (2.5, -0.5, 6.5, 9.5)]) == pytest.approx(0.7)
    assert covered((-0.5, -0.5, 9.5, 9.5), []) == 0.0


def test_boxes_around_a_box_cover_nothing_of_it() -> None:
    box = (9.5, 9.5, 19.5, 19.5)
    above, below, left, right = (
        (9.5, 6.5, 19.5, 9.5),
        (9.5, 19.5, 19.5, 23.5),
        (3.5, 9.5, 9.5, 19.5),
        (19.5, 9.5, 23.5, 19.5),
    )
    assert covered(box, [above, below, left, right, (0.5, 0.5, 5.5, 5.5)]) == 0.0
    assert covered(box, [(14.5, 15.5, 50.0, 50.0)]) == pytest.approx(0.2)
    assert covered(box, [(0.0, 0.0, 12.5, 11.5)]) == pytest.approx(0.06)


def test_the_score_counts_detections_and_objects() -> None:
    score = DetectorScore()
    right, half, elsewhere = (0.0, 0.0, 10.0, 10.0), (8.0, 0.0, 20.0, 10.0), (100.0, 0.0, 110.0, 10.0)
    found = [Detection("boom", box, 1.0) for box in (right, elsewhere)]
    truth = [seen(right), seen(half), seen((200.0, 0.0, 202.0, 2.0), pixels=4), seen(right, ObjectClass.VESSEL)]
    score.add(found, truth)
    report = score.report()
    boom, vessel = report["boom"], report["vessel"]
    assert [boom[key] for key in ("detections", "objects", "precision", "recall")] == [2, 2, 0.5, 0.5]
    assert [vessel[key] for key in ("detections", "objects", "precision", "recall")] == [0, 1, None, 0.0]


def test_the_recall_is_also_by_size_and_range() -> None:
    score, near, far = DetectorScore(), (0.0, 0.0, 40.0, 40.0), (100.0, 0.0, 110.0, 10.0)
    truth = [seen(near, pixels=1600), replace(seen(far, pixels=100), distance_m=45.0)]
    score.add([Detection("boom", near, 1.0)], truth)
    report = score.report()["boom"]
    assert report["by_area"] == {"tiny": {"objects": 1, "recall": 0.0}, "medium": {"objects": 1, "recall": 1.0}}
    assert report["by_range"] == {"to 15 m": {"objects": 1, "recall": 1.0}, "to 60 m": {"objects": 1, "recall": 0.0}}


@pytest.mark.parametrize(
    ("pixels", "size"),
    [
        (63, None),  # too small to be missed
        (64, "tiny"),
        (255, "tiny"),
        (256, "small"),
        (1023, "small"),
        (1024, "medium"),
        (9215, "medium"),
        (9216, "large"),
    ],
)
def test_sizes_are_those_of_coco_and_ai_tod(pixels: int, size: str | None) -> None:
    score = DetectorScore()
    score.add([], [seen((0.0, 0.0, 10.0, 10.0), pixels=pixels)])
    assert list(score.report()["boom"]["by_area"]) == ([size] if size else [])


@pytest.mark.parametrize(
    ("distance_m", "range_"),
    [
        (14.9, "to 15 m"),
        (15.0, "to 30 m"),
        (29.9, "to 30 m"),
        (30.0, "to 60 m"),
        (59.9, "to 60 m"),
        (60.0, "beyond 60 m"),
    ],
)
def test_ranges_end_below_their_names(distance_m: float, range_: str) -> None:
    score = DetectorScore()
    score.add([], [replace(seen((0.0, 0.0, 10.0, 10.0)), distance_m=distance_m)])
    assert list(score.report()["boom"]["by_range"]) == [range_]


def test_half_of_a_box_on_objects_is_right_and_half_of_an_object_is_found() -> None:
    score, box = DetectorScore(), (-0.5, -0.5, 9.5, 9.5)
    score.add([Detection("boom", box, 1.0)], [seen((4.5, -0.5, 14.5, 9.5))])
    score.add([Detection("boom", box, 1.0)], [seen((5.5, -0.5, 15.5, 9.5))])
    boom = score.report()["boom"]
    assert [boom[key] for key in ("detections", "precision", "objects", "recall")] == [2, 0.5, 2, 0.5]
