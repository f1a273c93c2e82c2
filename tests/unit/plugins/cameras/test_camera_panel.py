"""Images of cameras in the 3D view, of a run and of a recording."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest
from recorded_images import foxglove_image, record
from synthetic_images import make_image

from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.logs import open_log
from xitl_cli.plugins.cameras.images import ObjectClass, image_topic
from xitl_cli.plugins.cameras.studio import PALETTE
from xitl_cli.plugins.view.camera_images import ImagePanel, image_tracks, live_image, picture_of
from xitl_cli.plugins.view.live_view import VesselWatch
from xitl_cli.plugins.view.model import ViewImage
from xitl_cli.plugins.view.replay import unseen_server
from xitl_cli.profile.load import load_profile
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.core.node import RunContext, SimulationClock
from xitl_cli.run.core.pace import Lockstep
from xitl_cli.run.nodes.direct_control import direct_control
from xitl_cli.run.nodes.display import RunStatus
from xitl_cli.run.nodes.mission import MissionNode
from xitl_cli.run.world.world import build_plant
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

FRONT = CameraSpec(width_px=96, height_px=64)
DEPTH = CameraSpec(name="depth", kind="depth", width_px=96, height_px=64)
CLASSES = CameraSpec(name="classes", kind="segmentation", width_px=96, height_px=64)
HEAT = CameraSpec(name="heat", kind="thermal", width_px=96, height_px=64)
STATUS = RunStatus(0.0, 60.0, "AUTO", True, 1, 6, 2.5, 90.0, -0.4, 0.2, 0.5, 4.0, (0.5, 0.4), lost=3, missed=2)


KEY = ("alpha", "front")


@pytest.mark.medium
def test_a_run_gives_each_image_once(tmp_path: Path) -> None:
    profile = load_profile("sitl", ["sensors.cameras=[{name: front}, {name: depth, kind: depth}]"]).runnable()
    plant, control, pace = build_plant([profile], Seeds(1), Scenery(profile)), direct_control(profile), Lockstep()
    watch = VesselWatch(profile, plant.vessels[0], control, MissionNode(profile, control), lambda: STATUS)
    with ExitStack() as opened:
        recorder = Recorder(tmp_path / "run.mcap", "none")
        opened.callback(recorder.close)
        watch.begin(RunContext(recorder, pace, SimulationClock(pace)))
        assert watch.instant(0, 0).images == {}
        for spec in (FRONT, DEPTH):
            recorder.add_topic(image_topic(spec.name, spec.kind))
            for number in (1, 2):
                image = make_image(spec, number)
                topic = f"/cameras/{spec.name}/image"
                recorder.message(topic, image.stamp_ns, foxglove_image(image, "any"))
        images = watch.instant(0, 0).images
        assert {name: image.time_s for name, image in images.items()} == {"front": 0.2, "depth": 0.2}
        assert images["front"].data == make_image(FRONT, 2).encoded
        assert images["depth"].size_px == (96, 64)
        assert watch.instant(0, 0).images == {}


def test_a_recording_has_the_newest_image_at_any_time(tmp_path: Path) -> None:
    specs = (FRONT, DEPTH, CLASSES)
    path = record(tmp_path / "run.mcap", [make_image(spec, number) for number in (1, 2, 3) for spec in specs])
    with open_log(path) as log:
        tracks = dict(image_tracks(log, lambda stamps_ns: stamps_ns * 1e-9))
        assert set(tracks) == {"front", "depth", "classes"}
        front = tracks["front"]
        assert front.at(0.05) is None
        for time_s, number in ((0.1, 1), (0.19, 1), (0.25, 2), (9.0, 3), (0.2, 2)):
            found = front.at(time_s)
            assert found is not None
            assert (found.data, found.time_s) == (make_image(FRONT, number).encoded, pytest.approx(0.1 * number))
        assert front.at(0.2) is front.at(0.21), "it is read once"
        depth = tracks["depth"].at(0.1)
        assert depth is not None
        assert depth.data == make_image(DEPTH, 1).pixels.tobytes()


def test_pictures_are_in_colour_and_small() -> None:
    classes = picture_of(live_image(0, foxglove_image(make_image(CLASSES, 1), ""), False))
    assert tuple(classes[30, 30]) == PALETTE[ObjectClass.VESSEL]
    heat = picture_of(live_image(0, foxglove_image(make_image(HEAT, 1), ""), False)).astype(int)
    assert heat[30, 30].sum() > heat[50, 80].sum() + 200
    depth = picture_of(live_image(0, foxglove_image(make_image(DEPTH, 1), ""), True))
    assert depth[:32].max() < 5
    assert depth[40:].max() > 100
    large = replace(FRONT, width_px=1500, height_px=800)
    assert picture_of(live_image(0, foxglove_image(make_image(large, 1), ""), False)).shape == (267, 500, 3)


def test_the_panel_shows_new_images_and_survives_damaged_ones() -> None:
    with unseen_server() as server:
        panel = ImagePanel(server)
        images = [ViewImage(0.1 * number, make_image(FRONT, 80 * number).encoded) for number in (1, 2)]
        panel.update({})
        panel.update({KEY: images[0]})
        (handle,) = panel.handles.values()
        assert abs(int(handle.image[0, 0, 0]) - 80) < 6
        panel.update({KEY: images[1]})
        assert abs(int(handle.image[0, 0, 0]) - 160) < 6
        short = ViewImage(0.3, b"1234", (5, 5))
        panel.update({KEY: ViewImage(0.3, b"\xff\xd8 damaged"), ("alpha", "depth"): short})
        assert abs(int(handle.image[0, 0, 0]) - 160) < 6
        assert list(panel.handles) == [KEY]
