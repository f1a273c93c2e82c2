"""Recordings as ROS 2 tools make them, written by mcap-ros2-support."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer

from xitl_cli.record.topics import OdometryMessage

_LINE = "=" * 80
_STD = f"""
{_LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_VECTOR = f"""
{_LINE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{_LINE}
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
"""
IMU = f"""# as rosbag2 writes it
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance # Row major
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
{_STD}{_VECTOR}"""
FIX = f"""std_msgs/Header header
sensor_msgs/NavSatStatus status
float64 latitude
float64 longitude
float64 altitude
float64[9] position_covariance
uint8 COVARIANCE_TYPE_UNKNOWN = 0
uint8 COVARIANCE_TYPE_KNOWN=3
uint8 position_covariance_type
{_STD}{_LINE}
MSG: sensor_msgs/NavSatStatus
int8 STATUS_NO_FIX =  -1        # unable to fix position
int8 status
uint16 SERVICE_GPS =     1
uint16 service
"""
CLOUD = f"""std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool    is_bigendian
uint32  point_step
uint32  row_step
uint8[] data
bool is_dense
{_STD}{_LINE}
MSG: sensor_msgs/PointField
uint8 INT8    = 1
uint8 FLOAT32 = 7
string name
uint32 offset
uint8  datatype
uint32 count
"""
TF = f"""geometry_msgs/TransformStamped[] transforms
{_LINE}
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
Transform transform
{_LINE}
MSG: geometry_msgs/Transform
Vector3 translation
Quaternion rotation
{_STD}{_VECTOR}"""
SCAN = f"""std_msgs/Header header
float32 angle_min
float32 scan_time
float32[] ranges
float32[<=4] intensities
{_STD}"""
JOINTS = f"""std_msgs/Header header
string[] name
float64[] position
builtin_interfaces/Duration took
string<=9 note "none"
byte[3] flags
{_STD}"""
PATH = f"""std_msgs/Header header
geometry_msgs/PoseStamped[] poses
{_STD}{_VECTOR}{_LINE}
MSG: geometry_msgs/PoseStamped
std_msgs/Header header
geometry_msgs/Vector3 position
"""
ODD = f"""std_msgs/Empty nothing
int8 a
int16 b
int64 c
bool d
float32 e
geometry_msgs/Vector3[2] pair
geometry_msgs/Vector3[] some
t/Inner[] inner
uint64 last
{_LINE}
MSG: std_msgs/Empty
{_LINE}
MSG: t/Inner
uint8 a
int32[] b
string c
{_VECTOR}"""
SCHEMAS = {
    "/odom": ("nav_msgs/msg/Odometry", OdometryMessage.definition),
    "/imu": ("sensor_msgs/msg/Imu", IMU),
    "/fix": ("sensor_msgs/msg/NavSatFix", FIX),
    "/cloud": ("sensor_msgs/msg/PointCloud2", CLOUD),
    "/tf": ("tf2_msgs/TFMessage", TF),
    "/scan": ("sensor_msgs/msg/LaserScan", SCAN),
    "/joints": ("sensor_msgs/msg/JointState", JOINTS),
    "/path": ("nav_msgs/msg/Path", PATH),
    "/odd": ("t/msg/Odd", ODD),
}


def messages(step: int, random: np.random.Generator) -> dict[str, Any]:
    """One message a topic, whose texts and arrays differ in length from step to step."""

    def triple() -> dict[str, float]:
        return dict(zip("xyz", random.normal(size=3).tolist(), strict=True))

    header = {"stamp": {"sec": step, "nanosec": 5 * step}, "frame_id": "map"}
    varying = header | {"frame_id": "m" * (step % 6)}
    turn = {**triple(), "w": 0.25}
    transform = {
        "header": header,
        "child_frame_id": "c" * (step % 3),
        "transform": {"translation": triple(), "rotation": turn},
    }
    return {
        "/odom": {
            "header": header,
            "child_frame_id": "base",
            "pose": {
                "pose": {"position": triple(), "orientation": turn},
                "covariance": random.normal(size=36).tolist(),
            },
            "twist": {"twist": {"linear": triple(), "angular": triple()}, "covariance": [0.0] * 36},
        },
        "/imu": {
            "header": varying,
            "orientation": turn,
            "orientation_covariance": random.normal(size=9).tolist(),
            "angular_velocity": triple(),
            "angular_velocity_covariance": [math.nan] * 9,
            "linear_acceleration": triple(),
            "linear_acceleration_covariance": [math.inf] * 9,
        },
        "/fix": {
            "header": header,
            "status": {"status": -1, "service": 65535},
            "latitude": -8.8 + step,
            "longitude": -63.9,
            "altitude": 70.0,
            "position_covariance": [1.0] * 9,
            "position_covariance_type": 3,
        },
        "/cloud": {
            "header": header,
            "height": 1,
            "width": step,
            "fields": [{"name": "xyz"[i], "offset": 4 * i, "datatype": 7, "count": 1} for i in range(3)],
            "point_step": 12,
            "row_step": 12 * step,
            "data": random.bytes(12 * step),
            "is_dense": True,
        },
        "/tf": {"transforms": [transform] * (1 + step % 3)},
        "/scan": {"header": header, "ranges": random.normal(size=step % 7).tolist(), "intensities": [1.0, 2.0]},
        "/joints": {
            "header": header,
            "name": ["left", "right" * (step % 4)],
            "position": [0.5, -0.5],
            "took": {"sec": 1, "nanosec": step},
            "note": "é" * (step % 3),
            "flags": b"\x01\x02\xff",
        },
        "/path": {"header": header, "poses": [{"header": varying, "position": triple()}] * (step % 50)},
        "/odd": {
            "a": -step,
            "b": -300,
            "c": -(2**62),
            "d": step % 2 == 0,
            "e": 0.1,
            "pair": [triple(), triple()],
            "some": [triple()] * (40 + step % 5),
            "inner": [{"a": 7, "b": list(range(step % 4)), "c": "t" * (step % 5)}] * (step % 6),
            "last": 2**64 - 1,
        },
    }


def write(
    path: Path,
    steps: int = 40,
    compression: CompressionType = CompressionType.NONE,
    chunk_size: int = 4096,
    epoch_ns: int = 0,
) -> Path:
    """All topics, `steps` messages each, every 10 ms."""
    random = np.random.default_rng(5)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size, compression=compression)
        known = {topic: writer.register_msgdef(name, text) for topic, (name, text) in SCHEMAS.items()}
        for step in range(steps):
            stamp_ns = epoch_ns + step * 10_000_000
            for topic, message in messages(step, random).items():
                writer.write_message(topic, known[topic], message, stamp_ns, stamp_ns, step)
        writer.finish()
    return path
