"""`xitl map` on a recording of a made-up river."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from agent.companion.clouds import CloudReassembler, PointCloud, cloud_messages
from agent.companion.mapping import CloudMap
from agent.companion.odometry import LidarOdometry
from agent.wire import dialect
from sim_core.frames import matrix_to_quat
from sim_core.kinematics import Kinematics
from tests.command_line import xitl_app
from tests.golden import Golden
from tests.unit.companion import river_scans
from xitl_cli.errors import UserError
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import FaultEvent

CLOUDS = 25


def recorded(path: Path) -> None:
    """A run whose companion got every cloud."""
    recorder = Recorder(path, "lz4")
    rng, stands = np.random.default_rng(3), river_scans.poles()
    wire, odometry, cloud_map = CloudReassembler(), LidarOdometry(), CloudMap()
    zero = np.zeros((1, 3))
    for number in range(CLOUDS):
        stamp_ns = number * 100_000_000
        for step in range(5):
            place, attitude = river_scans.pose(stamp_ns * 1e-9 + 0.02 * step)
            motion = Kinematics(place, zero, zero, matrix_to_quat(attitude), attitude, zero, zero)
            recorder.truth(stamp_ns + 20_000_000 * step, motion, np.zeros((1, 2)))
        points, offset = river_scans.scan(stamp_ns * 1e-9, stands, rng)
        intensity = np.full(len(points), 40, np.uint8)
        recorder.perception.lidar_points(stamp_ns, points, offset, intensity)
        cloud = PointCloud(dialect.XITL_CLOUD_KIND_LIDAR, number, stamp_ns, points, offset, intensity)
        for message in cloud_messages(cloud):
            for got in wire.handle(message):
                placed = odometry.register(got.stamp_ns, got.points_m, got.offset_s)
                assert placed is not None
                added = cloud_map.add(placed.pose_odom, placed.points_frd_m, got.intensity[placed.kept])
                recorder.perception.odometry(placed.stamp_ns, placed.pose_odom, placed.vel_frd_mps)
                recorder.perception.map_points(placed.stamp_ns, added.points_odom_m, added.intensity, "lidar")
    recorder.close()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("river") / "run.mcap"
    recorded(path)
    return path


@pytest.mark.medium
def test_offline_repeats_what_ran(run: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(xitl_app(["map"]), ["map", str(run), "--out", str(tmp_path), "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["clouds"] == found["offline"]["odometry"]["poses"] == CLOUDS
    # The same numbers went in; the recording keeps poses in double precision and map points in single.
    assert found["difference"]["max_m"] < 1e-6
    assert found["difference"]["map_rms_m"] < 1e-5
    assert found["offline"]["odometry"]["ate_rms_m"] < 0.1
    assert found["offline"]["mapping"]["points"] == found["online"]["mapping"]["points"]
    names = {"map.ply", "trajectory.tum", "truth.tum", "online.tum", "map.json"}
    assert {file.name for file in tmp_path.iterdir()} == {Path(file).name for file in found["files"]} == names
    kept = json.loads((tmp_path / "map.json").read_text())
    assert kept == {name: value for name, value in found.items() if name != "files"}


@pytest.mark.medium
def test_it_is_said_to_a_person_too(run: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(xitl_app(["map"]), ["map", str(run), "--out", str(tmp_path), "--format", "pcd"])
    assert result.exit_code == 0, result.output
    assert "ate_rms_m" in result.stdout
    assert (tmp_path / "map.pcd").is_file()


@pytest.mark.medium
def test_what_cannot_be_mapped_is_said(run: Path, tmp_path: Path, golden: Golden) -> None:
    recorder = Recorder(tmp_path / "dry.mcap", "lz4")
    recorder.write(1, FaultEvent("link-cut", active=True))
    recorder.close()
    with pytest.raises(UserError) as refused:
        CliRunner().invoke(xitl_app(["map"]), ["map", str(tmp_path / "dry.mcap")], catch_exceptions=False)
    golden("error", refused.value)
    with pytest.raises(UserError, match="use ply or pcd"):
        CliRunner().invoke(xitl_app(["map"]), ["map", str(run), "--format", "las"], catch_exceptions=False)
