"""Hashes and bytes of message types against those that ROS has published."""

from __future__ import annotations

import pytest
from rosbags.typesys.stores.ros2_jazzy import (
    builtin_interfaces__msg__Time as Time,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__Range as Range,
)
from rosbags.typesys.stores.ros2_jazzy import (
    std_msgs__msg__Header as Header,
)

from xitl_cli.plugins.ros.definitions import (
    MessageTypes,
    deserialize,
    from_ros1,
    ros1_definition,
    ros2_definition,
    serialize,
    to_ros1,
    type_hash,
)
from xitl_cli.plugins.ros.outputs import OUTPUTS
from xitl_cli.record.topics import TOPICS


@pytest.mark.parametrize(
    ("type_name", "md5"),
    [  # as `rosmsg md5` of Noetic says
        ("sensor_msgs/msg/Imu", "6a62c6daae103f4ff57a132d6f95cec2"),
        ("nav_msgs/msg/Odometry", "cd5e73d190d741a2f92e81eda573aca7"),
        ("sensor_msgs/msg/PointCloud2", "1158d486dd51d683ce2f1be655c3c181"),
        ("tf2_msgs/msg/TFMessage", "94810edda583a504dfda3829e70d7eec"),
        ("sensor_msgs/msg/Range", "c005c34273dc426c67a020a87bc24148"),
        ("diagnostic_msgs/msg/DiagnosticArray", "60810da900de1dd6ddd437c3503511da"),
    ],
)
def test_ros1_knows_the_types_by_their_sums(type_name: str, md5: str) -> None:
    text, found = ros1_definition(type_name)
    assert found == md5
    assert "builtin_interfaces" not in text


def test_ros2_knows_the_types_by_their_hashes() -> None:
    """As the JSON files beside std_msgs have them (REP 2016)."""
    assert type_hash("std_msgs/msg/String") == "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert type_hash("std_msgs/msg/Bool") == "RIHS01_feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9"


def test_every_topic_has_a_type_of_both() -> None:
    for topic in OUTPUTS.values():
        assert type_hash(topic.type).startswith("RIHS01_")
        assert len(ros1_definition(topic.type)[1]) == 32
        assert ros2_definition(topic.type)


@pytest.mark.parametrize("schema", sorted({t.schema for t in TOPICS.values() if t.schema.startswith("xitl_msgs/")}))
def test_types_of_ours_have_a_definition_for_both(schema: str) -> None:
    assert ros2_definition(schema).startswith("builtin_interfaces/Time stamp\n")
    assert ros1_definition(schema)[0].startswith("time stamp\n")


def test_a_recorded_payload_is_read_as_it_was_written() -> None:
    topic = TOPICS["/environment"]
    payload = topic.message_type().encode(1_500_000_000, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], 0.5)
    message = deserialize(payload, topic.schema)
    assert (message.stamp.sec, message.stamp.nanosec) == (1, 500_000_000)
    assert message.wind_ned_mps.tolist() == [4.0, 5.0, 6.0]
    assert serialize(message) == payload


def test_what_ros1_lacks_is_left_out_and_is_zero_on_the_way_back() -> None:
    """sensor_msgs/Range has a variance in ROS 2 alone; headers of ROS 1 begin with a number."""
    message = Range(Header(Time(1, 2), "a"), 0, 0.1, 0.3, 50.0, 12.5, 0.25)
    ros1 = to_ros1(serialize(message), message.__msgtype__)
    assert ros1[:4] == bytes(4)
    assert len(ros1) == 4 + 8 + 4 + 1 + 1 + 4 * 4
    back = deserialize(from_ros1(ros1, message.__msgtype__), message.__msgtype__)
    assert (back.range, back.variance) == (12.5, 0.0)


@pytest.mark.medium
def test_further_types_stay_with_who_brought_them() -> None:
    first = MessageTypes({"xitl_export/msg/ATT": "float64 roll\n"})
    second = MessageTypes({"xitl_export/msg/ATT": "float32 yaw\n"})
    assert first.ros2.hash_rihs01("xitl_export/msg/ATT") != second.ros2.hash_rihs01("xitl_export/msg/ATT")
    assert "xitl_export/msg/ATT" not in MessageTypes().ros2.types
