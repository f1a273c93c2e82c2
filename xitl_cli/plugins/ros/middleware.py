"""Transport of messages to and from nodes, behind one interface: rclpy, Cyclone DDS, or ROS 1.

Messages are CDR bytes with their 4-byte header. Types have the form `sensor_msgs/msg/Imu`, and names are complete, such
as `/boats/one/imu/data`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from typing import Literal, Protocol

from sim_core.dataclass import dataclass
from xitl_cli.plugins.ros.outputs import QosKind
from xitl_cli.profile.schema.ros import RosTopicSpec

NODE_NAME = "xitl"
CHECK_S = 1.0
"""Interval of the check for other publishers of the same topics."""


@dataclass(frozen=True, slots=True)
class QosProfile:
    """QoS that a publisher offers or a subscriber requests."""

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = 100
    """Messages kept for a slow reader."""


RELIABLE = QosProfile()
LATCHED = QosProfile(durability="transient_local", depth=1)
QOS: dict[QosKind, QosProfile] = {"sensor": replace(RELIABLE, depth=0), "latched": LATCHED, "clock": RELIABLE}
"""By their names in the table of topics; depth 0: the profile's."""
_WEAKER = {"reliability": ("best_effort", "reliable"), "durability": ("volatile", "transient_local")}
"""Weaker and stronger value of each policy."""
_OF_ALL = ("/clock", "/tf")
"""Topics that ros.namespace does not rename."""
COMMANDS = QosProfile(reliability="best_effort", depth=1000)
"""QoS of a subscriber. Best effort accepts every publisher; a flood of ten thousand a second is still counted."""


def qos_with(usual: QosProfile, asked: RosTopicSpec) -> QosProfile:
    """Return the QoS of a topic with the profile's changes."""
    changes = {key: getattr(asked, key) for key in ("reliability", "durability", "depth")}
    return replace(usual, **{key: value for key, value in changes.items() if value is not None})


def mismatch_text(topic: str, policy: str, ours: QosProfile, offers: bool) -> str:
    """Explain why a topic of xitl and another node do not match, and the fix. offers: xitl publishes it."""
    if policy not in _WEAKER:
        return f"ros: {topic}: {policy} of another node does not match {ours} here; see `ros2 topic info -v {topic}`"
    weak, strong = _WEAKER[policy]
    if offers:
        fix = f"subscribe with {weak}, or give the topic {policy}: {strong} in ros.topics"
        return f"ros: {topic}: a node requests {policy} {strong}, but xitl offers {weak}: it receives nothing; {fix}"
    return f"ros: {topic}: a node publishes with {policy} {weak}: its messages do not arrive; publish with {strong}"


def others_text(topics: Sequence[str], domain: str) -> str:
    """Return the warning about other publishers of the same topics."""
    shown = ", ".join(topics[:3]) + (f" and {len(topics) - 3} more" if len(topics) > 3 else "")
    fix = "use another ros.domain" if domain else "use another master"
    if not any(topic.startswith(_OF_ALL) for topic in topics):
        fix += ", or ros.namespace"
    where = domain or "at this master"
    return f"ros: another node also publishes {shown} {where}: subscribers receive both; {fix}"


def type_text(topic: str, ours: str, theirs: str) -> str:
    """Return the warning about another node that uses a topic of xitl with another type."""
    return f"ros: {topic}: another node uses the type {theirs}: the two exchange no messages; use {ours}"


@dataclass(frozen=True, slots=True)
class MiddlewareLosses:
    """Losses by topic."""

    dropped: Mapping[str, int] = field(default_factory=dict)
    """Messages that a reader, or xitl, did not read in time."""
    refused: Mapping[str, int] = field(default_factory=dict)
    """Invalid messages and peers."""


class Middleware(Protocol):
    """A ROS node. Handlers are called within `spin`; publishers may be called from any thread."""

    name: str
    """Description for the user: `cyclonedds 11.0.1, domain 0`."""

    def advertise(self, topic: str, type_name: str, qos: QosProfile) -> Callable[[bytes], None]:
        """Return a publisher of CDR bytes."""

    def subscribe(self, topic: str, type_name: str, qos: QosProfile, handle: Callable[[bytes], None]) -> None:
        """Call `handle` with the CDR bytes of each message."""

    def serve(self, service: str, type_name: str, answer: Callable[[bytes], bytes]) -> None:
        """Call `answer` with the CDR bytes of each request; it returns those of the response."""

    def spin(self, timeout_s: float) -> None:
        """Call the handlers of received messages, after at most `timeout_s`."""

    def problems(self) -> list[str]:
        """Return the problems since the last call, as sentences with a fix."""

    def losses(self) -> MiddlewareLosses:
        """Return the losses and refusals of the middleware so far. DDS does not report its drops."""

    def close(self) -> None:
        """Leave the graph. A second call does nothing."""
