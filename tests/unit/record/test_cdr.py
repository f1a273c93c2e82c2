"""CDR payloads read back by a decoder that nobody here wrote (mcap-ros2-support)."""

from __future__ import annotations

import math
from typing import Annotated, Any

import pytest
from mcap_ros2._dynamic import generate_dynamic

from xitl_cli.record.cdr import Bool, Bytes, Float64, Float64Sequence, Int64, MessageType, String, Uint8, Uint32
from xitl_cli.record.topics import OdometryMessage


def decode(name: str, kind: MessageType, payload: bytes) -> Any:
    return generate_dynamic(name, kind.definition)[name](payload)


class Mixed:
    flag: Bool
    name: String
    x: Float64
    n: Uint32
    many: Annotated[Float64Sequence, "any number of them"]
    pair: Annotated[tuple[float, ...], "float32[2]"]
    tail: String
    big: Int64 | None


class Short:
    many: Float64Sequence
    a: Uint8
    b: Uint8
    x: Float64 | None


class Raw:
    data: Bytes
    x: Float64


@pytest.mark.parametrize(("name", "tail"), [("odd", "a longer one"), ("", "é"), ("exactly", "")])
def test_numbers_strings_and_sequences_land_on_their_alignment(name: str, tail: str) -> None:
    kind = MessageType(Mixed)
    for many in ([1.0, 2.0, 3.0], [], [4.0]):
        payload = kind.encode(3_000_000_007, True, name, 1.5, 77, many, (0.25, -4.0), tail, -(2**60))
        message = decode("t/msg/T", kind, payload)
        assert (message.stamp.sec, message.stamp.nanosec) == (3, 7)
        assert (message.flag, message.name, message.x, message.n) == (1, name, 1.5, 77)
        assert list(message.many) == many
        assert list(message.pair) == [0.25, -4.0]
        assert (message.tail, message.big) == (tail, -(2**60))


def test_the_definition_names_fields_in_order_behind_the_stamp() -> None:
    assert MessageType(Mixed).definition == (
        "builtin_interfaces/Time stamp\nuint8 flag\nstring name\nfloat64 x\nuint32 n\nfloat64[] many\nfloat32[2] pair\n"
        "string tail\nint64 big\n" + "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )


def test_an_empty_sequence_leaves_the_next_field_in_place() -> None:
    kind = MessageType(Short)
    message = decode("t/msg/T", kind, kind.encode(0, [], 1, 2, 0.5))
    assert (list(message.many), message.a, message.b, message.x) == ([], 1, 2, 0.5)


def test_what_is_not_known_is_nan_or_minus_one_and_an_empty_array_zero() -> None:
    kind = MessageType(Mixed)
    message = decode("t/msg/T", kind, kind.encode(0, False, "", 0.0, 0, [], (), "", None))
    assert (message.big, list(message.pair)) == (-1, [0.0, 0.0])
    short = MessageType(Short)
    assert math.isnan(decode("t/msg/T", short, short.encode(0, [], 1, 2, None)).x)


@pytest.mark.parametrize("data", [b"", b"\xfd", b"\xfd1234567"])
def test_bytes_alone_and_before_a_number(data: bytes) -> None:
    kind = MessageType(Raw)
    message = decode("t/msg/T", kind, kind.encode(5, data, 2.5))
    assert (bytes(message.data), message.x) == (data, 2.5)


def test_a_value_too_many_is_refused() -> None:
    kind = MessageType(Short)
    with pytest.raises(ValueError, match="zip"):
        kind.encode(0, [], 1, 2, 0.5, 3)


def test_odometry_is_the_standard_message() -> None:
    values = [float(number) for number in range(7 + 36 + 6 + 36)]
    parts = (values[:3], values[3:7], values[7:43], values[43:49], values[49:])
    kind = MessageType(OdometryMessage)
    message = decode("nav_msgs/msg/Odometry", kind, kind.encode(1, "map", "base_link", *parts))
    assert (message.header.frame_id, message.child_frame_id) == ("map", "base_link")
    assert message.pose.pose.position.z == 2.0
    assert message.pose.pose.orientation.w == 6.0
    assert message.twist.twist.angular.z == 48.0
    assert list(message.twist.covariance) == values[-36:]
