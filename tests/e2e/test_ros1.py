"""A run beside Debian's ROS 1: its master, rospy, rostopic, rosservice and rosbag."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from conftest import Xitl, command, environment

from tests.free_ports import free_port
from tests.patience import PATIENCE_S, wait_until
from tests.recorded_run import recorded_run
from xitl_cli.logs import open_log

NODE = Path(__file__).parents[1] / "contract/rospy_node.py"

pytestmark = pytest.mark.skipif(
    shutil.which("roscore") is None, reason="needs a ROS 1: tools/system_packages.sh installs Debian's ros-core"
)


@pytest.fixture
def tools(tmp_path: Path) -> dict[str, str]:
    """The environment of ROS's programs, for a master that may be started."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "ROS_"))}
    return plain | {
        "ROS_MASTER_URI": f"http://localhost:{free_port()}",
        "ROS_HOSTNAME": "localhost",
        "ROS_LOG_DIR": str(tmp_path),
        "HOME": str(tmp_path),
    }


@pytest.fixture
def ros(tools: dict[str, str]) -> Iterator[dict[str, str]]:
    """The environment of nodes, with a master."""
    port = tools["ROS_MASTER_URI"].rpartition(":")[2]
    with subprocess.Popen(
        ["roscore", "-p", port], env=tools, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as master:
        yield tools
        master.terminate()


def ask(ros: dict[str, str], *arguments: str) -> str:
    """What a tool of ROS says."""
    found = subprocess.run(arguments, env=ros, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    return found.stdout + found.stderr


@pytest.mark.realtime
def test_nodes_of_ros_1_count_drive_record_and_end_a_run(tmp_path: Path, ros: dict[str, str]) -> None:
    settings = ["--set", "driver.kind=ros", "--set", "ros.pace=4", "--duration", "36000"]
    with subprocess.Popen(
        command("sim", "--profile", "sitl-perception", "--ros", "ros1://", *settings, "--out", "run"),
        cwd=tmp_path,
        env=environment() | {name: ros[name] for name in ("ROS_MASTER_URI", "ROS_HOSTNAME")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as run:
        try:

            def publishes() -> bool:
                assert run.poll() is None, run.communicate()[0]
                return "/imu/data" in ask(ros, "rostopic", "list")

            wait_until(publishes)
            bag = tmp_path / "recorded.bag"
            topics = ["/imu/data", "/odometry", "/tf_static", "/points"]
            record = ["rosbag", "record", "--duration", "8", "-O", str(bag), *topics]
            with subprocess.Popen(record, env=ros, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as recorder:
                rate = subprocess.Popen(
                    ["timeout", "120", "rostopic", "hz", "-w", "400", "/imu/data"],
                    env=ros | {"PYTHONUNBUFFERED": "1"}, stdout=subprocess.PIPE, text=True,
                )  # fmt: skip
                assert rate.stdout is not None
                said = list(islice((line for line in rate.stdout if "average" in line), 3))[-1]
                rate.terminate()
                rate.communicate()
                assert recorder.wait(PATIENCE_S) == 0
            assert 'frame_id: "odom"' in ask(ros, "rostopic", "echo", "-n", "1", "/odometry/header")
            assert "success: True" in ask(ros, "rosservice", "call", "/mode/hold")
            node = subprocess.run(
                ["/usr/bin/python3", str(NODE)],
                env=ros,
                capture_output=True,
                text=True,
                timeout=PATIENCE_S,
                check=False,
            )
            assert node.returncode == 0, node.stdout + node.stderr
            output = run.communicate(timeout=PATIENCE_S)[0]
        finally:
            run.kill()
    assert run.returncode == 0, output
    assert float(said.split()[-1]) == pytest.approx(200.0, rel=0.1)  # by /clock, which steps by 20 ms
    found: dict[str, Any] = json.loads(node.stdout)
    assert found["armed"]
    assert found["ended"]
    assert "GUIDED" in found["modes"][-1].upper()
    assert found["imu_steps_ns"] == [5_000_000]  # none of them is missing
    assert found["frame_ids"] == {"/imu/data": "imu_link", "/fix": "gnss_link", "/points": "lidar_link"}
    frames = {tuple(each) for each in found["frames"]}
    assert {("map", "odom"), ("odom", "base_link"), ("base_link", "imu_link"), ("base_link", "lidar_link")} <= frames
    assert found["cloud_bytes"][0] == found["cloud_bytes"][1] > 1000
    assert "<robot" in found["description"]
    assert found["parameter_is_topic"]
    assert found["simulated_time"] is True
    about = json.loads((tmp_path / "run/summary.json").read_text())["ros"]
    assert about["way"].startswith("ROS 1")
    assert not about["dropped"]
    assert about["received"]["/cmd_vel"] > 0
    left = ask(ros, "rosparam", "list") + ask(ros, "rostopic", "list")
    assert "use_sim_time" not in left
    assert "/imu/data" not in left
    check_bag(bag, ask(ros, "rosbag", "info", str(bag)))


def check_bag(bag: Path, info: str) -> None:
    """Our own reader finds in it what rosbag does."""
    counts = {topic: int(count) for topic, count in re.findall(r"(/\S+)\s+(\d+) msgs? +:", info)}
    with open_log(bag) as log:
        assert log.closed
        assert not log.health.degraded
        assert {name: len(table) for name, table in log.tables.items()} == counts
        assert counts["/imu/data"] > 400
        assert abs(float(log["/imu/data"]["linear_acceleration.z"].mean()) - 9.8) < 0.2


@pytest.mark.slow
def test_rosbag_reads_what_is_exported(xitl: Xitl, tmp_path: Path, tools: dict[str, str]) -> None:
    recording = recorded_run("sitl", 20.0) / "run.mcap"
    done = xitl("logs", "export", str(recording), "--format", "rosbag1", "--out", "boat.bag")
    assert done.returncode == 0, done.stderr
    info = ask(tools, "rosbag", "info", str(tmp_path / "boat.bag"))
    counts = {topic: int(count) for topic, count in re.findall(r"(/\S+)\s+(\d+) msgs? +:", info)}
    with open_log(tmp_path / "boat.bag") as log:
        assert {name: len(table) for name, table in log.tables.items()} == counts
    assert counts["/imu/data"] == 4000
    first = ask(tools, "rostopic", "echo", "-b", str(tmp_path / "boat.bag"), "-n", "1", "/imu/data/header")
    assert 'frame_id: "imu_link"' in first
