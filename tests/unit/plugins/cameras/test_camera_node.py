"""The cameras of a vessel, between a studio and a recorder that the test plays: when they expose, and what they see."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from synthetic_images import OWN, VESSEL, make_image

from sim_core import frames
from sim_core.environment.waves import FlatWater
from sim_core.sensors.camera_spec import CameraSpec, ExposureSpec, GimbalSpec, LensSpec
from sim_core.sensors.lens import Lens
from xitl_cli.errors import UserError
from xitl_cli.plugins.cameras import node
from xitl_cli.plugins.cameras.gimbal import ROT_FRD_OPTICAL
from xitl_cli.plugins.cameras.images import CameraFrame, CameraTruth, Detection, ObjectClass
from xitl_cli.plugins.cameras.node import OWN as OWN_MODEL
from xitl_cli.plugins.cameras.node import WORLD, CameraNode, box_angles_rad, calibration, image_annotations
from xitl_cli.plugins.cameras.studio import Commission
from xitl_cli.profile import load_profile
from xitl_cli.record.foxglove_types import foxglove_type
from xitl_cli.record.topics import CameraDetection
from xitl_cli.run.core.node import RunStep
from xitl_cli.seeds import Seeds

MS = 1_000_000
SITL = load_profile("sitl", ["environment.wind={mean_mps: 0}"]).runnable()
PHYSICS_HZ = SITL.clock.physics_rate_hz
STEP_NS = round(1e9 / PHYSICS_HZ)


class Studio:
    """Stands in for the process that draws. taken: commissions by ticket. lost: it has ended."""

    def __init__(self, cameras: Any, on_problem: Any, by_turns: bool) -> None:
        self.cameras, self.problem, self.by_turns = {camera.name: camera for camera in cameras}, on_problem, by_turns
        self.taken: dict[int, Commission] = {}
        self.models: list[str] = []
        self.figures = SimpleNamespace(device="a card", processor_ms_per_image=12.4)
        self.waiting, self.slow, self.lost = 0, False, False
        self.collected: list[tuple[int, bool]] = []
        self.detections: tuple[Detection, ...] = ()

    def add(self, name: str, model: Any) -> None:
        self.models.append(name)

    def submit(self, wanted: Commission) -> int:
        self.taken[len(self.taken) + 1] = wanted
        return len(self.taken)

    def ready(self, ticket: int) -> bool:
        return not self.slow

    def collect(self, ticket: int, decode: bool) -> Any:
        self.collected.append((ticket, decode))
        if self.lost:
            return None
        wanted = self.taken[ticket]
        image = make_image(self.cameras[wanted.camera], wanted.number)
        return replace(image, stamp_ns=wanted.stamp_ns, detections=self.detections)

    def close(self) -> None: ...


class Recorder:
    """Keeps what is recorded."""

    def __init__(self, read: bool = False) -> None:
        self.messages: list[tuple[str, int, Any]] = []
        self.records: list[tuple[int, Any]] = []
        self.topics: list[str] = []
        self._read = read

    def add_topic(self, topic: Any) -> None:
        self.topics.append(topic.name)

    def message(self, topic: str, stamp_ns: int, message: Any) -> None:
        self.messages.append((topic, stamp_ns, message))

    def write(self, stamp_ns: int, record: Any) -> None:
        self.records.append((stamp_ns, record))

    def read_in_run(self, *topics: str) -> bool:
        return self._read

    def stamps_ms(self, topic: str = "/cameras/bow/image") -> list[float]:
        return [stamp_ns / MS for name, stamp_ns, _ in self.messages if name == topic]


class Cruise:
    """A vessel that goes north at 2 m/s and turns at `turn_radps`, with cameras."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        *cameras: CameraSpec,
        lockstep: bool = True,
        turn_radps: float = 0.0,
        profile: Any = SITL,
        recorder: Recorder | None = None,
    ) -> None:
        monkeypatch.setattr(node, "RemoteStudio", Studio)
        outputs = SimpleNamespace(report=lambda: {}, poll=lambda now_ns: None, close=lambda: None, show=None)
        monkeypatch.setattr(node, "CameraOutputs", lambda *given: outputs)
        monkeypatch.setattr(node, "StreamServers", SimpleNamespace(of_run=lambda scenery: None))
        wind = SimpleNamespace(velocity_ned_mps=lambda state, time_s: np.array([[3.0, 1.0, 0.0]]))
        tide = SimpleNamespace(height_m=lambda time_s: 0.1 * time_s, bounds_m=(0.0, 0.0))
        environment = SimpleNamespace(wind=wind, waves=FlatWater(), tide=tide)
        self.plant = SimpleNamespace(
            simulation=SimpleNamespace(environment=environment),
            state=SimpleNamespace(environment=SimpleNamespace(wind=None), debris=SimpleNamespace(bodies=()), time_ns=0),
            others=("b",),
            bodies=lambda: SimpleNamespace(meshes=(), pos_ned_m=(), vel_ned_mps=(), rot_ned_body=()),
        )
        mode = "lockstep" if lockstep else "realtime"
        clock = SimpleNamespace(physics_rate_hz=PHYSICS_HZ, mode=mode)
        of_run = SimpleNamespace(
            clock=clock, environment=profile.environment, site=profile.site, vehicle=profile.vehicle, vessel="",
            name="sitl",
        )  # fmt: skip
        context = SimpleNamespace(
            profile=of_run,
            plant=self.plant,
            scenery=SimpleNamespace(water_down_m=0.5),
            seeds=Seeds(1),
            components_url=None,
        )
        self.node = CameraNode(cameras, cast(Any, context))
        self.node._models = cast(Any, {name: SimpleNamespace(objects=(1, 2, 3)) for name in (WORLD, OWN_MODEL)})
        self.studio = cast(Studio, self.node._studio)
        self.recorder = recorder or Recorder()
        self.node.begin(cast(Any, SimpleNamespace(recorder=self.recorder)))
        self._turn_radps = turn_radps
        self.number = 0

    def sail(self, seconds: float) -> None:
        for _ in range(round(seconds * PHYSICS_HZ)):
            self.number += 1
            if self.number % self.node.sense_every == 0:
                self.node.sense(self.step())

    def step(self) -> RunStep:
        now_ns = self.number * STEP_NS
        time_s = now_ns * 1e-9
        self.plant.state.time_ns = now_ns
        rotation = frames.quat_to_matrix(frames.euler_to_quat(np.array([[0.0, 0.0, self._turn_radps * time_s]])))
        motion = SimpleNamespace(
            pos_ned_m=np.array([[2.0 * time_s, 0.0, 0.0]]),
            rot_ned_frd=rotation,
            vel_ned_mps=np.array([[2.0, 0.0, 0.0]]),
        )
        return cast(RunStep, SimpleNamespace(now_ns=now_ns, number=self.number, motion=motion))


def read(message: Any) -> Any:
    """A message of foxglove by its fields."""
    return foxglove_type(type(message).__name__).FromString(message.encode())


def bow(**keys: Any) -> CameraSpec:
    return CameraSpec(name="bow", width_px=96, height_px=64, **{"latency_s": 0.05, **keys})


def test_images_are_taken_at_their_rate_and_recorded_with_their_stamps(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0), recorder=Recorder(read=True))
    cruise.sail(0.31)
    assert cruise.recorder.stamps_ms() == [100.0, 200.0]  # the third one is under way
    cruise.sail(0.05)
    assert cruise.recorder.stamps_ms() == [100.0, 200.0, 300.0]
    commissions = list(cruise.studio.taken.values())
    assert [one.number for one in commissions] == [1, 2, 3]
    view = commissions[1].middle.view
    assert view.pos_ned_m == pytest.approx([0.4 + 0.5, 0.0, -0.8])  # at 0.2 s, 0.5 m before the middle
    np.testing.assert_allclose(view.rot_ned_optical, ROT_FRD_OPTICAL, atol=1e-12)
    assert commissions[0].shots == (commissions[0].middle,)
    world = commissions[1].middle.world
    assert (world.time_s, world.wind_ne_mps.tolist()) == (0.2, [3.0, 1.0])
    assert world.water_down_m == pytest.approx(0.5 - 0.02)


def test_images_that_nobody_reads_are_recorded_half_a_second_later_in_lockstep(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0))
    cruise.sail(0.59)
    assert cruise.recorder.stamps_ms() == []
    cruise.sail(0.02)
    assert cruise.recorder.stamps_ms() == [100.0]
    cruise.node.end()
    assert cruise.recorder.stamps_ms() == [100.0, 200.0, 300.0, 400.0, 500.0, 600.0]
    assert cruise.studio.collected[0] == (1, False)
    assert cruise.node.report()["cameras"]["by_name"]["bow"]["images"] == 6


def test_a_listener_gets_each_image_decoded_after_its_latency(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0))
    heard: list[int] = []
    cruise.node.subscribe(lambda image: heard.append(image.stamp_ns // MS))
    cruise.sail(0.26)
    assert heard == [100, 200]
    assert cruise.studio.collected == [(1, True), (2, True)]


def test_the_stamp_is_the_middle_of_the_exposure_which_ends_before_the_image_is_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    exposure = ExposureSpec(time_s=0.02, readout_s=0.02)
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0, exposure=exposure), recorder=Recorder(read=True))
    assert cruise.node.sense_every == 1
    cruise.sail(0.13)
    assert cruise.studio.taken == {}
    cruise.sail(0.011)
    (wanted,) = cruise.studio.taken.values()
    assert wanted.stamp_ns == 120 * MS
    cruise.sail(0.08)
    cruise.node.end()
    assert cruise.node.report()["cameras"]["by_name"]["bow"]["unfinished"] == 1  # begun at 0.2 s


def test_a_turn_is_drawn_in_bands_and_shots_whose_shares_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    lens = LensSpec(view_deg=70.0)
    exposure = ExposureSpec(time_s=0.02, readout_s=0.02)
    cruise = Cruise(monkeypatch, bow(rate_hz=5.0, exposure=exposure, lens=lens), turn_radps=1.4)
    cruise.sail(0.3)
    (wanted,) = cruise.studio.taken.values()
    # Half of exposure and readout are 20 ms: in 40 ms it turns by 0.056 rad, on a lens of 68.6 px: 3.8 px.
    focal_px = Lens.from_spec(lens, 96, 64).focal_px
    assert 0.056 * focal_px == pytest.approx(3.84, abs=0.01)
    bands = sorted({shot.rows for shot in wanted.shots if shot.rows})
    assert bands == [(0, 32), (32, 64)]
    assert len(wanted.shots) == 2 * 2
    assert [shot.share for shot in wanted.shots] == [0.5] * 4
    # Each half image is exposed for 20 ms around its time, 5 ms before and after the stamp; a shot is half of that.
    yaws = [math.atan2(shot.view.rot_ned_optical[1, 2], shot.view.rot_ned_optical[0, 2]) for shot in wanted.shots]
    middle_s = wanted.stamp_ns * 1e-9
    assert middle_s == pytest.approx(0.22)
    expected = [1.4 * (middle_s + band + shot) for band in (-0.005, 0.005) for shot in (-0.005, 0.005)]
    assert yaws == pytest.approx(expected, abs=1e-4)


def test_a_vessel_that_does_not_turn_needs_one_shot(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=5.0, exposure=ExposureSpec(time_s=0.02, readout_s=0.02)))
    cruise.sail(0.3)
    (wanted,) = cruise.studio.taken.values()
    (shot,) = wanted.shots
    assert (shot.rows, shot.share) == (None, 1.0)


@pytest.mark.medium
def test_images_are_lost_by_their_share_and_the_numbers_show_it(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=20.0, drop_share=0.4))
    cruise.sail(10.0)
    cruise.node.end()
    counts = cruise.node.report()["cameras"]["by_name"]["bow"]
    assert counts["images"] + counts["lost"] == 200
    assert counts["lost"] == pytest.approx(80, abs=21)  # three standard deviations
    numbers = [wanted.number for wanted in cruise.studio.taken.values()]
    assert numbers == sorted(set(numbers))
    assert len(numbers) == counts["images"]


def test_a_slow_machine_skips_images_in_real_time_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0), lockstep=False)
    cruise.studio.waiting = 3
    cruise.sail(0.21)
    cruise.studio.waiting = 2
    cruise.sail(0.2)
    report = cruise.node.report()
    assert report["cameras"]["by_name"]["bow"]["skipped"] == 2
    assert report["warnings"] == [
        "camera bow: 2 of 4 images were skipped, as one needs 12 ms of processor time here; lower its rate_hz, "
        "width_px and height_px"
    ]
    assert (report["cameras"]["renderer"], report["cameras"]["processor_ms_per_image"]) == ("a card", 12.4)


def test_images_that_are_not_ready_in_real_time_are_late(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0), lockstep=False)
    cruise.studio.slow = True
    cruise.sail(0.21)
    assert cruise.recorder.messages == []
    cruise.studio.slow = False
    cruise.sail(0.1)
    counts = cruise.node.report()["cameras"]["by_name"]["bow"]
    assert (counts["images"], counts["late"]) == (2, 1)


def test_images_of_a_process_that_ended_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0))
    cruise.sail(0.2)
    cruise.studio.lost = True
    cruise.studio.problem("it ended")
    cruise.node.end()
    report = cruise.node.report()
    assert report["cameras"]["by_name"]["bow"]["missing"] == 2
    assert report["warnings"] == ["it ended"]


def test_what_is_in_an_image_is_recorded_with_its_number(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0), recorder=Recorder(read=True))
    cruise.studio.detections = (Detection("buoy", (40.0, 30.0, 50.0, 34.0), 0.75),)
    cruise.sail(0.16)
    records = {type(record): record for _, record in cruise.recorder.records}
    frame = records[CameraFrame]
    assert (frame.camera, frame.image, frame.position_ned_m) == ("bow", 1, [1.0, 2.0, -1.5])
    assert (frame.horizon_left_px, frame.horizon_right_px) == (10.0, 12.0)
    assert math.isnan(frame.found_left_px)
    truths = [record for _, record in cruise.recorder.records if isinstance(record, CameraTruth)]
    assert [truth.object for truth in truths] == ["alpha", "body 3", "sitl"]
    first = truths[0]
    assert (first.label, first.left_px, first.top_px, first.right_px, first.bottom_px) == ("vessel", *VESSEL.box_px)
    assert (first.pixels, first.centre_optical_m, first.size_m) == (800, [-1.5, 0.2, 25.0], [4.0, 1.5, 1.2])
    detection = records[CameraDetection]
    assert (detection.label, detection.confidence) == ("buoy", 0.75)
    assert [name for name, _, _ in cruise.recorder.messages] == [
        "/cameras/bow/image",
        "/cameras/bow/calibration",
        "/cameras/bow/annotations",
    ]
    assert {"/cameras/bow/image", "/cameras/bow/annotations"} <= set(cruise.recorder.topics)


def test_a_depth_image_is_recorded_in_metres_by_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = bow(rate_hz=10.0, kind="depth", truth=False)
    cruise = Cruise(monkeypatch, camera, recorder=Recorder(read=True))
    cruise.sail(0.16)
    picture = read(cruise.recorder.messages[0][2])
    values = np.frombuffer(picture.data, "<f4").reshape(picture.height, picture.width)
    np.testing.assert_array_equal(values, make_image(camera, 1).pixels)
    assert (picture.encoding, picture.step, picture.frame_id) == ("32FC1", 4 * 96, "camera_bow_optical")
    assert [name for name, _, _ in cruise.recorder.messages] == ["/cameras/bow/image", "/cameras/bow/calibration"]


def test_bodies_are_where_they_were_at_the_exposure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node, "hull_model", lambda name, mesh: SimpleNamespace(objects=(1,)))
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0, exposure=ExposureSpec(time_s=0.04)))
    cruise.plant.bodies = lambda: SimpleNamespace(
        meshes=("hull",),
        pos_ned_m=np.array([[50.0, 7.0, 0.0]]),
        vel_ned_mps=np.array([[10.0, 0.0, 0.0]]),
        rot_ned_body=np.array([np.eye(3)]),
    )
    cruise.sail(0.15)
    (wanted,) = cruise.studio.taken.values()
    world, own, other = wanted.middle.world.placed
    assert (world.first_id, own.first_id, other.first_id) == (1, 4, 5)
    assert (world.model, own.model, other.model) == (WORLD, OWN_MODEL, "b")
    drawn_s = 0.14  # the exposure has ended
    assert other.pos_ned_m == pytest.approx([50.0 - 10.0 * (drawn_s - wanted.stamp_ns * 1e-9), 7.0, 0.0])
    assert cruise.studio.models == ["b"]


@pytest.mark.medium
def test_the_wake_is_where_the_vessel_was_and_spreads(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=1.0))
    cruise.sail(1.0)
    (trail,) = list(cruise.studio.taken.values())[-1].middle.world.foam
    vehicle = SITL.vehicle
    # A place every 0.4 s, the newest first
    stamps_s = np.array([pose[0] for pose in reversed(cruise.node._wake)]) * 1e-9
    assert np.diff(stamps_s) == pytest.approx(-0.4, abs=0.01)
    middle = 0.5 * (trail.left_ne_m + trail.right_ne_m)
    np.testing.assert_allclose(middle[:, 0], 2.0 * stamps_s - 0.5 * vehicle.length_m, atol=1e-9)
    half_m = 0.3 * vehicle.width_m * (1.0 + 0.5 * np.sqrt(1.0 - stamps_s))
    np.testing.assert_allclose(trail.left_ne_m[:, 1], -half_m, atol=1e-9)
    np.testing.assert_allclose(trail.right_ne_m[:, 1], half_m, atol=1e-9)
    share = np.clip(1.6 * 2.0 / math.sqrt(9.81 * vehicle.length_m), 0.0, 0.8) * np.exp(-(1.0 - stamps_s) / 9.0)
    np.testing.assert_allclose(trail.share, share, atol=1e-9)
    cruise.sail(30.0)
    assert (cruise.node._wake[-1][0] - cruise.node._wake[0][0]) * 1e-9 <= 25.0


def test_there_is_no_wake_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0))
    cruise.sail(0.11)
    assert next(iter(cruise.studio.taken.values())).middle.world.foam == ()


def sun_of(monkeypatch: pytest.MonkeyPatch, *overrides: str) -> list[tuple[float, float]]:
    """Elevation and azimuth at 0.1 and 10.2 s, in degrees."""
    suns: list[np.ndarray] = []
    daylight = node.daylight
    monkeypatch.setattr(node, "daylight", lambda sun, clouds: (suns.append(sun), daylight(sun, clouds))[1])
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0), profile=load_profile("sitl", list(overrides)).runnable())
    cruise.sail(10.21)
    assert len(suns) == 2  # renewed every ten seconds
    return [(math.degrees(math.asin(-sun[2])), math.degrees(math.atan2(sun[1], sun[0])) % 360.0) for sun in suns]


@pytest.mark.medium
def test_the_sun_stands_where_the_profile_says(monkeypatch: pytest.MonkeyPatch) -> None:
    assert sun_of(monkeypatch)[0] == pytest.approx((35.0, 140.0))
    low = sun_of(monkeypatch, "environment.light={sun_elevation_deg: 10, sun_azimuth_deg: 250}")
    assert low[0] == pytest.approx((10.0, 250.0))


@pytest.mark.medium
def test_the_sun_moves_with_the_time_of_the_day(monkeypatch: pytest.MonkeyPatch) -> None:
    site = "site={latitude_deg: 0.0, longitude_deg: 0.0}"
    first, later = sun_of(monkeypatch, site, 'environment.start_utc="2026-03-20T09:07:30Z"')
    assert first[0] == pytest.approx(45.0, abs=0.6)  # three hours before noon of an equinox, at the equator
    assert first[1] == pytest.approx(90.0, abs=1.0)
    assert later[0] - first[0] == pytest.approx(10.1 / 240.0, abs=0.005)  # 15° an hour


def test_a_gimbal_is_pointed_and_turns_at_its_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    cruise = Cruise(monkeypatch, bow(rate_hz=10.0, gimbal=GimbalSpec(rate_degps=60.0)))
    cruise.node.point("bow", 0.0, 30.0)
    cruise.sail(0.25)
    angles = cruise.node._angles("bow")
    assert (angles.pitch_deg, angles.yaw_deg) == pytest.approx((0.0, 15.0), abs=3.1)  # 60°/s for 0.2 to 0.25 s
    cruise.sail(1.0)
    assert cruise.node._angles("bow").yaw_deg == pytest.approx(30.0)


@pytest.mark.parametrize("inside", [True, False])
def test_a_camera_inside_a_hull_is_refused(monkeypatch: pytest.MonkeyPatch, inside: bool) -> None:
    hull = SITL.vehicle.demi_hulls[0]
    north, east, down = hull.keel_frd_m
    middle = (north, east, down - 0.5 * hull.height_m)
    place = middle if inside else (north, east, down - hull.height_m - 0.01)
    cruise = Cruise(monkeypatch, bow(position_frd_m=place))
    if inside:
        with pytest.raises(UserError, match=r"sensors\.cameras\.0\.position_frd_m = .* is inside a hull; use a down "):
            cruise.node._refuse_hidden()
    else:
        cruise.node._refuse_hidden()


# -- messages


def test_the_angles_of_a_box_are_those_of_its_edges() -> None:
    lens = Lens.from_spec(LensSpec(view_deg=90.0), 101, 61)  # 50 px from the middle to the side: 45°
    focal = lens.focal_px
    middle_x, middle_y = lens.centre_px
    box = (
        middle_x,
        middle_y - focal * math.tan(0.1),
        middle_x + focal * math.tan(0.3),
        middle_y + focal * math.tan(0.2),
    )
    bearing, width, low, high = box_angles_rad(lens, ROT_FRD_OPTICAL, box)
    assert (bearing, width) == pytest.approx((0.15, 0.3))
    assert low < 0.0 < high
    across = 0.5 * math.tan(0.3)  # of the middle of the box
    assert low == pytest.approx(-math.atan(math.tan(0.2) / math.hypot(1.0, across)))
    assert high == pytest.approx(math.atan(math.tan(0.1) / math.hypot(1.0, across)))
    astern = frames.quat_to_matrix(frames.euler_to_quat(np.array([0.0, 0.0, math.pi]))) @ ROT_FRD_OPTICAL
    bearing, width, _, _ = box_angles_rad(lens, astern, (middle_x - 10.0, 20.0, middle_x + 10.0, 40.0))
    assert abs(bearing) == pytest.approx(math.pi)
    assert width == pytest.approx(2.0 * math.atan(10.0 / focal))


@pytest.mark.parametrize(("model", "name"), [("pinhole", "plumb_bob"), ("fisheye", "kannala_brandt")])
def test_a_calibration_is_in_the_terms_of_ros(model: Any, name: str) -> None:
    lens = Lens.from_spec(LensSpec(model=model, view_deg=80.0, distortion=(0.1, 0.02)), 640, 480)
    message = read(calibration(lens, 3_000_000_000, "optical"))
    assert (message.width, message.height, message.distortion_model, message.frame_id) == (640, 480, name, "optical")
    focal, (x, y) = lens.focal_px, lens.centre_px
    assert list(message.K) == pytest.approx([focal, 0.0, x, 0.0, focal, y, 0.0, 0.0, 1.0])
    assert list(message.P) == pytest.approx([focal, 0.0, x, 0.0, 0.0, focal, y, 0.0, 0.0, 0.0, 1.0, 0.0])
    assert list(message.R) == np.eye(3).ravel().tolist()
    assert list(message.D)[:2] == pytest.approx([0.1, 0.02])


def test_boxes_are_drawn_around_other_objects_than_the_vessel_itself() -> None:
    image = make_image(CameraSpec(name="bow", width_px=96, height_px=64), 2)
    assert OWN.kind is ObjectClass.OWN_VESSEL
    drawn = read(image_annotations(image))
    assert [text.text for text in drawn.texts] == ["alpha", "body 3"]
    left, top, right, bottom = VESSEL.box_px
    corners = [(point.x, point.y) for point in drawn.points[0].points]
    assert corners == [(left, top), (right, top), (right, bottom), (left, bottom)]
    assert (drawn.texts[0].position.x, drawn.texts[0].position.y) == (left, top)
