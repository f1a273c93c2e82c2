"""Range of ROS 2's node discovery, and nodes that may command: `ros.discovery` and `ros.commanders`."""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import Callable, Sequence
from time import monotonic
from typing import Any, Literal, get_args

from xitl_cli.errors import UserError
from xitl_cli.profile.schema.ros import RosSpec

LOCAL_VARIABLE, RANGE_VARIABLE = "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE"
DiscoveryRange = Literal["LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT"]
"""Ranges by their names in ROS 2."""
UNKNOWN_S = 1.0
"""Longest wait of a message for the name of its sending node."""
MOST_WAITING = 256
"""Largest number of waiting messages."""
MOST_PARTICIPANTS, MOST_WRITERS = 512, 1024
"""Largest number of participants with known names, and of writers of a participant."""
PREFIX_BYTES, GUID_BYTES = 12, 16


def discovery_range(spec: RosSpec) -> DiscoveryRange:
    """Return `ros.discovery`, else the environment's value, else LOCALHOST. Raises UserError for a wrong one."""
    if spec.discovery is not None:
        return "LOCALHOST" if spec.discovery == "localhost" else "SUBNET"
    if os.environ.get(LOCAL_VARIABLE) == "1":
        return "LOCALHOST"
    value = os.environ.get(RANGE_VARIABLE) or "LOCALHOST"
    for known in get_args(DiscoveryRange):
        if value == known:
            return known  # type: ignore[no-any-return]
    raise UserError(f"{RANGE_VARIABLE}={value} is not known; use {', '.join(get_args(DiscoveryRange))}")


def stays_on_machine(spec: RosSpec) -> bool:
    """Return True if nodes of other machines are excluded."""
    return discovery_range(spec) in ("LOCALHOST", "OFF")


class Commanders:
    """Accepts or refuses messages according to `ros.commanders`. A node without a known name is refused."""

    def __init__(self, names: Sequence[str] | None) -> None:
        self._names = None if names is None else frozenset(names)
        self.refused: Counter[str] = Counter()
        """Number of messages and peers by topic."""
        self._problems: list[str] = []

    @property
    def everyone(self) -> bool:
        """True if every node may command."""
        return self._names is None

    def listed(self, node: str | None) -> bool:
        """Return True if the node may command; `node` is its full name, such as /helm."""
        return self._names is None or node in self._names

    def admit(self, topic: str, node: str | None) -> bool:
        """Check a message of the topic in the same way; count a refusal, and report the first of each topic."""
        if self.listed(node):
            return True
        if topic not in self.refused:
            who = node or "a node without a name"
            self._problems.append(f"ros: {topic}: {who} may not command; list its name in ros.commanders to allow it")
        self.refused[topic] += 1
        return False

    def problems(self) -> list[str]:
        """Return new sentences since the last call."""
        problems, self._problems = self._problems, []
        return problems


class WriterNames:
    """Nodes by the GUIDs of their writers, from the participants' announcements on `ros_discovery_info`."""

    def __init__(self) -> None:
        self._nodes: dict[bytes, dict[bytes, str]] = {}

    def update(self, sender: bytes, message: Any) -> None:
        """Process a rmw_dds_common/ParticipantEntitiesInfo. A participant may describe only itself.

        sender: GUID of the writer that sent it.
        """
        prefix = sender[:PREFIX_BYTES]
        if bytes(message.gid.data[:PREFIX_BYTES]) != prefix:
            return
        names = {
            bytes(gid.data[:GUID_BYTES]): full_node_name(node.node_namespace, node.node_name)
            for node in message.node_entities_info_seq
            for gid in node.writer_gid_seq[:MOST_WRITERS]
            if bytes(gid.data[:PREFIX_BYTES]) == prefix
        }
        self._nodes.pop(prefix, None)
        self._nodes[prefix] = names
        if len(self._nodes) > MOST_PARTICIPANTS:
            del self._nodes[next(iter(self._nodes))]

    def node_of(self, writer: bytes) -> str | None:
        """Return the full name of the node with this writer; None while it is unknown."""
        return self._nodes.get(writer[:PREFIX_BYTES], {}).get(writer[:GUID_BYTES])


class SenderCheck:
    """Passes a message on once the name of its sender is known, and refuses it if that node may not command.

    node_of: returns the full name of the node with a writer. A message is refused if its sender is unknown for
    UNKNOWN_S.
    """

    def __init__(
        self,
        commanders: Commanders,
        node_of: Callable[[bytes], str | None],
        now_s: Callable[[], float] = monotonic,
    ) -> None:
        self._commanders, self._node_of, self._now_s = commanders, node_of, now_s
        self._waiting: deque[tuple[float, str, bytes, Callable[[], object]]] = deque()

    def check(self, topic: str, writer: bytes, pass_on: Callable[[], object]) -> None:
        """Pass the message on, refuse it, or let it wait for its sender's name."""
        if self._commanders.everyone:
            pass_on()
            return
        known = self._node_of(writer) is not None
        if known or len(self._waiting) >= MOST_WAITING:
            self._decide(topic, writer, pass_on)
        else:
            self._waiting.append((self._now_s() + UNKNOWN_S, topic, writer, pass_on))

    def flush(self) -> None:
        """Decide about messages with a sender that is now known, or has been unknown for too long."""
        waiting, self._waiting = self._waiting, deque()
        for until_s, topic, writer, pass_on in waiting:
            if self._node_of(writer) is None and self._now_s() < until_s:
                self._waiting.append((until_s, topic, writer, pass_on))
            else:
                self._decide(topic, writer, pass_on)

    def _decide(self, topic: str, writer: bytes, pass_on: Callable[[], object]) -> None:
        if self._commanders.admit(topic, self._node_of(writer)):
            pass_on()


def full_node_name(namespace: str, name: str) -> str:
    """Return `/boats/helm` for `/boats` and `helm`."""
    return f"{namespace.rstrip('/')}/{name}"
