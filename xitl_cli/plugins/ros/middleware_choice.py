"""The middleware that a profile asks for, of those that this machine has."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Literal

from xitl_cli.errors import UserError
from xitl_cli.extras import ROS2
from xitl_cli.plugins.ros.middleware import NODE_NAME, Middleware
from xitl_cli.profile.schema.ros import RosSpec

MOST_SAID = 120
"""Characters of an import error that are shown."""


def open_middleware(spec: RosSpec, node_name: str = NODE_NAME) -> Middleware:
    """The way in that the profile asks for. Raises UserError where there is none."""
    if spec.master is not None:
        from xitl_cli.plugins.ros.tcpros_middleware import TcprosMiddleware

        return TcprosMiddleware(spec, node_name)
    problem = None
    if ros2_way(spec) == "rclpy":
        problem = rclpy_problem()
        if problem is None:
            from xitl_cli.plugins.ros.rclpy_middleware import RclpyMiddleware

            return RclpyMiddleware(spec, node_name)
        if spec.way == "rclpy" or ROS2.missing:
            fix = f"run xitl in the Python of that ROS, or {ROS2.pip_line}"
            raise UserError(f"ros: rclpy cannot be imported ({problem}); {fix}")
    from xitl_cli.plugins.ros.cyclone_middleware import CycloneMiddleware

    cyclone = CycloneMiddleware(spec, node_name)
    if problem is not None:
        cyclone.name += f", since rclpy cannot be imported ({problem})"
    return cyclone


def rclpy_problem() -> str | None:
    """Why the rclpy that is here cannot be imported, as one for another Python; None where it can be."""
    try:
        import_module("rclpy")
    except ImportError as error:
        return str(error).splitlines()[0][:MOST_SAID]
    return None


def ros2_way(spec: RosSpec) -> Literal["rclpy", "cyclonedds"]:
    """Which of the two there is. Raises UserError where it is not."""
    if spec.way != "cyclonedds" and find_spec("rclpy") is not None:
        return "rclpy"
    if spec.way == "rclpy":
        raise UserError("ros.way = rclpy: it cannot be imported here; source a ROS 2, or use ros.way: cyclonedds")
    if ROS2.missing:
        raise UserError(f"ros: neither rclpy (source a ROS 2) nor cyclonedds is here; {ROS2.pip_line}")
    return "cyclonedds"
