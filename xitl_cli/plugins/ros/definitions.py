"""Message types of ROS and xitl: bytes to objects and back, definitions and hashes.

Messages are ROS 2's CDR, little-endian, with its four bytes of encapsulation. ROS types are rosbags' tables of Jazzy.
For all types used here, they equal those of Humble and Kilted, except sensor_msgs/Range, which has a `variance` more
than in Humble. The types of xitl, xitl_msgs, come from the topics of a recording.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from functools import cache, partial
from hashlib import md5
from typing import TYPE_CHECKING, Any

from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from xitl_cli.record.topics import TOPICS

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_OURS = "xitl_msgs/"
_ONLY_ROS2 = ("tf2_msgs/msg/TFMessage",)
"""Types of ROS 1 that are missing in rosbags' table."""
MARINE = {
    "marine_sensor_msgs/msg/RadarEcho": "float32[] echoes\n",
    "marine_sensor_msgs/msg/RadarSector": (
        "std_msgs/Header header\nfloat32 angle_start\nfloat32 angle_increment\n"
        "builtin_interfaces/Duration time_increment\nbuiltin_interfaces/Duration scan_time\n"
        "float32 range_min\nfloat32 range_max\nmarine_sensor_msgs/RadarEcho[] intensities\n"
    ),
}
"""Fields of marine_msgs (github.com/apl-ocean-engineering/marine_msgs), which rosbags' tables do not contain."""
SERVICES = {
    "std_srvs/srv/Empty": ("", ""),
    "std_srvs/srv/SetBool": ("bool data\n", "bool success\nstring message\n"),
    "std_srvs/srv/Trigger": ("", "bool success\nstring message\n"),
}
"""Fields of request and response of the services in every ROS; rosbags' tables contain only messages."""


class MessageTypes:
    """Types of ROS 2 Jazzy, ROS 1 Noetic, xitl, and `further` by their names, as ros2msg texts.

    Raises rosbags' TypesysError for a type with the name of a ROS type and a different definition.
    """

    def __init__(self, further: Mapping[str, str] | None = None) -> None:
        self.ros2: Typestore = get_typestore(Stores.ROS2_JAZZY)
        self.ros1: Typestore = get_typestore(Stores.ROS1_NOETIC)
        for name in _ONLY_ROS2:
            self.ros1.register({name: self.ros2.fielddefs[name]})
        for name, text in {**own_definitions(), **MARINE, **(further or {})}.items():
            types = get_types_from_msg(text, name)
            self.ros2.register(types)
            self.ros1.register({name: fields for name, fields in types.items() if name not in self.ros1.fielddefs})
        self.ros2.register(_service_types("uint8 structure_needs_at_least_one_member\n"))
        self.ros1.register(_service_types(""))
        self._converters: dict[tuple[str, bool], Callable[[bytes], bytes | memoryview]] = {}

    def serialize(self, message: Any) -> bytes:
        """Return the CDR of a message of `ros2`."""
        return bytes(self.ros2.serialize_cdr(message, message.__msgtype__, little_endian=True))

    def deserialize(self, cdr: bytes, type_name: str) -> Any:
        """Return the message in a CDR payload. Raises rosbags' SerdeError for another type."""
        return self.ros2.deserialize_cdr(cdr, type_name)

    def to_ros1(self, cdr: bytes, type_name: str) -> bytes:
        """Convert a CDR payload to ROS 1: `seq` of headers is 0, and fields that ROS 1's type lacks are omitted.

        Raises rosbags' SerdeError for another type.
        """
        return self._converted(cdr, type_name, True)

    def from_ros1(self, data: bytes, type_name: str) -> bytes:
        """Convert a ROS 1 message to CDR. Raises rosbags' SerdeError for another type."""
        return self._converted(data, type_name, False)

    def _converted(self, data: bytes, type_name: str, to_ros1: bool) -> bytes:
        key = type_name, to_ros1
        if key not in self._converters:
            self._converters[key] = self._converter(type_name, to_ros1)
        try:
            return bytes(self._converters[key](data))
        except (ValueError, IndexError, AssertionError, struct.error) as error:  # for a message that ends too early
            raise SerdeError(f"Could not convert {type_name!r}: {error}") from error

    def _converter(self, type_name: str, to_ros1: bool) -> Callable[[bytes], bytes | memoryview]:
        source, target = (self.ros2, self.ros1) if to_ros1 else (self.ros1, self.ros2)
        if is_same_wireformat(source, target, type_name, type_name):
            return partial(self.ros2.cdr_to_ros1 if to_ros1 else self.ros2.ros1_to_cdr, typename=type_name)
        return lambda data: migrate_bytes(
            source, target, type_name, type_name, {}, data, src_is2=to_ros1, dst_is2=not to_ros1
        )


def _service_types(of_none: str) -> dict[str, Any]:
    """Return requests and responses as messages: `std_srvs/srv/Trigger_Response`. of_none: the text of one without
    fields.
    """
    return {
        f"{name}_{part}": next(iter(get_types_from_msg(text or of_none, name).values()))
        for name, texts in SERVICES.items()
        for part, text in zip(("Request", "Response"), texts, strict=True)
    }


@cache
def service_md5(type_name: str) -> str:
    """Return the hash by which ROS 1 identifies services: the MD5 of both texts in canonical form. Raises KeyError."""
    request, response = (text.strip() for text in SERVICES[type_name])
    return md5((request + response).encode(), usedforsecurity=False).hexdigest()


@cache
def own_definitions() -> dict[str, str]:
    """Return the fields of each xitl message, by its type."""
    return {
        topic.schema: topic.message_type().definition.partition("=" * 80)[0]
        for topic in TOPICS.values()
        if topic.schema.startswith(_OURS)
    }


@cache
def known_types() -> MessageTypes:
    """Return the types of ROS and xitl."""
    return MessageTypes()


def ros2_types() -> Typestore:
    """Return the types of ROS 2 and xitl."""
    return known_types().ros2


def serialize(message: Any) -> bytes:
    """See MessageTypes.serialize."""
    return known_types().serialize(message)


def deserialize(cdr: bytes, type_name: str) -> Any:
    """See MessageTypes.deserialize."""
    return known_types().deserialize(cdr, type_name)


def to_ros1(cdr: bytes, type_name: str) -> bytes:
    """See MessageTypes.to_ros1."""
    return known_types().to_ros1(cdr, type_name)


def from_ros1(data: bytes, type_name: str) -> bytes:
    """See MessageTypes.from_ros1."""
    return known_types().from_ros1(data, type_name)


@cache
def ros2_definition(type_name: str) -> str:
    """Return the text with all nested types, in the format of MCAP and rosbag2 (ros2msg)."""
    return known_types().ros2.generate_msgdef(type_name, ros_version=2)[0]


@cache
def type_hash(type_name: str) -> str:
    """Return the RIHS01_… hash of ROS 2 (REP 2016)."""
    return known_types().ros2.hash_rihs01(type_name)


@cache
def ros1_definition(type_name: str) -> tuple[str, str]:
    """Return the text with all nested types, and its MD5, as ROS 1 exchanges them."""
    return known_types().ros1.generate_msgdef(type_name, ros_version=1)
