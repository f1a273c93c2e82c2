"""Names and QoS of ROS, and which way in is taken."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import pytest

from agent.board.doctor import WARNING
from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.plugins.ros import middleware_choice
from xitl_cli.plugins.ros.middleware import (
    LATCHED,
    RELIABLE,
    QosProfile,
    mismatch_text,
    others_text,
    qos_with,
)
from xitl_cli.plugins.ros.middleware_choice import check_ros, open_middleware, rclpy_problem, ros2_way
from xitl_cli.plugins.ros.outputs import OUTPUTS
from xitl_cli.profile.schema.ros import RosSpec, RosTopicSpec


@pytest.mark.parametrize(
    ("topic", "vessel", "namespace", "name"),
    [
        ("imu/data", "", "", "/imu/data"),
        ("imu/data", "alpha", "boats/north", "/boats/north/alpha/imu/data"),
        ("/tf", "alpha", "boats", "/tf"),
    ],
)
def test_a_name_is_namespace_vessel_and_topic(topic: str, vessel: str, namespace: str, name: str) -> None:
    assert OUTPUTS[topic].full_name(vessel, namespace) == name


def test_a_mismatch_names_the_fix(golden: Golden) -> None:
    ours = QosProfile()
    wants = mismatch_text("/boats/imu/data", "durability", ours, offers=True)
    golden("text", wants)
    assert mismatch_text("/arm", "reliability", ours, offers=False).endswith("publish with reliable")
    assert "ros2 topic info -v /arm" in mismatch_text("/arm", "deadline", ours, offers=False)


def test_others_that_publish_the_same_are_told_with_the_fix(golden: Golden) -> None:
    text = others_text(["/fix", "/imu/data", "/odometry", "/points"], "in domain 3")
    golden("text", text)
    assert text.endswith("use another ros.domain, or ros.namespace")
    assert others_text(["/clock"], "in domain 3").endswith("use another ros.domain")


def test_a_topic_has_the_qos_that_the_profile_gives_it() -> None:
    assert qos_with(RELIABLE, RosTopicSpec()) == RELIABLE
    asked = RosTopicSpec(reliability="best_effort", depth=3)
    assert qos_with(LATCHED, asked) == QosProfile("best_effort", "transient_local", 3)


def test_the_way_in_is_rclpy_where_it_is_and_else_cyclonedds(monkeypatch: pytest.MonkeyPatch) -> None:
    there: set[str] = set()
    monkeypatch.setattr(middleware_choice, "find_spec", lambda name: name if name in there else None)
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
        ({"namespace": "my boat"}, "is not a ROS namespace"),
        ({"namespace": "/boat/"}, "is not a ROS namespace"),
        ({"master": "localhost:11311"}, "ros1://HOST:PORT"),
        ({"domain": 233}, "domain"),
        ({"depth": 0}, "depth"),
    ],
)
def test_what_is_no_key_of_ros_is_refused(keys: dict[str, object], what: str) -> None:
    with pytest.raises(ValueError, match=what):
        RosSpec(**keys)  # type: ignore[arg-type]


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
    assert check_ros().found == "cyclonedds; this Python has no rclpy"


class Opened:
    """A middleware that was opened."""

    def __init__(self, spec: RosSpec, node_name: str) -> None:
        assert node_name == "xitl"
        self.spec = spec
        self.name = "cyclonedds"


def test_the_middleware_is_that_of_the_profile_or_the_one_that_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = {}
    for module, name in (("tcpros", "Tcpros"), ("rclpy", "Rclpy"), ("cyclone", "Cyclone")):
        kinds[module] = type(name, (Opened,), {})
        made = ModuleType(module)
        setattr(made, f"{name}Middleware", kinds[module])
        monkeypatch.setitem(sys.modules, f"xitl_cli.plugins.ros.{module}_middleware", made)
    there = {"rclpy", "cyclonedds"}
    for where in ("xitl_cli.extras", "xitl_cli.plugins.ros.middleware_choice"):
        monkeypatch.setattr(f"{where}.find_spec", lambda name: name if name in there else None)
    rclpy: list[str | None] = [None]
    monkeypatch.setattr(middleware_choice, "rclpy_problem", lambda: rclpy[0])
    spec = RosSpec(master="ros1://localhost:11311")
    opened: Any = open_middleware(spec)
    assert (type(opened), opened.spec) == (kinds["tcpros"], spec)
    assert isinstance(open_middleware(RosSpec()), kinds["rclpy"])
    assert isinstance(opened := open_middleware(RosSpec(way="cyclonedds")), kinds["cyclone"])
    assert opened.name == "cyclonedds"
    rclpy[0] = "for Python 3.12"
    assert isinstance(opened := open_middleware(RosSpec()), kinds["cyclone"])
    assert opened.name == "cyclonedds, since rclpy cannot be imported (for Python 3.12)"
    with pytest.raises(UserError, match=r"rclpy cannot be imported \(for Python 3.12\); run xitl in the Python"):
        open_middleware(RosSpec(way="rclpy"))
    there.remove("cyclonedds")
    with pytest.raises(UserError, match=r"rclpy cannot be imported \(for Python 3.12\)"):
        open_middleware(RosSpec())


def test_an_rclpy_that_cannot_be_imported_is_named_by_its_first_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", ModuleType("rclpy"))
    assert rclpy_problem() is None

    def fail(name: str) -> None:
        assert name == "rclpy"
        raise ImportError("x" * 200 + "\nsecond line")

    monkeypatch.setattr(middleware_choice, "import_module", fail)
    assert rclpy_problem() == "x" * 120
