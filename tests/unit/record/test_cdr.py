"""CDR payloads read back by a decoder that nobody here wrote (mcap-ros2-support)."""

from __future__ import annotations

from mcap_ros2._dynamic import generate_dynamic

from xitl_cli.record import schemas
from xitl_cli.record.cdr import Layout


def decode(name: str, definition: str, payload: bytes):
    return generate_dynamic(name, definition)[name](payload)


def test_numbers_strings_and_sequences_land_on_their_alignment() -> None:
    definition = (
        "builtin_interfaces/Time stamp\nuint8 flag\nstring name\nfloat64 x\nuint32 n\nfloat64[] many\nfloat32[2] pair\n"
        "string tail\nint64 big\n" + "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    layout = Layout("u8", ("string", "odd"), "f64", "u32", ("f64[]", 3), ("f32", 2), ("string", "a longer one"), "i64")
    message = decode("t/msg/T", definition, layout.pack(3_000_000_007, 9, 1.5, 77, 1.0, 2.0, 3.0, 0.25, -4.0, -(2**60)))
    assert (message.stamp.sec, message.stamp.nanosec) == (3, 7)
    assert (message.flag, message.name, message.x, message.n) == (9, "odd", 1.5, 77)
    assert list(message.many) == [1.0, 2.0, 3.0]
    assert list(message.pair) == [0.25, -4.0]
    assert (message.tail, message.big) == ("a longer one", -(2**60))


def test_an_empty_sequence_leaves_the_next_field_in_place() -> None:
    definition = (
        "builtin_interfaces/Time stamp\nfloat64[] many\nuint8 a\nuint8 b\nfloat64 x\n"
        + "=" * 80
        + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    message = decode("t/msg/T", definition, Layout(("f64[]", 0), "u8", "u8", "f64").pack(0, 1, 2, 0.5))
    assert (list(message.many), message.a, message.b, message.x) == ([], 1, 2, 0.5)


def test_odometry_is_the_standard_message() -> None:
    values = [float(number) for number in range(7 + 36 + 6 + 36)]
    layout = Layout(("string", "map"), ("string", "base_link"), ("f64", 7), ("f64", 36), ("f64", 6), ("f64", 36))
    message = decode("nav_msgs/msg/Odometry", schemas.ODOMETRY, layout.pack(1, *values))
    assert (message.header.frame_id, message.child_frame_id) == ("map", "base_link")
    assert message.pose.pose.position.z == 2.0
    assert message.pose.pose.orientation.w == 6.0
    assert message.twist.twist.angular.z == 48.0
    assert list(message.twist.covariance) == values[-36:]
