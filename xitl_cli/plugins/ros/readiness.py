"""What `xitl doctor` says of ROS."""

from __future__ import annotations

import os

from agent.board.doctor import OK, WARNING, DoctorFinding
from xitl_cli.errors import UserError
from xitl_cli.extras import ROS2
from xitl_cli.plugins.ros import middleware_choice
from xitl_cli.profile.schema.ros import RosSpec


def check_ros() -> DoctorFinding:
    """By which way `--ros` would go into ROS 2; ROS 1 needs nothing."""
    sourced = os.environ.get("ROS_DISTRO", "")
    named = f" of ROS 2 {sourced}" if sourced else ""
    try:
        way = middleware_choice.ros2_way(RosSpec())
    except UserError:
        return DoctorFinding("ROS 2", OK, "neither rclpy nor cyclonedds (only for `--ros`)", ROS2.pip_line)
    if way == "cyclonedds":
        return DoctorFinding("ROS 2", OK, "cyclonedds; no rclpy is sourced for this Python")
    if (problem := middleware_choice.rclpy_problem()) is None:
        return DoctorFinding("ROS 2", OK, f"rclpy{named}")
    instead = ROS2.pip_line if ROS2.missing else "cyclonedds is used instead; or run xitl in the Python of that ROS"
    level = WARNING if ROS2.missing else OK
    return DoctorFinding("ROS 2", level, f"rclpy{named} cannot be imported ({problem})", instead)
