"""Clouds, scans and echoes as ROS messages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__LaserScan as LaserScan,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__PointCloud2 as PointCloud2,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__PointField as PointField,
)

from sim_core.frames import euler_to_quat, quat_to_euler, quat_to_matrix
from xitl_cli.plugins.ros.frames import FixedFrame
from xitl_cli.record.topics import LIDAR_POINT, SONAR_POINT

Array = NDArray[np.float64]

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
TIMED_POINT = np.dtype([*POINT.descr, ("time", "<f4")])
"""time: seconds after the stamp, as in Velodyne's driver."""
_FLOAT32 = 7  # PointField
SCAN_BINS = 360
SCAN_HEIGHTS_M = 0.1, 3.0


class CloudFrame:
    """Points of `base_link` in a sensor's frame."""

    def __init__(self, frame: FixedFrame) -> None:
        x, y, z, w = frame.turn
        self.from_base = quat_to_matrix(np.array([w, x, y, z]))  # rows times it: the inverse rotation
        self.place_m = np.array(frame.position_m)

    def points(self, base_m: Array) -> Array:
        """Transform (n, 3) from `base_link` to the sensor's frame."""
        turned: Array = (base_m - self.place_m) @ self.from_base
        return turned


def recorded_points(data: bytes, timed: bool) -> tuple[Array, NDArray[np.void]]:
    """Return (n, 3) in `base_link` and the packed points of a cloud in the recorder's format."""
    packed = np.frombuffer(data, dtype=LIDAR_POINT if timed else SONAR_POINT)
    return np.column_stack([packed[axis] for axis in "xyz"]).astype(np.float64), packed


def point_cloud(header: Any, points_m: Array, intensity: NDArray[Any], time_s: NDArray[Any] | None = None) -> Any:
    """Return a PointCloud2 of points (n, 3) with intensities (n,), and optional instants (n,)."""
    packed = np.zeros(len(points_m), dtype=POINT if time_s is None else TIMED_POINT)
    for axis, name in enumerate("xyz"):
        packed[name] = points_m[:, axis]
    packed["intensity"] = intensity
    if time_s is not None:
        packed["time"] = time_s
    kinds = packed.dtype.fields
    assert kinds is not None
    return PointCloud2(
        header=header,
        height=1,
        width=len(packed),
        fields=[PointField(name=name, offset=kind[1], datatype=_FLOAT32, count=1) for name, kind in kinds.items()],
        is_bigendian=False,
        point_step=packed.dtype.itemsize,
        row_step=packed.dtype.itemsize * len(packed),
        data=packed.view(np.uint8).reshape(-1),
        is_dense=True,
    )


def echo_points(angle_rad: float, ranges_m: Array) -> Array:
    """Return (n, 3) along a beam; its angle is to starboard of the frame's x axis."""
    return np.column_stack([ranges_m * math.cos(angle_rad), -ranges_m * math.sin(angle_rad), np.zeros(len(ranges_m))])


def leveled(base_m: Array, attitude_wxyz: tuple[float, float, float, float] | None) -> Array:
    """Rotate (n, 3) of `base_link` to level axes with the same heading; attitude FLU to ENU, None if unknown."""
    if attitude_wxyz is None:
        return base_m
    roll_rad, pitch_rad, _ = quat_to_euler(np.array(attitude_wxyz))
    turned: Array = base_m @ quat_to_matrix(euler_to_quat(np.array([roll_rad, pitch_rad, 0.0]))).T
    return turned


def scan_of_cloud(header: Any, base_m: Array, water_up_m: float, limits_m: tuple[float, float], period_s: float) -> Any:
    """Return a LaserScan in `base_link` with the nearest point above the water in each bin of azimuth. base_m: (n, 3),
    leveled.

    water_up_m: water level at rest above the body's origin. limits_m: shortest and longest range of the lidar.
    """
    height_m = base_m[:, 2] - water_up_m
    above = base_m[(height_m >= SCAN_HEIGHTS_M[0]) & (height_m <= SCAN_HEIGHTS_M[1])]
    range_m = np.hypot(above[:, 0], above[:, 1])
    step_rad = math.tau / SCAN_BINS
    bins = np.floor((np.arctan2(above[:, 1], above[:, 0]) + math.pi) / step_rad).astype(np.intp) % SCAN_BINS
    nearest = np.full(SCAN_BINS, np.inf, dtype=np.float32)
    np.minimum.at(nearest, bins, range_m.astype(np.float32))
    return laser_scan(header, nearest, -math.pi + 0.5 * step_rad, limits_m, period_s)


def laser_scan(
    header: Any, ranges_m: NDArray[np.float32], first_rad: float, limits_m: tuple[float, float], period_s: float
) -> Any:
    """Return a LaserScan of ranges (n,), full circle, counter-clockwise from first_rad; inf for no object (REP 117)."""
    step_rad = math.tau / len(ranges_m)
    return LaserScan(
        header=header,
        angle_min=first_rad,
        angle_max=first_rad + step_rad * (len(ranges_m) - 1),
        angle_increment=step_rad,
        time_increment=0.0,
        scan_time=period_s,
        range_min=limits_m[0],
        range_max=limits_m[1],
        ranges=ranges_m,
        intensities=np.zeros(0, dtype=np.float32),
    )
