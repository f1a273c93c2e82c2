"""Cyclone DDS as ROS 2's own middleware uses it, with itself at the other end."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
from ros2 import own_domain

from tests.patience import PATIENCE_S

cyclonedds = pytest.importorskip("cyclonedds")

from rosbags.typesys import Stores, get_typestore  # noqa: E402

from tests.golden import Golden  # noqa: E402
from xitl_cli.errors import UserError  # noqa: E402
from xitl_cli.plugins.ros.cyclone_middleware import CycloneMiddleware, dds_type, ros_domain  # noqa: E402
from xitl_cli.plugins.ros.middleware import COMMANDS, RELIABLE  # noqa: E402
from xitl_cli.profile.schema.ros import RosSpec  # noqa: E402

STORE = get_typestore(Stores.ROS2_JAZZY)
TWIST = "geometry_msgs/msg/Twist"
DOMAIN = own_domain()


@pytest.fixture
def node() -> Iterator[CycloneMiddleware]:
    node = CycloneMiddleware(RosSpec(domain=DOMAIN))
    yield node
    node.close()


def until(node: CycloneMiddleware, come: Callable[[], bool]) -> None:
    limit_s = time.monotonic() + PATIENCE_S
    while not come():
        assert time.monotonic() < limit_s, "nothing came"
        node.spin(0.02)


def test_bytes_go_through_as_they_are(node: CycloneMiddleware) -> None:
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    twist = STORE.types[TWIST](linear=vector(1.0, 2.0, 3.0), angular=vector(0.0, 0.0, 0.5))
    payload = bytes(STORE.serialize_cdr(twist, TWIST))
    taken: list[bytes] = []
    node.subscribe("/cmd_vel", TWIST, COMMANDS, taken.append)
    publish = node.advertise("/cmd_vel", TWIST, RELIABLE)
    publish(payload)
    until(node, lambda: bool(taken))
    assert taken == [payload]


def test_a_qos_that_does_not_match_is_named_once(node: CycloneMiddleware, golden: Golden) -> None:
    node.advertise("/clock", "rosgraph_msgs/msg/Clock", COMMANDS)
    node.subscribe("/clock", "rosgraph_msgs/msg/Clock", RELIABLE, lambda payload: None)
    problems: list[str] = []

    def told() -> bool:
        problems.extend(node.problems())
        return bool(problems)

    until(node, told)
    node.spin(0.0)
    assert len([*problems, *node.problems()]) == 1
    golden("problem", problems[0])


@pytest.mark.parametrize(
    ("variable", "value", "fix"),
    [
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "use another domain, or ros.way: rclpy"),
        ("ROS_STATIC_PEERS", "192.0.2.7", "give peers in CYCLONEDDS_URI, or use ros.way: rclpy"),
    ],
)
def test_what_the_environment_asks_for_in_vain_is_said(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str, fix: str
) -> None:
    monkeypatch.setenv(variable, value)
    node = CycloneMiddleware(RosSpec(domain=DOMAIN))
    problems = node.problems()
    node.close()
    assert len(problems) == 1
    assert problems[0].startswith(f"ros: {variable}")
    assert problems[0].endswith(fix)


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("sensor_msgs/msg/PointCloud2", ["header", "height", "width", "fields", "is_bigendian"]),
        ("tf2_msgs/msg/TFMessage", ["transforms"]),
    ],
)
def test_a_type_is_named_as_ros_names_it(name: str, fields: list[str]) -> None:
    kind = dds_type(name)
    package, _, last = name.split("/")
    assert kind.__idl_typename__.replace(".", "::") == f"{package}::msg::dds_::{last}_"
    assert list(kind.__annotations__)[: len(fields)] == fields


def test_the_domain_is_the_profile_s_or_the_environment_s(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert ros_domain(RosSpec()) == 0
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert ros_domain(RosSpec()) == 42
    assert ros_domain(RosSpec(domain=3)) == 3
    monkeypatch.setenv("ROS_DOMAIN_ID", "one")
    with pytest.raises(UserError, match="ROS_DOMAIN_ID=one is not a domain"):
        ros_domain(RosSpec())


@pytest.mark.parametrize(("commander", "come"), [("/xitl", True), ("/helm", False)])
def test_a_message_counts_where_its_node_is_listed(commander: str, come: bool) -> None:
    node = CycloneMiddleware(RosSpec(domain=DOMAIN, commanders=(commander,)))
    try:
        taken: list[bytes] = []
        node.subscribe("/armed", "std_msgs/msg/Bool", RELIABLE, taken.append)
        publish = node.advertise("/armed", "std_msgs/msg/Bool", RELIABLE)  # of the node /xitl
        publish(b"\0\1\0\0\1")
        until(node, lambda: bool(taken or node.losses().refused))
        assert (bool(taken), dict(node.losses().refused)) == (come, {} if come else {"/armed": 1})
        refusals = [problem for problem in node.problems() if "ros: /armed: /xitl may not command" in problem]
        assert len(refusals) == (0 if come else 1)
    finally:
        node.close()
