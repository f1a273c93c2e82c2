"""What the doctor says of ROS 2 on this machine."""

from __future__ import annotations

import pytest

from agent.board.doctor import WARNING
from xitl_cli.plugins.ros.middleware_choice import check_ros


def test_the_way_into_ros_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    there = {"rclpy", "cyclonedds"}
    for where in ("xitl_cli.extras", "xitl_cli.plugins.ros.middleware_choice"):
        monkeypatch.setattr(f"{where}.find_spec", lambda name: name if name in there else None)
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    monkeypatch.setattr("xitl_cli.plugins.ros.middleware_choice.rclpy_problem", lambda: None)
    assert check_ros().found == "rclpy of ROS 2 jazzy"
    monkeypatch.setattr("xitl_cli.plugins.ros.middleware_choice.rclpy_problem", lambda: "for Python 3.12")
    assert check_ros().found == "rclpy of ROS 2 jazzy cannot be imported (for Python 3.12)"
    assert "cyclonedds is used instead" in check_ros().advice
    there.remove("cyclonedds")
    assert check_ros().level == WARNING
    there.clear()
    assert check_ros().advice == "pip install 'xitl[ros2]'"
    there.add("cyclonedds")
    assert check_ros().found == "cyclonedds; no rclpy is sourced for this Python"
