"""Clouds of a bag, in the vessel's axes: against points that are turned by hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.mapping.clouds import clouds

STORE = get_typestore(Stores.ROS1_NOETIC)
STORE.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
T = STORE.types
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("pad", "<u4"), ("t", "<u4"), ("intensity", "<f4")])
CODES = {"f4": 7, "u4": 6}
STAMP_NS = 1_700_000_000 * 10**9


def header(frame: str) -> Any:
    return T["std_msgs/msg/Header"](0, T["builtin_interfaces/msg/Time"](STAMP_NS // 10**9, 0), frame)


def cloud(points: np.ndarray, names: tuple[str, ...] = ("x", "y", "z", "t", "intensity")) -> Any:
    kinds = points.dtype.fields or {}
    fields = [T["sensor_msgs/msg/PointField"](name, kinds[name][1], CODES[kinds[name][0].str[1:]], 1) for name in names]
    step = points.dtype.itemsize
    data = points.view(np.uint8).reshape(-1)
    return T["sensor_msgs/msg/PointCloud2"](
        header("lidar_link"), 1, len(points), fields, False, step, step * len(points), data, True
    )


def transform(parent: str, child: str, place: tuple[float, float, float], yaw_rad: float) -> Any:
    turn = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2))
    moved = T["geometry_msgs/msg/Transform"](T["geometry_msgs/msg/Vector3"](*place), turn)
    return T["geometry_msgs/msg/TransformStamped"](header(parent), child, moved)


def bag(path: Path, *messages: tuple[str, Any]) -> Path:
    with Writer(path) as writer:
        for topic, message in messages:
            connection = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            writer.write(connection, STAMP_NS, STORE.serialize_ros1(message, message.__msgtype__))
    return path


def test_points_are_turned_into_the_vessels_axes_along_the_chain_of_frames(tmp_path: Path) -> None:
    points = np.zeros(3, dtype=POINT)
    points["x"], points["y"], points["z"] = (1.0, 0.0, np.nan), (0.0, 2.0, 0.0), (0.5, 0.0, 0.0)
    points["t"], points["intensity"] = (0, 50_000_000, 0), (7.0, 900.0, 1.0)
    chain = [
        transform("base_link", "mast", (1.0, 0.0, 2.0), math.pi / 2),
        transform("mast", "lidar_link", (0.1, 0.0, 0.0), 0.0),
    ]
    small = ("/front/points", cloud(np.zeros(1, dtype=POINT)))
    path = bag(
        tmp_path / "boat.bag", small, ("/points", cloud(points)), ("/tf_static", T["tf2_msgs/msg/TFMessage"](chain))
    )
    with open_log(path) as log:
        (found,) = clouds(log)
    # By hand, in FLU: x and y turn by 90 degrees to port, (x, y) -> (-y, x), then the mast; y and z change sign in FRD.
    assert np.allclose(found.points_m, [[1.0, -1.1, -2.5], [-1.0, -0.1, -2.0]], atol=1e-6)
    assert np.allclose(found.offset_s, [0.0, 0.05])
    assert found.intensity.tolist() == [7, 255]
    assert found.stamp_ns == STAMP_NS


def test_what_is_no_cloud_is_refused(tmp_path: Path) -> None:
    flat = bag(tmp_path / "flat.bag", ("/points", cloud(np.zeros(2, dtype=POINT), ("x", "t"))))
    none = bag(tmp_path / "none.bag", ("/tf_static", T["tf2_msgs/msg/TFMessage"]([])))
    for path, said in ((flat, "no x, y and z"), (none, "no PointCloud2")):
        with open_log(path) as log, pytest.raises(UserError, match=said):
            list(clouds(log))
