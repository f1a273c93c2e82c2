"""A run and nodes of a real ROS 2 in processes of their own, which know nothing of xitl: every topic, both ways in."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Collection
from pathlib import Path
from typing import Any

import pytest
from conftest import PATIENCE_S, command, environment, summary
from ros2 import Ros2, ros2
from rosbags.highlevel import AnyReader

from xitl_cli.ros.outputs import OUTPUTS

LISTENER = Path(__file__).with_name("rclpy_listener.py")
SITE = "sitl-perception"  # lidar, sonar, odometry and map
UNLIMITED = ("--set", "ros.queue_mb=1000", "--set", "ros.depth=10000")  # this machine may stand still for a while
FOUND_BY_NS = 3_000_000_000  # when a node that was there before has found every topic
TREE = {
    "odom": "map",
    "base_link": "odom",
    "imu_link": "base_link",
    "gnss_link": "base_link",
    "lidar_link": "base_link",
    "sonar_link": "base_link",
}
AS_WANTED = ("/joint_states", "/battery", "/diagnostics", "/robot_description", "/refusals")


def sim(folder: Path, ros: Ros2, *arguments: str, sourced: bool = False) -> subprocess.CompletedProcess[str]:
    """`xitl sim` with ROS in that domain, in the folder `run`."""
    variables = ros.sourced if sourced else {"ROS_DOMAIN_ID": str(ros.domain)}
    return subprocess.run(
        command("sim", *arguments, "--ros", "--out", "run"),
        cwd=folder,
        env=environment() | variables,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def all_topics(folder: Path) -> Path:
    """Those that are known before, for the listener; it finds those of each thruster itself."""
    known = {
        topic.full_name(): [topic.type, "transient_local" if topic.qos == "latched" else "volatile"]
        for topic in OUTPUTS.values()
        if "{" not in topic.name
    }
    path = folder / "topics.json"
    path.write_text(json.dumps(known))
    return path


def bag_stamps(folder: Path, topics: Collection[str]) -> dict[str, list[int]]:
    """Header stamps by topic in the bag that the recording is exported to, as rosbags reads them."""
    exported = subprocess.run(
        command("logs", "export", "run/run.mcap", "--format", "rosbag2-mcap", "--out", "bag"),
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert exported.returncode == 0, exported.stderr
    stamps: dict[str, list[int]] = {}
    with AnyReader([folder / "bag"]) as reader:
        for connection, _, data in reader.messages():
            if connection.topic in topics:
                header = getattr(reader.deserialize(data, connection.msgtype), "header", None)
                if header is not None:
                    stamp = header.stamp.sec * 10**9 + header.stamp.nanosec
                    stamps.setdefault(connection.topic, []).append(stamp)
    return stamps


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("distribution", "way", "seconds"),
    [("kilted", "cyclonedds", 30), ("jazzy", "cyclonedds", 6), ("kilted", "rclpy", 6)],
)
def test_a_node_hears_every_message(tmp_path: Path, distribution: str, way: str, seconds: int) -> None:
    ros = ros2(distribution)
    with ros.node(LISTENER, str(all_topics(tmp_path)), str(tmp_path / "report.json")) as listener:
        listener.expect("listening")
        pace = ("--set", "ros.pace=2")
        done = sim(tmp_path, ros, SITE, *UNLIMITED, *pace, "--duration", str(seconds), sourced=way == "rclpy")
        assert done.returncode == 0, done.stderr
        assert listener.finish() == 0, list(listener.told)
    told = summary(tmp_path / "run")["ros"]
    assert told["way"].startswith(way)
    assert told["dropped"] == {}
    report: dict[str, Any] = json.loads((tmp_path / "report.json").read_text())
    heard, published = report["heard"], told["published"]
    assert "xitl" in report["nodes"]

    all_of_it = {name for name, offer in report["publishers"].items() if offer[1:] == ["RELIABLE", "VOLATILE"]}
    assert len(all_of_it) >= 15
    assert heard["/clock"]["count"] > 0.9 * published["/clock"]  # best effort, as ROS has it
    silent = {name for name in heard if heard[name]["count"] == 0}
    assert silent <= set(AS_WANTED)

    types = {name: about[0] for name, about in report["publishers"].items()}
    assert {name: types[name] for name in published} == {name: heard[name]["type"] for name in published}
    assert report["links"] | TREE == report["links"]
    for name, stamps in bag_stamps(tmp_path, published).items():
        came = heard[name]["stamps"]
        if name in all_of_it:
            assert stamps[-len(came) :] == came, f"{name}: {len(came)} came of {len(stamps)}"
            assert published[name] == len(stamps)
            assert came[0] < max(FOUND_BY_NS, stamps[0] + 1), f"{name} was heard from {came[0]} ns on"
        topic = OUTPUTS.get(name.removeprefix("/"))
        if topic is not None and topic.frame:
            assert list(heard[name]["frames"]) == [topic.frame.replace("→", ">")]
