"""What carries messages to nodes and theirs to us, behind one interface: rclpy, Cyclone DDS, or ROS 1.

CDR bytes with their 4-byte header are the currency; types are named as in `sensor_msgs/msg/Imu`, names are whole, as
`/boats/one/imu/data`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

from xitl_cli.plugins.ros.outputs import QosKind
from xitl_cli.profile.schema.ros import RosTopicSpec

NODE_NAME = "xitl"
LOOK_S = 1.0
"""How often it is seen whether others publish the same."""


@dataclass(frozen=True, slots=True)
class QosProfile:
    """What a publisher offers or a subscriber asks for. depth: messages kept for a reader that is behind."""

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = 100


RELIABLE = QosProfile()
LATCHED = QosProfile(durability="transient_local", depth=1)
QOS: dict[QosKind, QosProfile] = {"sensor": replace(RELIABLE, depth=0), "latched": LATCHED, "clock": RELIABLE}
"""By their names in the table of topics; depth 0: the profile's."""
COMMANDS = QosProfile(reliability="best_effort", depth=1000)
"""Of a subscriber: best effort takes from every publisher; a flood of ten thousand a second is still counted."""


def qos_with(usual: QosProfile, asked: RosTopicSpec) -> QosProfile:
    """That of a topic as the profile has it."""
    given = {key: getattr(asked, key) for key in ("reliability", "durability", "depth")}
    return replace(usual, **{key: value for key, value in given.items() if value is not None})


def mismatch_text(topic: str, policy: str, ours: QosProfile, offers: bool) -> str:
    """Why nothing goes between a topic of ours and another node, and what to do. offers: we publish it."""
    if policy not in _WEAKER:
        return f"ros: {topic}: {policy} of another node does not match ours ({ours}); see `ros2 topic info -v {topic}`"
    weak, strong = _WEAKER[policy]
    if offers:
        fix = f"subscribe with {weak}, or give the topic {policy}: {strong} in ros.topics"
        return f"ros: {topic}: a node asks for {policy} {strong} and is offered {weak}, so that it gets nothing; {fix}"
    return f"ros: {topic}: a node publishes with {policy} {weak}, so that nothing of it arrives; publish with {strong}"


_WEAKER = {"reliability": ("best_effort", "reliable"), "durability": ("volatile", "transient_local")}


def others_text(topics: Sequence[str], domain: str) -> str:
    """What is said where somebody else publishes what we do."""
    shown = ", ".join(topics[:3]) + (f" and {len(topics) - 3} more" if len(topics) > 3 else "")
    fix = "use another ros.domain" if domain else "use another master"
    if not any(topic.startswith(_OF_ALL) for topic in topics):
        fix += ", or ros.namespace"
    where = domain or "at this master"
    return f"ros: another node publishes {shown} {where}, so that its readers get both; {fix}"


def type_text(topic: str, ours: str, theirs: str) -> str:
    """What is said where another node has a topic of ours with another type."""
    return f"ros: {topic}: another node has it as {theirs}, so that nothing goes between the two; use {ours}"


_OF_ALL = ("/clock", "/tf")


@dataclass(frozen=True, slots=True)
class MiddlewareLosses:
    """By topic. dropped: messages that a reader, or we, did not take in time. refused: messages and peers that are not
    what they should be."""

    dropped: Mapping[str, int] = field(default_factory=dict)
    refused: Mapping[str, int] = field(default_factory=dict)


class Middleware(Protocol):
    """A node of ROS. Handlers are called within `spin`; publishers may be called from any thread."""

    name: str
    """What it is, for people: `cyclonedds 11.0.1, domain 0`."""

    def advertise(self, topic: str, type_name: str, qos: QosProfile) -> Callable[[bytes], None]:
        """A publisher of CDR bytes."""

    def subscribe(self, topic: str, type_name: str, qos: QosProfile, take: Callable[[bytes], None]) -> None:
        """Have `take` called with the CDR bytes of each message."""

    def serve(self, service: str, type_name: str, answer: Callable[[bytes], bytes]) -> None:
        """Have `answer` called with the CDR bytes of a request; it returns those of the response."""

    def spin(self, timeout_s: float) -> None:
        """Call handlers of what has come, after at most `timeout_s`."""

    def problems(self) -> list[str]:
        """What has gone wrong since the last call, in sentences that say what to do."""

    def losses(self) -> MiddlewareLosses:
        """What the middleware itself has dropped and refused until now; what DDS drops it keeps to itself."""

    def close(self) -> None:
        """Leave the graph. A second call does nothing."""
