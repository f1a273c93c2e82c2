"""Drawings of plug-ins that last a moment: at their time in a recording, live, and never in the surroundings."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from foxglove import messages

from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.kinematics import Kinematics
from xitl_cli.plugins.view.live_view import VesselWatch
from xitl_cli.plugins.view.recording import open_scene
from xitl_cli.plugins.view.scene import make_view_scene, passing_at, read_passing, read_scene_updates
from xitl_cli.record.recorder import Recorder, timestamp


def update(at_s: int, east_m: float, lifetime_s: float = 2.0, name: str = "radar") -> messages.SceneUpdate:
    """A ball in the map."""
    place = messages.Vector3(x=east_m, y=0.0, z=1.0)
    pose = messages.Pose(position=place, orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
    size, colour = messages.Vector3(x=1.0, y=1.0, z=1.0), messages.Color(r=1.0, g=0.0, b=0.0, a=1.0)
    ball = messages.SpherePrimitive(pose=pose, size=size, color=colour)
    lifetime = messages.Duration.from_secs(lifetime_s)
    stamp = timestamp(at_s * 1_000_000_000)
    entity = messages.SceneEntity(timestamp=stamp, frame_id="map", id=name, lifetime=lifetime, spheres=[ball])
    return messages.SceneUpdate(entities=[entity])


def middles(drawings: Any) -> dict[str, float]:
    """East coordinate of the middle of each drawing."""
    return {name: round(float(np.mean(meshes[0].vertices_m[:, 0])), 2) for name, meshes in drawings.items()}


def test_an_entity_with_a_lifetime_is_no_part_of_the_surroundings() -> None:
    entities = read_scene_updates(update(1, 5.0).encode(), update(1, 7.0, 0.0, "buoy").encode())
    assert [mesh.name for mesh in make_view_scene("run", entities).meshes] == ["buoy 0"]
    assert [entity.name for entity in read_passing(entities)] == ["radar"]


@pytest.mark.parametrize(
    ("time_s", "shown"), [(0.9, False), (1.0 - 1e-9, True), (1.0, True), (2.9, True), (3.0, False)]
)
def test_it_is_shown_from_its_stamp_for_its_lifetime(time_s: float, shown: bool) -> None:
    (entity,) = read_scene_updates(update(1, 5.0).encode())
    assert middles(passing_at({"radar": entity}, time_s)) == ({"radar": 5.0} if shown else {})


def test_a_recording_shows_the_latest_of_each_name(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    recorder.metadata("xitl", {"profile": "made"})
    quat, zero = euler_to_quat(np.zeros((1, 3))), np.zeros((1, 3))
    for second in range(11):
        place = np.array([[2.0 * second, 0.0, 0.0]])
        motion = Kinematics(place, np.array([[2.0, 0.0, 0.0]]), zero, quat, quat_to_matrix(quat), zero, zero)
        recorder.truth(second * 1_000_000_000, motion, np.zeros((1, 2)))
    for second in (2, 3):
        recorder.scene(update(second, 10.0 * second), second * 1_000_000_000)
    recorder.close()
    with open_scene([tmp_path / "run.mcap"]) as scene:
        begin_s = scene.span_s[0]
        shown = {second: middles(scene.instant(begin_s + second).drawings) for second in (1, 2, 3, 4, 6)}
        assert scene.instant(begin_s + 3).drawings["radar"] is scene.instant(begin_s + 3.5).drawings["radar"]
    assert shown == {1: {}, 2: {"radar": 20.0}, 3: {"radar": 30.0}, 4: {"radar": 30.0}, 6: {}}


def test_a_live_view_is_given_the_latest_drawing(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    nothing: Any = SimpleNamespace(vessel="", sensors=None)
    watch = VesselWatch(nothing, nothing, nothing, nothing, lambda: nothing)
    watch.begin(SimpleNamespace(recorder=recorder))  # type: ignore[arg-type]
    for second in (2, 3):
        recorder.scene(update(second, 10.0 * second), second * 1_000_000_000)
    recorder.scene(update(3, 1.0, 0.0, "buoy"), 3_000_000_000)
    recorder.close()
    (sent,) = watch.passing_drawings()
    assert sent == update(3, 30.0).encode()
    assert watch.passing_drawings() == []
