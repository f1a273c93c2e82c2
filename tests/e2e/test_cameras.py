"""Cameras in whole runs: what is recorded, that it repeats, latency, losses, and what a user is told."""

from __future__ import annotations

import json
import os
import subprocess
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from conftest import command, environment
from mcap.reader import make_reader

from tests.colour_network import write_network
from tests.forked_xitl import run_xitl
from xitl_cli.logs import open_log

pytestmark = pytest.mark.slow
SMALL = ["sensors.cameras.0.width_px=160", "sensors.cameras.0.height_px=120", "world.debris.encounters.count=0"]
ONE_CAMERA = "sensors.cameras=[{name: front, width_px: 160, height_px: 120}]"
READER = """\
from dataclasses import dataclass
from sim_core.keys import Specification
from xitl_cli.plugin import NodeKind
from xitl_cli.run.core.node import RunNode

@dataclass(frozen=True, slots=True, kw_only=True)
class Keys(Specification):
    '''No keys.'''

class Reader(RunNode):
    def __init__(self, keys, context):
        pass

    def begin(self, context):
        self.clock = context.clock
        context.recorder.watch("/cameras/front/image", self.read)

    def read(self, stamp_ns, *values):
        with open("delays", "a") as file:
            file.write(f"{1e-9 * (self.clock.now_ns() - stamp_ns)}\\n")

KIND = NodeKind(Keys, Reader)
"""
EXTRA = """\
extends: sitl-camera
world: {debris: {encounters: {count: 0}}}
sensors:
  cameras:
    - {name: front, width_px: 160, height_px: 120, rate_hz: 5, latency_s: 0.3, drop_share: 0.2,
       exposure: {time_s: 0.02, readout_s: 0.02}}
    - {name: range, kind: depth, width_px: 80, height_px: 60, rate_hz: 2}
    - {name: labels, kind: segmentation, width_px: 80, height_px: 60, rate_hz: 2, pitch_deg: -6}
    - {name: warm, kind: thermal, width_px: 80, height_px: 60, rate_hz: 2}
    - {name: wide, width_px: 120, height_px: 120, rate_hz: 2, lens: {model: fisheye, view_deg: 180}, gimbal: {}}
"""


NETWORK = """\
extends: sitl-camera
mission: {start: {north_m: 19.8, east_m: 23.6, heading_deg: 306.87}}
world:
  debris: {encounters: {count: 0}}
  buoys: [{pos_ned_m: [24.6, 17.2], shape: can, colour: red, diameter_m: 3.5, swing_m: 0.1}]
sensors:
  cameras:
    - {name: front, width_px: 160, height_px: 120, rate_hz: 4, pitch_deg: -6,
       detector: {kind: onnx, model: red.onnx, classes: [buoy, other], confidence: 0.6}}
"""


def run(folder: Path, profile: str, *words: str, sets: list[str] | None = None) -> subprocess.CompletedProcess[str]:
    arguments = ["sim", "--profile", profile, "--out", "run", *words]
    for one in sets or []:
        arguments += ["--set", one]
    return run_xitl(arguments, folder, environment(), 300.0)


def summary(folder: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((folder / "run/summary.json").read_text())
    return result


def payloads(folder: Path, topic: str) -> list[tuple[int, bytes]]:
    with (folder / "run/run.mcap").open("rb") as file:
        return [(message.log_time, message.data) for _, _, message in make_reader(file).iter_messages(topics=[topic])]


def package(folder: Path, name: str, entry_points: str) -> None:
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(entry_points)


def with_package(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command with the package of a folder."""
    paths = [str(folder), *filter(None, [environment().get("PYTHONPATH")])]
    return subprocess.run(
        command(*arguments),
        cwd=folder,
        env={**environment(), "PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture(scope="module")
def several(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cameras")
    (folder / "own.yaml").write_text(EXTRA)
    done = run(folder, "own.yaml", "--duration", "6")
    assert done.returncode == 0, done.stderr
    return folder


def test_a_run_with_a_camera_repeats_bit_for_bit(tmp_path: Path) -> None:
    digests = []
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        done = run(folder, "sitl-camera", "--duration", "3", sets=SMALL)
        assert done.returncode == 0, done.stderr
        images = payloads(folder, "/cameras/front/image")
        assert len(images) == 15
        digests.append([(stamp, sha256(data).hexdigest()) for stamp, data in images])
    assert digests[0] == digests[1]
    assert len({digest for _, digest in digests[0]}) == 15


def test_images_that_a_node_reads_are_in_time_and_the_same(tmp_path: Path) -> None:
    (tmp_path / "reader.py").write_text(READER)
    package(tmp_path, "reader", "[xitl.nodes]\nreader = reader:KIND\n")
    digests = []
    for sets in ([ONE_CAMERA], [ONE_CAMERA, "plugins.reader={}"]):
        words = ["sim", "--profile", "sitl", "--duration", "2", "--out", "run", "--overwrite"]
        done = with_package(tmp_path, *words, *(word for one in sets for word in ("--set", one)))
        assert done.returncode == 0, done.stderr
        digests.append([sha256(data).hexdigest() for _, data in payloads(tmp_path, "/cameras/front/image")])
    assert digests[0] == digests[1]
    assert len(digests[0]) == 20
    delays_s = np.loadtxt(tmp_path / "delays")
    assert len(delays_s) == 20
    assert delays_s[:-1] == pytest.approx(0.1, abs=1e-6)  # the run ends with the last one


def test_every_image_is_counted(several: Path) -> None:
    cameras = summary(several)["cameras"]
    assert cameras["renderer"]
    counts = cameras["by_name"]
    assert counts["front"]["images"] + counts["front"]["lost"] + counts["front"]["unfinished"] == 30
    assert counts["front"]["lost"] > 0
    assert counts["range"]["images"] == counts["labels"]["images"] == counts["wide"]["images"] == 12
    for name, count in counts.items():
        assert len(payloads(several, f"/cameras/{name}/image")) == count["images"]
        assert count["skipped"] == count["late"] == 0
    with open_log(several / "run/run.mcap", "") as log:
        frames = log.tables["/cameras/frames"]
        numbers = frames.values("image")[frames.values("camera") == "front"]
    assert set(numbers) < set(range(1, 31))


def test_the_kinds_hold_what_they_say(several: Path) -> None:
    def png(topic: str) -> np.ndarray:
        data = payloads(several, topic)[-1][1]
        return cv2.imdecode(np.frombuffer(data[data.index(b"\x89PNG") :], np.uint8), cv2.IMREAD_UNCHANGED)

    warm = png("/cameras/warm/image")
    assert (warm.dtype, warm.shape) == (np.uint16, (60, 80))
    celsius = 0.01 * warm - 273.15
    assert celsius[:10].mean() == pytest.approx(-20.0, abs=0.1)  # sky
    assert np.abs(celsius[-10:] - 24.0).min() < 0.2  # water
    data = payloads(several, "/cameras/range/image")[-1][1]
    assert b"32FC1" in data
    labels = png("/cameras/labels/image")
    assert labels.shape[:2] == (60, 80)


def test_the_truth_is_recorded_with_each_image(several: Path) -> None:
    with open_log(several / "run/run.mcap", "") as log:
        truth, frames = log.tables["/cameras/truth"], log.tables["/cameras/frames"]
        here = truth.values("camera") == "labels"
        assert {"boom", "dam"} <= set(truth.values("label")[here])
        left, right = truth.values("left_px"), truth.values("right_px")
        assert ((right > left) & (left >= -0.5)).all()
        of_front = frames.values("camera") == "labels"
        horizon = frames.values("horizon_left_px")[of_front]
    # 70 degrees across 80 pixels, 6 degrees down
    assert np.median(horizon) == pytest.approx(29.5 - 57.1 * np.tan(np.radians(6.0)), abs=4.0)


@pytest.mark.parametrize(
    ("key", "wanted"),
    [
        ("sensors.cameras.0.rate_hz=7", "sensors.cameras.0.rate_hz = 7 does not divide the physics rate"),
        ("sensors.cameras.0.lens.view_deg=170", "too wide for a pinhole"),
        ("sensors.cameras.0.name=Bow Camera", "cannot be part of a topic"),
        ("sensors.cameras.0.position_frd_m=[0, 0.6, 0.1]", "is inside a hull; use a down coordinate below"),
        ("sensors.cameras.0.detector=best", "best: no installed package registers it in xitl.detectors"),
    ],
)
def test_a_wrong_key_is_named(tmp_path: Path, key: str, wanted: str) -> None:
    done = run(tmp_path, "sitl-camera", "--duration", "1", sets=[key])
    assert done.returncode == 2
    assert wanted in done.stderr


def test_without_opengl_it_says_what_to_install(tmp_path: Path) -> None:
    words = ["sim", "--profile", "sitl-camera", "--duration", "1", "--out", "run"]
    without = {**environment(), "EGL_PLATFORM": "none", "__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere"}
    done = run_xitl(words, tmp_path, without, 120.0)
    assert done.returncode == 2
    assert "apt install libegl1 libgl1-mesa-dri" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_network_finds_a_red_buoy_in_a_run(tmp_path: Path) -> None:
    write_network(tmp_path / "red.onnx")
    (tmp_path / "own.yaml").write_text(NETWORK)
    done = run(tmp_path, "own.yaml", "--duration", "3")
    assert done.returncode in (0, 1), done.stderr  # the mission is longer
    score = summary(tmp_path)["cameras"]["by_name"]["front"]["detector"]["buoy"]
    assert score["recall"] == 1.0
    assert score["precision"] > 0.8
    with open_log(tmp_path / "run/run.mcap", "") as log:
        found = log.tables["/cameras/detections"]
        assert set(found.values("label")) == {"buoy"}
        bearing_deg = np.degrees(found.values("bearing_rad"))
        assert np.abs(bearing_deg).max() < 15.0  # of boxes on a buoy of 25 degrees straight ahead
        assert bearing_deg.mean() == pytest.approx(0.0, abs=3.0)
    done = run(
        tmp_path, "own.yaml", "--duration", "1", "--overwrite", sets=["sensors.cameras.0.detector.classes=[buoy]"]
    )
    assert done.returncode == 2
    assert "so 2 classes, and detector.classes has 1" in done.stderr


def test_a_detector_that_fails_ends_the_run_with_its_name(tmp_path: Path) -> None:
    (tmp_path / "faulty.py").write_text(
        "class Faulty:\n    def __init__(self, camera, lens): pass\n    def detect(self, image): return 1 / 0\n"
    )
    package(tmp_path, "faulty", "[xitl.detectors]\nfaulty = faulty:Faulty\n")
    arguments = ["sim", "--profile", "sitl-camera", "--duration", "3", "--out", "run"]
    for one in (*SMALL, "sensors.cameras.0.detector=faulty"):
        arguments += ["--set", one]
    done = with_package(tmp_path, *arguments)
    assert done.returncode == 2
    assert "faulty: the plug-in of faulty 1.0 failed (ZeroDivisionError" in done.stderr
    assert payloads(tmp_path, "/truth/state")  # the recording stays readable
