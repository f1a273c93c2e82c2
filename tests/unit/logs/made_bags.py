"""Bags of a boat on a circle, written by `rosbags`: the same messages in any of the formats."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

BEGIN_NS = 1_700_000_000 * 10**9
STEP_NS = 100_000_000
RADIUS_M, SPEED_MPS = 20.0, 2.0
CUSTOM = "boat_msgs/msg/Winch"
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
for _store in (ROS1, ROS2):
    _store.register(get_types_from_msg("string[] names\nuint8 gear\nfloat64 load_n\nint16[3] turns", CUSTOM))

Sent = tuple[str, str, int, Any]


def messages(store: Any, steps: int = 40) -> Iterator[Sent]:
    """Topic, type, stamp (ns) and message."""
    t = store.types
    for step in range(steps):
        stamp_ns = BEGIN_NS + step * STEP_NS
        angle = SPEED_MPS / RADIUS_M * step * STEP_NS * 1e-9
        stamp = t["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        numbered = {"seq": step} if store is ROS1 else {}
        header = t["std_msgs/msg/Header"](**numbered, stamp=stamp, frame_id="map" + "x" * (step % 3))
        vector, quaternion = t["geometry_msgs/msg/Vector3"], t["geometry_msgs/msg/Quaternion"]
        heading = angle + math.pi / 2  # ENU, counter-clockwise from east
        turned = quaternion(0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))
        pose = t["geometry_msgs/msg/Pose"](
            t["geometry_msgs/msg/Point"](RADIUS_M * math.cos(angle), RADIUS_M * math.sin(angle), 0.0), turned
        )
        twist = t["geometry_msgs/msg/Twist"](vector(SPEED_MPS, 0.0, 0.0), vector(0.0, 0.0, SPEED_MPS / RADIUS_M))
        odometry = t["nav_msgs/msg/Odometry"](
            header,
            "base_link",
            t["geometry_msgs/msg/PoseWithCovariance"](pose, np.arange(36.0)),
            t["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
        )
        yield "/odometry", "nav_msgs/msg/Odometry", stamp_ns, odometry
        nine = np.arange(9.0)
        imu = t["sensor_msgs/msg/Imu"](header, turned, nine, vector(0.0, 0.0, 0.1), nine, vector(0.2, 0.0, 9.8), nine)
        yield "/imu/data", "sensor_msgs/msg/Imu", stamp_ns + 1, imu
        status = t["sensor_msgs/msg/NavSatStatus"](0, 1)
        degrees = 1.0 / 111_195.0
        fix = t["sensor_msgs/msg/NavSatFix"](
            header, status, 52.0 + pose.position.y * degrees, 4.0 + pose.position.x * degrees, 1.5, nine, 2
        )
        yield "/fix", "sensor_msgs/msg/NavSatFix", stamp_ns + 2, fix
        names = [f"drum {number}" * (step % 4) for number in range(step % 3)]
        winch = t[CUSTOM](names, step % 256, 0.5 * step, np.array([step, -step, 7], dtype=np.int16))
        yield "/winch", CUSTOM, stamp_ns + 3, winch
        yield (
            "/thrusters/left/cmd",
            "std_msgs/msg/Float64",
            stamp_ns + 4,
            t["std_msgs/msg/Float64"](10.0 * math.sin(step)),
        )


def write_bag1(path: Path, steps: int = 40, compression: str | None = None) -> Path:
    """A ROS 1 bag with a chunk every few messages."""
    writer = Bag1Writer(path)
    if compression is not None:
        writer.set_compression(Bag1Writer.CompressionFormat[compression])
    writer.chunk_threshold = 8_000
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, stamp_ns, message in messages(ROS1, steps):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(connections[topic], stamp_ns, ROS1.serialize_ros1(message, kind))
    return path


def write_bag2(
    path: Path, steps: int = 40, storage: StoragePlugin = StoragePlugin.SQLITE3, packed: CompressionMode | None = None
) -> Path:
    """The folder of a ROS 2 bag."""
    writer = Bag2Writer(path, version=9, storage_plugin=storage)
    if packed is not None:
        writer.set_compression(packed, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, stamp_ns, message in messages(ROS2, steps):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(connections[topic], stamp_ns, ROS2.serialize_cdr(message, kind))
    return path
