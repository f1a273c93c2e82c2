"""`sitl-perception` and `xitl map` as a user runs them, for some seconds of simulation time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import Xitl
from mcap.reader import make_reader

from sim_core.frames import quat_to_matrix
from xitl_cli.logs import open_log

for package in ("kiss_icp", "embreex"):
    pytest.importorskip(package, reason="xitl[perception] is not installed")
pytestmark = pytest.mark.slow

SHORT = (
    *("--set", "clock.duration_s=16", "--set", "clock.physics_rate_hz=200", "--set", "sensors.lidar.points_hz=40000"),
    *("--set", "companion.link=tcp://127.0.0.1:0"),
)

BUOY_BEFORE_BOOM = """\
extends: sitl-perception
mission: {start: {north_m: 19.8, east_m: 23.6, heading_deg: 36.87}}
companion: {runs: in-process, parameters: {MAP_ENABLE: 0, ODO_ENABLE: 0}}
sensors:
  sonar: null
  cameras:
    - {position_frd_m: [1, 0, -0.9], pitch_deg: -6, width_px: 320, height_px: 240, lens: {view_deg: 80}, rate_hz: 5,
       detector: colour}
world:
  debris: {encounters: {count: 0}}
  buoys: [{pos_ned_m: [29.8, 28.6], shape: can, colour: green, diameter_m: 1.2}]
recording: {scene: false}
"""


def topics(file: Path) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, message.data))
    return found


def test_it_sees_maps_and_repeats_wherever_the_companion_runs(xitl: Xitl, tmp_path: Path) -> None:
    ran = xitl("sim", "-p", "sitl-perception", *SHORT, "--out", "a", "--json", timeout_s=300)
    assert ran.returncode == 1, ran.stderr  # the mission is longer
    summary = json.loads(ran.stdout)
    assert summary["error"] is None
    companion, lidar = summary["companion"], summary["perception"]["lidar"]
    # A frame each 0.1 s, the first from 0.1 s on; the last may still be on its way.
    assert lidar["frames"] == 159
    assert lidar["frames"] - companion["clouds"] <= 1
    assert (companion["chunks_lost"], companion["clouds_dropped"], companion["gone_s"]) == (0, 0, None)
    assert companion["poses"] > 140
    # One per cent of the path, and what it drifts and turns before it gets under way.
    assert summary["odometry"]["ate_rms_m"] < 0.01 * summary["odometry"]["path_m"] + 0.5
    assert summary["collisions"]["count"] == 0

    again = xitl(
        "sim", "-p", "sitl-perception", *SHORT, "--set", "companion.runs=in-process", "--out", "b", timeout_s=300
    )
    assert again.returncode == 1, again.stderr
    one, other = topics(tmp_path / "a" / "run.mcap"), topics(tmp_path / "b" / "run.mcap")
    assert [topic for topic in one if one[topic] != other.get(topic)] == []
    assert {"/lidar/points", "/sonar/ping", "/companion/odometry", "/companion/map", "/companion/status"} <= set(one)
    assert (tmp_path / "a" / "map.ply").read_bytes() == (tmp_path / "b" / "map.ply").read_bytes()

    mapped = xitl("map", "a/run.mcap", "--out", "m", "--json", timeout_s=300)
    assert mapped.returncode == 0, mapped.stderr
    difference = json.loads(mapped.stdout)["difference"]
    assert difference["poses"] == companion["poses"]
    assert difference["max_m"] < 0.1
    assert (tmp_path / "m" / "map.ply").stat().st_size > 0


def test_a_track_of_the_lidar_gets_the_class_that_the_camera_sees(xitl: Xitl, tmp_path: Path) -> None:
    (tmp_path / "buoy.yaml").write_text(BUOY_BEFORE_BOOM)
    ran = xitl("sim", "-p", "buoy.yaml", "--duration", "6.5", "--out", "run", "--json", timeout_s=300)
    assert ran.returncode == 0, ran.stderr
    summary = json.loads(ran.stdout)
    assert summary["obstacles"]["classes"] == {"buoy": {"tracked": 1, "right": 1, "wrong": 0}}
    status = summary["companion"]
    with open_log(tmp_path / "run" / "run.mcap", "") as log:
        tables = log.tables
        obstacles, vessel, bodies = tables["/companion/obstacles"], tables["/truth/state"], tables["/truth/bodies"]
        sent = len(tables["/cameras/detections"].values("label"))
        label, share = obstacles.values("label"), obstacles.values("label_share")
        last = np.flatnonzero(label == "buoy")[-1]
        stamp_ns, bearing_rad = obstacles.values("stamp")[last], obstacles.values("bearing_rad")[last]
        at = np.searchsorted(vessel.values("stamp"), stamp_ns)
        rot_ned_frd = quat_to_matrix(vessel.values("quaternion_ned_frd")[at])
        buoy_ned_m = bodies.values("position_ned_m")[np.searchsorted(bodies.values("stamp"), stamp_ns)]
        ahead_m, starboard_m, _ = (buoy_ned_m - vessel.values("position_ned_m")[at]) @ rot_ned_frd
    assert status["detections"] <= sent
    assert sent - status["detections"] < 20  # an image is on its way at the end
    assert status["detections_dropped"] == status["detections_early"]
    assert share[last] > 0.9
    # The attitude and place of the autopilot, and the near side that the lidar sees
    assert np.degrees(bearing_rad - np.arctan2(starboard_m, ahead_m)) == pytest.approx(0.0, abs=3.0)
    assert {"buoy", "boom"} <= set(label) <= {"", "buoy", "boom"}
