"""Images and their ground truth, with a renderer that the test plays: objects, horizon, classes, files, messages."""

from __future__ import annotations

import io
import math
from collections.abc import Collection, Mapping
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from synthetic_images import make_image

from sim_core import frames
from sim_core.sensors.camera_spec import CameraSpec, DetectorSpec, LensSpec
from sim_core.sensors.lens import Lens
from xitl_cli.plugins.cameras import remote_studio, studio
from xitl_cli.plugins.cameras.gimbal import ROT_FRD_OPTICAL
from xitl_cli.plugins.cameras.image_sensor import ImageResponse
from xitl_cli.plugins.cameras.images import CameraImage, Detection, ObjectClass, SeenObject
from xitl_cli.plugins.cameras.models import WorldObject
from xitl_cli.plugins.cameras.remote_studio import RemoteStudio, message_of
from xitl_cli.plugins.cameras.renderer import SEA_ID, SKY_ID, PlacedModel, Shot, Viewpoint
from xitl_cli.plugins.cameras.studio import Commission, Drawing, Studio, encoded, horizon_px, seen_objects

image_module = pytest.importorskip("PIL.Image")

BUOY = WorldObject("buoy", ObjectClass.BUOY, (1.0, 0.0, 0.0), (0.5, 0.5, 1.0))
BOOM = WorldObject(
    "boom",
    ObjectClass.BOOM,
    (0.0, 2.0, 0.0),
    (8.0, 0.5, 0.5),
    frames.quat_to_matrix(frames.euler_to_quat(np.array([0.0, 0.0, math.pi / 2]))),
)
BOAT = WorldObject("boat", ObjectClass.VESSEL, (0.0, 0.0, -0.5), (4.0, 1.5, 1.0))
KNOWN = {"world": (BUOY, BOOM), "boat": (BOAT,)}


def looks_north(*placed: PlacedModel, **keys: Any) -> Shot:
    """From 2 m above the origin."""
    view = Viewpoint(np.array([0.0, 0.0, -2.0]), ROT_FRD_OPTICAL)
    return Shot(view, cast(Any, SimpleNamespace(placed=placed)), **keys)


WORLD = PlacedModel("world", np.zeros(3), np.eye(3), 1)


def placed_boat() -> PlacedModel:
    """10 m north and 3 m east, its bow to the east."""
    east = frames.quat_to_matrix(frames.euler_to_quat(np.array([0.0, 0.0, math.pi / 2])))
    return PlacedModel("boat", np.array([10.0, 3.0, 0.0]), east, 3)


def test_objects_have_the_box_and_number_of_their_visible_pixels() -> None:
    picture = np.full((6, 8), SEA_ID, np.uint16)
    picture[:2] = SKY_ID
    picture[2, 1:4] = 3
    picture[3, 2] = 3
    picture[3, 7] = 3
    picture[4, 0] = 1  # at the end of one row and the start of the next
    picture[3, 6] = 1
    objects = seen_objects(picture, KNOWN, looks_north(WORLD, placed_boat()))
    assert [(one.name, one.pixels, one.box_px) for one in objects] == [
        ("buoy", 2, (-0.5, 2.5, 6.5, 4.5)),
        ("boat", 5, (0.5, 1.5, 7.5, 3.5)),
    ]
    assert [one.kind for one in objects] == [ObjectClass.BUOY, ObjectClass.VESSEL]


def test_objects_are_where_they_are_in_the_axes_of_the_camera() -> None:
    picture = np.array([[1, 2, 3]], np.uint16)
    buoy, boom, boat = seen_objects(picture, KNOWN, looks_north(WORLD, placed_boat()))
    # Optical axes: x to the east, y down, z to the north. The camera is 2 m above the origin.
    assert buoy.centre_optical_m == pytest.approx((0.0, 2.0, 1.0))
    assert boom.centre_optical_m == pytest.approx((2.0, 2.0, 0.0))
    assert boat.centre_optical_m == pytest.approx((3.0, 1.5, 10.0))
    assert boat.distance_m == pytest.approx(math.sqrt(9.0 + 2.25 + 100.0))
    assert (boat.size_m, boom.size_m) == ((4.0, 1.5, 1.0), (8.0, 0.5, 0.5))
    axes = [frames.quat_to_matrix(np.array(one.quat_optical_box)) for one in (buoy, boom, boat)]
    np.testing.assert_allclose(axes[0][:, 0], [0.0, 0.0, 1.0], atol=1e-12)  # along the buoy: north, ahead
    np.testing.assert_allclose(axes[1][:, 0], [1.0, 0.0, 0.0], atol=1e-12)  # along the boom: east
    np.testing.assert_allclose(axes[2][:, 0], [1.0, 0.0, 0.0], atol=1e-12)  # along the boat: east
    np.testing.assert_allclose(axes[2][:, 2], [0.0, 1.0, 0.0], atol=1e-12)  # down


def test_equal_pixels_at_the_end_of_a_row_and_the_start_of_the_next_are_two_runs() -> None:
    picture = np.array([[SEA_ID, 1], [1, SEA_ID], [1, 1]], np.uint16)
    (buoy,) = seen_objects(picture, KNOWN, looks_north(WORLD))
    assert (buoy.pixels, buoy.box_px) == (4, (-0.5, -0.5, 1.5, 2.5))


def test_an_empty_picture_has_no_objects() -> None:
    assert seen_objects(np.full((3, 4), SEA_ID, np.uint16), KNOWN, looks_north(WORLD, placed_boat())) == ()


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(0.0, 0.0), (0.0, 8.0), (0.0, -5.0), (12.0, 0.0), (-7.0, 4.0)])
def test_the_horizon_is_where_level_directions_are(roll_deg: float, pitch_deg: float) -> None:
    lens = Lens.from_spec(LensSpec(view_deg=70.0), 640, 480)
    attitude = frames.quat_to_matrix(frames.euler_to_quat(np.radians([roll_deg, pitch_deg, 30.0])))
    rows = horizon_px(lens, attitude @ ROT_FRD_OPTICAL)
    assert rows is not None
    directions = lens.directions(np.array([(0.0, rows[0]), (639.0, rows[1])])) @ (attitude @ ROT_FRD_OPTICAL).T
    np.testing.assert_allclose(directions[:, 2], 0.0, atol=1e-12)
    middle = 239.5 + lens.focal_px * math.tan(math.radians(pitch_deg))
    if roll_deg == 0.0:
        assert rows == pytest.approx((middle, middle))  # with the bow up, the horizon is lower in the image
    else:
        assert (rows[0] < rows[1]) is (roll_deg < 0.0)


def test_only_a_pinhole_without_distortion_that_does_not_look_down_has_a_straight_horizon() -> None:
    down = frames.quat_to_matrix(frames.euler_to_quat(np.radians([0.0, -90.0, 0.0]))) @ ROT_FRD_OPTICAL
    assert horizon_px(Lens.from_spec(LensSpec(), 640, 480), down) is None
    bent = Lens.from_spec(LensSpec(distortion=(0.1,)), 640, 480)
    assert horizon_px(bent, ROT_FRD_OPTICAL) is None


def test_files_of_images_are_read_back() -> None:
    colour = np.zeros((32, 48, 3), np.uint8)
    colour[:] = (200, 60, 20)
    with image_module.open(io.BytesIO(encoded("colour", colour, 95))) as read:
        assert read.format == "JPEG"
        np.testing.assert_allclose(np.asarray(read), colour, atol=4)
    assert len(encoded("colour", make_image(CameraSpec(), 1, 250).pixels, 95)) > 2 * len(
        encoded("colour", make_image(CameraSpec(), 1, 250).pixels, 20)
    )
    thermal = np.array([[29_315, 65_535], [0, 1]], np.uint16)
    with image_module.open(io.BytesIO(encoded("thermal", thermal, 85))) as read:
        np.testing.assert_array_equal(np.asarray(read).astype(np.uint16), thermal)
    classes = np.array([[ObjectClass.SKY, ObjectClass.WATER], [ObjectClass.OWN_VESSEL, ObjectClass.BOOM]], np.uint8)
    with image_module.open(io.BytesIO(encoded("segmentation", classes, 85))) as read:
        assert read.format == "PNG"
        np.testing.assert_array_equal(np.asarray(read), classes)
        shown = np.asarray(read.convert("RGB"))
        assert [tuple(shown[row, column].tolist()) for row in (0, 1) for column in (0, 1)] == [
            studio.PALETTE[ObjectClass(int(number))] for number in classes.ravel()
        ]
    assert encoded("depth", np.ones((2, 2), np.float32), 85) == b""


# -- a studio


class Renderer:
    """Stands in for the renderer. measured: number, depth in m and temperature in °C of each pixel."""

    device = "a card"
    measured = np.zeros((16, 16, 3), np.float32)
    made: Renderer

    def __init__(self, models: Mapping[str, Any], still: Collection[str]) -> None:
        Renderer.made = self
        self.models, self.still, self.closed = dict(models), still, False
        self.exposures: list[float] = []

    def add(self, name: str, model: Any) -> None:
        self.models[name] = model

    def close(self) -> None:
        self.closed = True

    def measure(self, view: Viewpoint, lens: Lens, world: Any) -> Any:
        return Renderer.measured

    def colour(self, shots: Any, lens: Lens, exposure: float) -> Any:
        self.exposures.append(exposure)
        return "drawn"

    def numbers(self, lens: Lens) -> Any:
        return np.full((16, 16), 1, np.uint16)


MODELS = {name: SimpleNamespace(objects=objects) for name, objects in KNOWN.items()}


def studio_of(monkeypatch: pytest.MonkeyPatch, *cameras: CameraSpec) -> Studio:
    monkeypatch.setattr(studio, "Renderer", Renderer)
    monkeypatch.setattr(Renderer, "measured", np.zeros((16, 16, 3), np.float32))
    return Studio(cameras, cast(Any, MODELS), ("world",))


def camera(kind: str = "colour", **keys: Any) -> CameraSpec:
    return CameraSpec(name="bow", kind=cast(Any, kind), width_px=16, height_px=16, **keys)


def commission(*shots: Shot, seed: int = 5) -> Commission:
    response = ImageResponse(exposure=0.7, vignetting=0.0, read_noise=0.0, shot_noise=0.0, grain_at=(0, 0))
    middle = looks_north(WORLD, placed_boat())
    return Commission("bow", 3, 42, shots or (middle,), middle, response, seed)


def test_a_depth_image_has_metres_and_the_numbers_of_its_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    made = studio_of(monkeypatch, camera("depth"))
    Renderer.measured[..., 0], Renderer.measured[..., 1] = SEA_ID, 12.5
    Renderer.measured[4, 5, 0] = 3
    image = made.develop(commission(), made.draw(commission()))
    assert image.pixels.dtype == np.float32
    assert (image.pixels == 12.5).all()
    assert [one.name for one in image.objects] == ["boat"]
    assert image.horizon_px == pytest.approx((7.5, 7.5))
    assert (image.number, image.stamp_ns, image.encoded) == (3, 42, b"")
    assert image.pos_ned_m.tolist() == [0.0, 0.0, -2.0]


def test_a_segmentation_image_has_the_class_of_each_number(monkeypatch: pytest.MonkeyPatch) -> None:
    made = studio_of(monkeypatch, camera("segmentation"))
    Renderer.measured[0, :6, 0] = SKY_ID, SEA_ID, 1, 2, 3, 4
    image = made.develop(commission(), made.draw(commission()))
    assert image.pixels[0, :6].tolist() == [
        ObjectClass.SKY,
        ObjectClass.WATER,
        ObjectClass.BUOY,
        ObjectClass.BOOM,
        ObjectClass.VESSEL,
        ObjectClass.OTHER,
    ]


def test_a_thermal_image_is_in_hundredths_of_a_kelvin_with_its_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    made = studio_of(monkeypatch, camera("thermal"))
    Renderer.measured[..., 2] = 20.0
    first, again, other = (made.draw(commission(seed=seed)).pixels for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    off = first.astype(float) - 29_315.0
    assert first.dtype == np.uint16
    assert abs(off.mean()) < 1.5
    assert off.std() == pytest.approx(5.0, abs=1.0)  # 0.05 K


def test_truth_of_a_colour_image_is_drawn_once_if_it_is_one_shot(monkeypatch: pytest.MonkeyPatch) -> None:
    made = studio_of(monkeypatch, camera())
    Renderer.measured[..., 0] = 3
    middle = looks_north(WORLD, placed_boat())
    one, two = made.draw(commission()), made.draw(commission(middle, middle))
    assert one.numbers is not None
    assert two.numbers is not None
    assert (int(one.numbers[0, 0]), int(two.numbers[0, 0])) == (1, 3)
    assert Renderer.made.exposures == [0.7, 0.7]
    untrue = studio_of(monkeypatch, camera(truth=False))
    assert untrue.draw(commission()).numbers is None


def test_a_camera_without_truth_has_no_objects_and_no_horizon(monkeypatch: pytest.MonkeyPatch) -> None:
    made = studio_of(monkeypatch, camera("depth", truth=False))
    image = made.develop(commission(), Drawing(np.ones((16, 16), np.float32), np.full((16, 16), 3, np.uint16)))
    assert (image.objects, image.horizon_px, image.detections, image.found_horizon_px) == ((), None, (), None)


def test_a_detector_finds_objects_and_horizon_in_colour_images(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [Detection("buoy", (1.0, 2.0, 3.0, 4.0), 0.5)]
    detector = SimpleNamespace(detect=lambda pixels: found, find_horizon=lambda pixels: (3.0, 4.0))
    monkeypatch.setattr(studio, "load", lambda kinds, kind: lambda camera, lens: detector)
    made = studio_of(monkeypatch, camera(truth=False, detector=DetectorSpec(kind="mine")))
    made._sensors["bow"] = cast(Any, SimpleNamespace(expose=lambda drawn, response: np.zeros((16, 16, 3), np.uint8)))
    image = made.develop(commission(), Drawing(cast(Any, "drawn"), None))
    assert (image.detections, image.found_horizon_px) == (tuple(found), (3.0, 4.0))
    assert image.file_format == "jpeg"
    assert len(image.encoded) > 100


def test_models_are_added_and_the_renderer_released(monkeypatch: pytest.MonkeyPatch) -> None:
    made = studio_of(monkeypatch, camera("segmentation"))
    assert (made.device, Renderer.made.still) == ("a card", ("world",))
    made.add("body 0", cast(Any, SimpleNamespace(objects=(BUOY,))))
    assert list(Renderer.made.models) == ["world", "boat", "body 0"]
    Renderer.measured[0, 0, 0] = 7
    body = PlacedModel("body 0", np.zeros(3), np.eye(3), 7)
    shot = looks_north(body)
    drawn = made.draw(Commission("bow", 1, 0, (shot,), shot, commission().response))
    assert drawn.pixels[0, 0] == ObjectClass.BUOY
    made.close()
    assert Renderer.made.closed


# -- the messages between its process and the run


class Process:
    """Stands in for a process that draws. replies: what it sends, in turn."""

    gone = False

    def __init__(self, *given: Any) -> None:
        self.lose = given[1]
        self.sent: list[Any] = []
        self.replies: list[list[dict[str, Any]]] = [[{"device": "a card"}]]

    def start(self) -> None: ...

    def send(self, message: Any) -> None:
        self.sent.append(message)

    def receive(self, timeout_s: float) -> list[dict[str, Any]]:
        return self.replies.pop(0) if self.replies else []

    def close(self) -> None: ...


def remote(monkeypatch: pytest.MonkeyPatch, spec: CameraSpec, problems: list[str] | None = None) -> RemoteStudio:
    monkeypatch.setattr(remote_studio, "SideProcess", Process)
    made = RemoteStudio([spec], (problems if problems is not None else []).append)
    made.start({}, ())
    return made


def process_of(made: RemoteStudio) -> Process:
    return cast(Process, made._studios[0].process)


@pytest.mark.parametrize("kind", ["colour", "depth", "segmentation", "thermal"])
def test_an_image_arrives_as_it_was_taken(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    spec = CameraSpec(name="bow", kind=cast(Any, kind), width_px=96, height_px=64)
    taken = make_image(spec, 3)
    made = remote(monkeypatch, spec)
    shot = Shot(Viewpoint(taken.pos_ned_m, taken.rot_ned_optical), cast(Any, None))
    ticket = made.submit(Commission("bow", 3, taken.stamp_ns, (shot,), shot, commission().response))
    assert made.waiting == 1
    assert not made.ready(ticket)
    process_of(made).replies = [[], [message_of(taken, 12.5)]]
    assert not made.ready(ticket)
    assert made.ready(ticket)
    image = made.collect(ticket, decode=True)
    assert image is not None
    assert made.waiting == 0
    assert made.figures.processor_ms_per_image == 12.5
    if kind == "colour":
        np.testing.assert_allclose(image.pixels, taken.pixels, atol=4)
    else:
        np.testing.assert_array_equal(image.pixels, taken.pixels)
    for name in ("camera", "kind", "number", "stamp_ns", "objects", "horizon_px", "found_horizon_px", "encoded"):
        assert getattr(image, name) == getattr(taken, name), name
    assert image.pos_ned_m is taken.pos_ned_m


def test_an_image_that_nobody_reads_is_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = CameraSpec(name="bow", width_px=96, height_px=64)
    made = remote(monkeypatch, spec)
    taken = make_image(spec, 1)
    shot = Shot(Viewpoint(taken.pos_ned_m, taken.rot_ned_optical), cast(Any, None))
    ticket = made.submit(Commission("bow", 1, 0, (shot,), shot, commission().response))
    process_of(made).replies = [[message_of(taken, 1.0)]]
    image = made.collect(ticket, decode=False)
    assert image is not None
    assert image.pixels.size == 0
    assert image.encoded == taken.encoded


def test_detections_and_horizons_arrive_with_their_image(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = CameraSpec(name="bow", kind="depth", width_px=16, height_px=16)
    seen = SeenObject(
        "a", ObjectClass.DAM, (0.0, 1.0, 2.0, 3.0), 4, 5.0, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), (1.0,) * 3
    )
    taken = CameraImage(
        "bow", "depth", 1, 0, np.ones((16, 16), np.float32), studio.lens_of(spec), np.zeros(3), np.eye(3), (seen,),
        None, (4.0, 5.0), (Detection("dam", (1.0, 2.0, 3.0, 4.0), 0.75),),
    )  # fmt: skip
    made = remote(monkeypatch, spec)
    shot = Shot(Viewpoint(taken.pos_ned_m, taken.rot_ned_optical), cast(Any, None))
    tickets = [made.submit(Commission("bow", n, 0, (shot,), shot, commission().response)) for n in (1, 2)]
    process_of(made).replies = [[{"device": "again"}, message_of(taken, 1.0)], [], [message_of(taken, 2.0)]]
    first, second = (made.collect(ticket, decode=False) for ticket in tickets)
    assert first is not None
    assert second is not None
    assert (first.objects, first.horizon_px, first.found_horizon_px) == ((seen,), None, (4.0, 5.0))
    assert first.detections == taken.detections
    assert (first.number, second.number) == (1, 2)


def test_images_of_a_process_that_ended_are_missing_and_it_is_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    problems: list[str] = []
    made = remote(monkeypatch, camera("depth"), problems)
    ticket = made.submit(commission())
    process_of(made).lose(" with status 3")
    process_of(made).lose(" again")
    assert made.ready(ticket)
    assert made.collect(ticket, decode=True) is None
    assert problems == ["a process that draws the images of cameras ended with status 3; later images are missing"]


def test_a_detector_that_fails_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    made = remote(monkeypatch, camera("depth"))
    ticket = made.submit(commission())
    process_of(made).replies = [[{"problem": "detector mine: no"}]]
    with pytest.raises(remote_studio.PluginNodeError, match="detector mine: no"):
        made.collect(ticket, decode=True)


@pytest.mark.parametrize(
    ("replies", "gone", "told"),
    [([[], [{"problem": "no OpenGL"}]], False, "no OpenGL"), ([[]], True, "their process ended while it started")],
)
def test_a_machine_that_cannot_draw_is_told(
    monkeypatch: pytest.MonkeyPatch, replies: list[list[dict[str, Any]]], gone: bool, told: str
) -> None:
    class Broken(Process):
        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            self.replies, self.gone = list(replies), gone

    monkeypatch.setattr(remote_studio, "SideProcess", Broken)
    with pytest.raises(remote_studio.UserError, match=told):
        RemoteStudio([camera("depth")], pytest.fail).start({}, ())


def test_a_new_model_is_sent_to_every_process(monkeypatch: pytest.MonkeyPatch) -> None:
    made = remote(monkeypatch, camera("depth"))
    model = cast(Any, SimpleNamespace())
    made.add("body 0", model)
    assert process_of(made).sent[-1] == ("body 0", model)
