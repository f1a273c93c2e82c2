"""Logs as a scene: where vessels are at any instant, on one time line and in one map."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from eastward_run import SECONDS, SPEED_MPS, run_file
from mcap.writer import Writer

import xitl_cli.logs.signals as signals
from tests.golden import Golden
from tests.recorded import CALM, LINUX, MISSION_TLOG
from xitl_cli.errors import UserError
from xitl_cli.logs import LogError, open_log
from xitl_cli.plugins.view import pictures
from xitl_cli.plugins.view.camera import FOLLOW, usual_pose
from xitl_cli.plugins.view.recording import action_text, open_scene
from xitl_cli.plugins.view.replay_page import checked_span
from xitl_cli.plugins.view.tracks import ObstacleSightings, heading_deg

Messages = Iterable[tuple[str, int, dict[str, Any]]]


def json_file(path: Path, messages: Messages) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels: dict[str, int] = {}
        for topic, stamp_ns, message in messages:
            if topic not in channels:
                schema = writer.register_schema(topic.strip("/"), "jsonschema", b"{}")
                channels[topic] = writer.register_channel(topic, "json", schema)
            writer.add_message(channels[topic], stamp_ns, json.dumps(message).encode(), stamp_ns)
        writer.finish()
    return path


def vector(x: float, y: float, z: float = 0.0) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def turned(heading_deg: float) -> dict[str, float]:
    """From FLU to ENU."""
    half = math.radians(90.0 - heading_deg) / 2.0
    return {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}


def poses(wrap: Callable[[dict[str, Any], dict[str, float]], dict[str, Any]], topic: str, heading: float) -> Messages:
    """North at 1 m/s from (30, 40) for ten seconds."""
    for step in range(11):
        yield topic, step * 1_000_000_000, wrap(vector(30.0, 40.0 + step), turned(heading))


SHAPES: dict[str, Callable[[dict[str, Any], dict[str, float]], dict[str, Any]]] = {
    "nav_msgs/Odometry": lambda place, turn: {"pose": {"pose": {"position": place, "orientation": turn}}},
    "foxglove.PoseInFrame": lambda place, turn: {"frame_id": "map", "pose": {"position": place, "orientation": turn}},
    "foxglove.FrameTransform": lambda place, turn: {"child_frame_id": "hull", "translation": place, "rotation": turn},
    "tf2_msgs/TFMessage": lambda place, turn: {
        "transforms": [{"child_frame_id": "hull", "transform": {"translation": place, "rotation": turn}}]
    },
}


def test_a_run_is_where_it_was_between_its_samples_too(tmp_path: Path) -> None:
    with open_scene([run_file(tmp_path / "run.mcap")]) as recording:
        assert recording.span_s == (0.0, 20.0)
        instant = recording.instant(7.03)
        vessel = instant.vessels[""]
        np.testing.assert_allclose(vessel.position_enu_m, [SPEED_MPS * 7.03, 0.0, 0.0], atol=1e-9)
        assert heading_deg(vessel.attitude_wxyz) == pytest.approx(90.0, abs=1e-6)
        assert vessel.estimate_position_enu_m is not None
        assert vessel.estimate_position_enu_m[1] == pytest.approx(0.5)
        assert vessel.numbers["estimate off m"] == pytest.approx(0.5)
        assert vessel.numbers["speed m/s"] == pytest.approx(SPEED_MPS)
        assert vessel.numbers["speed through water m/s"] == pytest.approx(math.hypot(SPEED_MPS - 0.5, 0.25))
        assert vessel.motors == pytest.approx((0.4, -0.2))
        assert (instant.wind_en_mps, instant.current_en_mps) == ((1.0, -3.0), (0.5, 0.25))
        assert [recording.instant(at).vessels[""].armed for at in (4.0, 6.0)] == [False, True]
        assert ("armed", 5.0) in [(mark.text, mark.time_s) for mark in recording.marks]


def test_before_and_behind_its_log_a_vessel_stays(tmp_path: Path) -> None:
    with open_scene([run_file(tmp_path / "run.mcap")]) as recording:
        first, last = (recording.instant(at).vessels[""].position_enu_m[0] for at in (-5.0, 99.0))
        assert (first, last) == pytest.approx((0.0, SPEED_MPS * SECONDS))


def test_a_recording_without_a_scene_has_a_plain_boat_on_plain_water(tmp_path: Path) -> None:
    with open_scene([run_file(tmp_path / "run.mcap")]) as recording:
        assert recording.scene.vessels[""].meshes
        assert recording.scene.water.waves is None
        assert recording.scene.water.centre_en_m[0] == pytest.approx(20.0)
        said = "\n".join(recording.scene.notes)
    assert "has no scene" in said
    assert "a plain boat of 2 m is drawn" in said


@pytest.mark.parametrize("kind", SHAPES)
def test_poses_of_other_tools_are_read(tmp_path: Path, kind: str) -> None:
    path = json_file(tmp_path / "other.mcap", poses(SHAPES[kind], "/boat", 330.0))
    with open_scene([path]) as recording:
        vessel = recording.instant(recording.span_s[0] + 2.5).vessels[""]
        np.testing.assert_allclose(vessel.position_enu_m, [30.0, 42.5, 0.0], atol=1e-9)
        assert heading_deg(vessel.attitude_wxyz) == pytest.approx(330.0, abs=1e-6)


def test_of_many_frames_the_one_that_moves_is_the_vessel(tmp_path: Path) -> None:
    def both() -> Messages:
        wrap = SHAPES["foxglove.FrameTransform"]
        for topic, stamp_ns, message in poses(wrap, "/tf", 10.0):
            mast = {"child_frame_id": "mast", "translation": vector(0.1, 0.0, 1.5), "rotation": turned(90.0)}
            yield topic, stamp_ns, mast
            yield topic, stamp_ns + 1, message

    with open_scene([json_file(tmp_path / "tf.mcap", both())]) as recording:
        vessel = recording.instant(recording.span_s[1]).vessels[""]
        np.testing.assert_allclose(vessel.position_enu_m[:2], [30.0, 50.0], atol=1e-9)


@pytest.mark.medium
def test_two_logs_are_laid_by_an_event_and_by_their_places_on_the_earth() -> None:
    with open_scene([CALM, LINUX]) as recording:
        assert len(recording.names) == 2
        assert "navigated by itself" in recording.scene.notes[0]
        marked = {mark.text: mark.time_s for mark in reversed(recording.marks)}
        assert marked[f"{CALM.name}: mode AUTO"] == pytest.approx(marked[f"{LINUX.name}: mode AUTO"], abs=0.1)
        here, there = (recording.track(name).pose for name in recording.names)
        for log_path, track in ((CALM, here), (LINUX, there)):
            with open_log(log_path) as log:
                of = "truth" if log_path == CALM else "estimate"
                way = signals.position_geodetic(log, of)  # type: ignore[arg-type]
                assert way is not None
                corners_deg = way.values[[0, len(way.values) // 2], :2]
            moved = track.position_enu_m[len(track.position_enu_m) // 2] - track.position_enu_m[0]
            assert np.hypot(*moved[:2]) == pytest.approx(sphere_m(*corners_deg), abs=0.3)


def sphere_m(one_deg: np.ndarray, other_deg: np.ndarray) -> float:
    """Haversine on ArduPilot's sphere, whose simulator made these logs."""
    (lat, lon), (lat_b, lon_b) = np.radians(one_deg), np.radians(other_deg)
    h = math.sin((lat_b - lat) / 2) ** 2 + math.cos(lat) * math.cos(lat_b) * math.sin((lon_b - lon) / 2) ** 2
    return 2.0 * 6378100.0 * math.asin(math.sqrt(h))


@pytest.mark.medium
def test_without_a_common_place_both_begin_at_one_start_and_it_is_said(tmp_path: Path) -> None:
    other = json_file(tmp_path / "indoor.mcap", poses(SHAPES["nav_msgs/Odometry"], "/odom", 0.0))
    with open_scene([CALM, other]) as recording:
        _, second = recording.names
        start_s = max(recording.track(name).pose.span_s[0] for name in recording.names)
        first_place, second_place = (
            recording.instant(start_s).vessels[name].position_enu_m for name in recording.names
        )
        np.testing.assert_allclose(second_place, first_place, atol=1e-6)
        assert any(note.startswith(f"{second}: has no place on the Earth") for note in recording.scene.notes)


def test_a_boat_by_its_receiver_is_on_the_water() -> None:
    with open_scene([MISSION_TLOG]) as recording:
        assert np.abs(recording.track("").pose.position_enu_m[:, 2]).max() == 0.0


def test_a_log_without_attitude_is_refused_in_a_sentence(tmp_path: Path, golden: Golden) -> None:
    fixes = [("/fix", step * 10**9, {"latitude": -8.8, "longitude": -63.9, "altitude": 70.0}) for step in range(3)]
    path = json_file(tmp_path / "fix.mcap", fixes)
    with pytest.raises(LogError) as refused:
        open_scene([path])
    golden("error", refused.value)
    with open_scene([path, run_file(tmp_path / "run.mcap")]) as recording:
        assert recording.names == ("",)
        assert any("has no attitude" in note for note in recording.scene.notes)


def test_a_recording_that_was_cut_off_plays_as_far_as_it_goes(tmp_path: Path) -> None:
    path = run_file(tmp_path / "run.mcap")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 6 // 10])
    with open_scene([path]) as recording:
        assert 1.0 < recording.span_s[1] <= SECONDS
        assert recording.instant(1.0).vessels[""].position_enu_m[0] == pytest.approx(SPEED_MPS)


def test_a_span_outside_of_the_recording_is_refused(tmp_path: Path, golden: Golden) -> None:
    with open_scene([run_file(tmp_path / "run.mcap")]) as recording:
        assert checked_span(recording, 5.0, 99.0).length_s == pytest.approx(15.0)
        with pytest.raises(UserError) as refused:
            checked_span(recording, 30.0)
        golden("error", refused.value, "30 s", "20 s", "0.00 s", "20.00 s")


def test_actions_are_told_in_words() -> None:
    assert action_text('{"action": "wind", "mean_mps": 6, "vessel": ""}') == "wind mean_mps 6"
    assert action_text("no JSON") == "no JSON"


@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_a_moving_picture_has_its_frames_in_either_format(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: Literal["gif", "webp"]
) -> None:
    image = pytest.importorskip("PIL.Image")

    @contextmanager
    def photographer(*_: object) -> Iterator[Callable[[float], Any]]:
        yield lambda at_s: image.new("RGB", (64, 64), (round(10 * at_s), 100, 50))

    monkeypatch.setattr(pictures, "_photographer", photographer)
    with open_scene([run_file(tmp_path / "run.mcap")]) as recording:
        film = pictures.moving_picture(recording, 4.0, 12.0, speed=2.0, rate_hz=2.0, kind=kind)
    with image.open(io.BytesIO(film)) as shown:
        assert (shown.format, shown.n_frames) == (kind.upper(), 8)
        shown.seek(7)
        red, green, blue = shown.convert("RGB").getpixel((32, 32))
    assert (red, green, blue) == pytest.approx((110, 100, 50), abs=6)


def test_a_picture_from_behind_is_taken_by_the_camera_of_the_live_view(tmp_path: Path) -> None:
    with open_scene([run_file(tmp_path / "run.mcap")]) as recording:
        instant = recording.instant(7.0)
        camera = pictures.camera_view("behind", recording, instant)
        length_m = recording.scene.vessels[""].length_m
    offset_m = np.subtract(camera.position_enu_m, instant.vessels[""].position_enu_m)
    assert offset_m == pytest.approx(usual_pose(FOLLOW, length_m).offset_m(0.0))  # it heads east
    assert offset_m[0] < 0.0 < offset_m[2]


def test_obstacles_of_a_recording_have_their_latest_class() -> None:
    sightings = ObstacleSightings(
        np.array([1.0, 1.0, 2.0, 2.0]),
        np.array([1, 2, 1, 2]),
        np.arange(12.0).reshape(4, 3),
        np.ones(4),
        np.array(["", "", "buoy", ""]),
        np.array([0.0, 0.0, 0.75, 0.0]),
    )
    centres, _, classes = sightings.at(2.1)
    assert (centres[:, 0].tolist(), classes) == ([6.0, 9.0], ("buoy 75 %", ""))
    assert sightings.at(1.5)[2] == ("", "")
    assert sightings.at(9.0)[2] == ()
