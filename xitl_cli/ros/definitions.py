"""Message types of ROS and ours: bytes to objects and back, definitions and hashes.

The currency is ROS 2's CDR, little-endian, with its four bytes of encapsulation. Types of ROS are rosbags' tables of
Jazzy, which are the same in Humble and Kilted for all that is used here but sensor_msgs/Range (a `variance` more than
in Humble); ours, xitl_msgs, come from the topics of a recording.
"""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING, Any

from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from xitl_cli.record.topics import TOPICS

if TYPE_CHECKING:
    from collections.abc import Callable

    from rosbags.typesys.store import Typestore

_OURS = "xitl_msgs/"
_ONLY_ROS2 = ("tf2_msgs/msg/TFMessage",)
"""Types that ROS 1 has as well and rosbags' table of it lacks."""


@cache
def ros2_types() -> Typestore:
    """Of ROS 2 Jazzy, and ours."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in own_definitions().items():
        store.register(get_types_from_msg(text, name))
    return store


@cache
def ros1_types() -> Typestore:
    """Of ROS 1 Noetic, and ours."""
    store = get_typestore(Stores.ROS1_NOETIC)
    for name in _ONLY_ROS2:
        store.register({name: ros2_types().fielddefs[name]})
    for name, text in own_definitions().items():
        store.register(get_types_from_msg(text, name))
    return store


@cache
def own_definitions() -> dict[str, str]:
    """The fields of each message of ours, by its type."""
    return {
        topic.schema: topic.message_type().definition.partition("=" * 80)[0]
        for topic in TOPICS.values()
        if topic.schema.startswith(_OURS)
    }


def serialize(message: Any) -> bytes:
    """CDR of a message of `ros2_types`."""
    return bytes(ros2_types().serialize_cdr(message, message.__msgtype__, little_endian=True))


def deserialize(cdr: bytes, type_name: str) -> Any:
    """The message in a CDR payload. Raises rosbags' SerdeError where it is none of this type."""
    return ros2_types().deserialize_cdr(cdr, type_name)


@cache
def ros2_definition(type_name: str) -> str:
    """Text with all that is nested in it, as MCAP and rosbag2 keep it (ros2msg)."""
    return ros2_types().generate_msgdef(type_name, ros_version=2)[0]


@cache
def type_hash(type_name: str) -> str:
    """RIHS01_… of ROS 2 (REP 2016)."""
    return ros2_types().hash_rihs01(type_name)


@cache
def ros1_definition(type_name: str) -> tuple[str, str]:
    """Text with all that is nested in it, and its MD5, as ROS 1 exchanges them."""
    return ros1_types().generate_msgdef(type_name, ros_version=1)


def to_ros1(cdr: bytes, type_name: str) -> bytes:
    """A CDR payload as ROS 1 has it: `seq` of headers is 0, and what ROS 1's type lacks is left out."""
    return bytes(_converter(type_name, True)(cdr))


def from_ros1(data: bytes, type_name: str) -> bytes:
    """A message of ROS 1 as CDR. Raises rosbags' SerdeError where it is none of this type."""
    return bytes(_converter(type_name, False)(data))


@cache
def _converter(type_name: str, to_ros1: bool) -> Callable[[bytes], bytes | memoryview]:
    stores = ros2_types(), ros1_types()
    source, target = stores if to_ros1 else stores[::-1]
    if not is_same_wireformat(source, target, type_name, type_name):
        return lambda data: migrate_bytes(
            source, target, type_name, type_name, {}, data, src_is2=to_ros1, dst_is2=not to_ros1
        )
    return partial(source.cdr_to_ros1 if to_ros1 else source.ros1_to_cdr, typename=type_name)
