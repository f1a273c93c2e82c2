"""The middleware that a profile requests, if this machine has it, and the check of `xitl doctor`."""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
from typing import Literal

from agent.board.doctor import OK, WARNING, DoctorFinding
from xitl_cli.errors import UserError
from xitl_cli.extras import ROS2
from xitl_cli.plugins.ros.middleware import NODE_NAME, Middleware
from xitl_cli.profile.schema.ros import RosSpec

MOST_SHOWN = 120
"""Number of characters of an import error in messages."""


def open_middleware(spec: RosSpec) -> Middleware:
    """Open the middleware of the profile. Raises UserError if it is not available."""
    if spec.master is not None:
        from xitl_cli.plugins.ros.tcpros_middleware import TcprosMiddleware

        return TcprosMiddleware(spec, NODE_NAME)
    problem = None
    if ros2_way(spec) == "rclpy":
        problem = rclpy_problem()
        if problem is None:
            from xitl_cli.plugins.ros.rclpy_middleware import RclpyMiddleware

            return RclpyMiddleware(spec, NODE_NAME)
        if spec.way == "rclpy" or ROS2.missing:
            fix = f"run xitl in the Python of that ROS, or {ROS2.pip_line}"
            raise UserError(f"ros: rclpy cannot be imported ({problem}); {fix}")
    from xitl_cli.plugins.ros.cyclone_middleware import CycloneMiddleware

    cyclone = CycloneMiddleware(spec, NODE_NAME)
    if problem is not None:
        cyclone.name += f", since rclpy cannot be imported ({problem})"
    return cyclone


def rclpy_problem() -> str | None:
    """Return why the installed rclpy cannot be imported, for example one for another Python; None if it can."""
    try:
        import_module("rclpy")
    except ImportError as error:
        return str(error).splitlines()[0][:MOST_SHOWN]
    return None


def ros2_way(spec: RosSpec) -> Literal["rclpy", "cyclonedds"]:
    """Return the available middleware. Raises UserError if there is none."""
    if spec.way != "cyclonedds" and find_spec("rclpy") is not None:
        return "rclpy"
    if spec.way == "rclpy":
        raise UserError("ros.way = rclpy: rclpy is not installed; source a ROS 2, or use ros.way: cyclonedds")
    if ROS2.missing:
        raise UserError(f"ros: neither rclpy nor cyclonedds is installed; source a ROS 2, or {ROS2.pip_line}")
    return "cyclonedds"


def check_ros() -> DoctorFinding:
    """Report how `--ros` would connect to ROS 2; ROS 1 has no requirements."""
    sourced = os.environ.get("ROS_DISTRO", "")
    distribution = f" of ROS 2 {sourced}" if sourced else ""
    try:
        way = ros2_way(RosSpec())
    except UserError:
        return DoctorFinding("ROS 2", OK, "neither rclpy nor cyclonedds (only for `--ros`)", ROS2.pip_line)
    if way == "cyclonedds":
        return DoctorFinding("ROS 2", OK, "cyclonedds; this Python has no rclpy")
    if (problem := rclpy_problem()) is None:
        return DoctorFinding("ROS 2", OK, f"rclpy{distribution}")
    instead = ROS2.pip_line if ROS2.missing else "cyclonedds is used instead; or run xitl in the Python of that ROS"
    level = WARNING if ROS2.missing else OK
    return DoctorFinding("ROS 2", level, f"rclpy{distribution} cannot be imported ({problem})", instead)
