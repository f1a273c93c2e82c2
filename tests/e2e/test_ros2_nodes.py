"""A run and nodes of a real ROS 2 in processes of their own, which know nothing of xitl: every topic, both ways in."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import command, environment, summary
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from ros2 import NodeProcess, Ros2, ros2
from rosbags.highlevel import AnyReader

from tests.patience import PATIENCE_S
from xitl_cli.plugins.ros.outputs import OUTPUTS
from xitl_cli.profile import load_profile

LISTENER, MISCHIEF = (Path(__file__).with_name(f"rclpy_{name}.py") for name in ("listener", "mischief"))
EXAMPLES = Path(__file__).parents[2] / "examples" / "ros"
SITE = "sitl-perception"  # lidar, sonar, odometry and map
PACE = ("--set", "ros.pace=3")
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
AS_WANTED = ("/ais/nmea", "/joint_states", "/battery", "/refusals")


def sim(folder: Path, ros: Ros2, *arguments: str, sourced: bool = False) -> subprocess.CompletedProcess[str]:
    """`xitl sim` with ROS in that domain, in the folder `run`."""
    variables = ros.sourced if sourced else {"ROS_DOMAIN_ID": str(ros.domain)}
    return subprocess.run(
        command("sim", *arguments, "--ros", "--out", "run"),
        cwd=folder,
        env=environment() | variables,
        capture_output=True,
        text=True,
        timeout=3 * PATIENCE_S,
        check=False,
    )


def started(folder: Path, ros: Ros2, *arguments: str, sourced: bool = False) -> NodeProcess:
    """The same under way."""
    variables = ros.sourced if sourced else {"ROS_DOMAIN_ID": str(ros.domain)}
    return NodeProcess(command("sim", *arguments, "--ros", "--out", "run"), environment() | variables, folder)


def true_places(run: Path) -> np.ndarray:
    """(n, 2) east and north in metres from the recording, by mcap-ros2-support."""
    with (run / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        odometry = [decoded for *_, decoded in reader.iter_decoded_messages(topics=["/truth/odometry"])]
    return np.array([(one.pose.pose.position.x, one.pose.pose.position.y) for one in odometry])


NOT_IN_ROS = "marine_sensor_msgs/"
"""A package of messages that an installed ROS does not have."""


def all_topics(folder: Path) -> Path:
    """Those that are known before, for the listener; it finds those of each thruster itself."""
    known = {
        topic.full_name(): [topic.type, "transient_local" if topic.qos == "latched" else "volatile"]
        for topic in OUTPUTS.values()
        if "{" not in topic.name and not topic.type.startswith(NOT_IN_ROS)
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
    ("distribution", "way", "discovery", "seconds"),
    [
        pytest.param("kilted", "cyclonedds", "SUBNET", 12, marks=pytest.mark.nightly),
        ("jazzy", "cyclonedds", "LOCALHOST", 6),
        pytest.param("kilted", "rclpy", "SUBNET", 6, marks=pytest.mark.nightly),
    ],
)
def test_a_node_hears_every_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, distribution: str, way: str, discovery: str, seconds: int
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", discovery)
    ros = ros2(distribution)
    with ros.node(LISTENER, str(all_topics(tmp_path)), str(tmp_path / "report.json")) as listener:
        listener.expect("listening")
        done = sim(tmp_path, ros, SITE, *UNLIMITED, *PACE, "--duration", str(seconds), sourced=way == "rclpy")
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


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("distribution", "way"), [pytest.param("jazzy", "cyclonedds", marks=pytest.mark.nightly), ("kilted", "rclpy")]
)
def test_a_node_sails_to_a_waypoint_and_one_that_does_all_wrong_harms_nothing(
    tmp_path: Path, distribution: str, way: str
) -> None:
    ros = ros2(distribution)
    x, y = -8.0, 22.0  # of the start 13 m ahead
    waypoint = EXAMPLES / "waypoint_by_cmd_vel.py"
    with ros.node(waypoint, "--ros-args", "-p", f"x:={x}", "-p", f"y:={y}", "-p", "speed:=2.0") as sailor:
        run = started(tmp_path, ros, "ros", "--clock", "lockstep", *PACE, "--duration", "600", sourced=way == "rclpy")
        with run:
            sailor.expect("reached", 3 * PATIENCE_S)
            assert sailor.process.wait(PATIENCE_S) == 0
            with ros.node(MISCHIEF) as mischief:
                mischief.expect("disarm: ")
                run.expect("another node also publishes /clock")
                run.expect("/set_mode: another node uses the type")
                assert mischief.finish() == 0, list(mischief.told)
            assert run.process.wait(PATIENCE_S) == 0, list(run.told)
    assert np.hypot(*(true_places(tmp_path / "run") - (x, y)).T).min() < 5.0  # the node's 3 m, and the estimate's error
    told = summary(tmp_path / "run")
    ros_told = told["ros"]
    assert ros_told["way"].startswith(way)
    assert told["ended"] == "finished"
    assert ros_told["received"]["/cmd_vel"] > 100
    assert ros_told["superseded"]["/cmd_vel"] > 0
    assert ros_told["not_taken"]["/cmd_vel"] >= 1
    assert ros_told["not_taken"]["/goal_pose"] == 1
    for sentence in (
        "/cmd_vel has linear.x = nan",
        "speed_mps = 1000000000.0 is too large",
        "/goal_pose has the unknown frame 'camera_link'; use map or odom",
        "/wind: a node requests durability transient_local, but xitl offers volatile",
        "another node also publishes /clock in domain",
        "/set_mode: another node uses the type std_msgs/msg/Float64",
    ):
        assert sum(sentence in warning for warning in told["warnings"]) == 1, (sentence, told["warnings"])


@pytest.mark.realtime
def test_a_node_keeps_clear_of_the_boom_by_points(tmp_path: Path) -> None:
    ros = ros2("kilted")
    with ros.node(EXAMPLES / "avoid_boom_by_points.py") as avoider:
        done = sim(tmp_path, ros, "ros-companion", "--clock", "lockstep", *PACE, "--duration", "50")
        assert done.returncode == 0, done.stderr
        avoider.process.send_signal(signal.SIGINT)
        nearest_m = float(avoider.expect("nearest point").split()[2])
    boom = load_profile("ros-companion").runnable().world.log_boom
    anchors = np.array(boom.anchors_ne_m)[:, ::-1]
    along = (anchors[-1] - anchors[0]) / np.hypot(*(anchors[-1] - anchors[0]))
    upstream = np.array([-along[1], along[0]])
    off_m = (true_places(tmp_path / "run") - anchors[0]) @ upstream
    goal_m = float((np.array([40.0, -22.0]) - anchors[0]) @ upstream)
    assert goal_m < -20.0 < 20.0 < off_m[0]  # the way to the goal leads through the boom
    assert off_m.min() > boom.sag_m + 1.0
    assert 3.0 < nearest_m < 12.0  # it came near, and kept off: it slows down for what is nearer than 6 m
    assert summary(tmp_path / "run")["collisions"]["count"] == 0
