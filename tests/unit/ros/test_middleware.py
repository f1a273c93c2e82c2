"""Names and QoS of ROS, and which way in is taken."""

from __future__ import annotations

import pytest

from xitl_cli.errors import UserError
from xitl_cli.profile.schema.ros import RosSpec, RosTopicSpec
from xitl_cli.ros import middleware
from xitl_cli.ros.middleware import LATCHED, RELIABLE, QosProfile, qos_with, ros2_way


def test_a_topic_has_the_qos_that_the_profile_gives_it() -> None:
    assert qos_with(RELIABLE, RosTopicSpec()) == RELIABLE
    asked = RosTopicSpec(reliability="best_effort", depth=3)
    assert qos_with(LATCHED, asked) == QosProfile("best_effort", "transient_local", 3)


def test_the_way_in_is_rclpy_where_it_is_and_else_cyclonedds(monkeypatch: pytest.MonkeyPatch) -> None:
    there: set[str] = set()
    monkeypatch.setattr(middleware, "find_spec", lambda name: name if name in there else None)
    monkeypatch.setattr("xitl_cli.extras.find_spec", lambda name: name if name in there else None)
    with pytest.raises(UserError, match=r"pip install 'xitl\[ros2\]'"):
        ros2_way(RosSpec())
    there.add("cyclonedds")
    assert ros2_way(RosSpec()) == "cyclonedds"
    with pytest.raises(UserError, match=r"source a ROS 2, or use ros.way: cyclonedds"):
        ros2_way(RosSpec(way="rclpy"))
    there.add("rclpy")
    assert ros2_way(RosSpec()) == "rclpy"
    assert ros2_way(RosSpec(way="cyclonedds")) == "cyclonedds"


@pytest.mark.parametrize(
    ("keys", "what"),
    [
        ({"namespace": "my boat"}, "no namespace"),
        ({"namespace": "/boat/"}, "no namespace"),
        ({"master": "localhost:11311"}, "ros1://HOST:PORT"),
        ({"domain": 233}, "domain"),
        ({"depth": 0}, "depth"),
    ],
)
def test_what_is_no_key_of_ros_is_refused(keys: dict[str, object], what: str) -> None:
    with pytest.raises(ValueError, match=what):
        RosSpec(**keys)  # type: ignore[arg-type]
