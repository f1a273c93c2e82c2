"""How far ROS 2 discovers nodes, and which of them may command: `ros.discovery` and `ros.commanders`."""

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
"""As ROS 2 names them."""
UNKNOWN_S = 1.0
"""How long a message waits for the name of the node that sent it."""
MOST_WAITING = 256
"""Messages that wait at once."""
MOST_PARTICIPANTS, MOST_WRITERS = 512, 1024
"""Whose names are known at once; writers of a participant."""
PREFIX_BYTES, GUID_BYTES = 12, 16


def discovery_range(spec: RosSpec) -> DiscoveryRange:
    """`ros.discovery`, else the environment, else LOCALHOST. Raises UserError for a variable with another value."""
    if spec.discovery is not None:
        return "LOCALHOST" if spec.discovery == "localhost" else "SUBNET"
    if os.environ.get(LOCAL_VARIABLE) == "1":
        return "LOCALHOST"
    given = os.environ.get(RANGE_VARIABLE) or "LOCALHOST"
    for known in get_args(DiscoveryRange):
        if given == known:
            return known  # type: ignore[no-any-return]
    raise UserError(f"{RANGE_VARIABLE}={given} is not known; use {', '.join(get_args(DiscoveryRange))}")


def stays_on_machine(spec: RosSpec) -> bool:
    """Whether nodes of other machines are left out."""
    return discovery_range(spec) in ("LOCALHOST", "OFF")


class Commanders:
    """Decides by `ros.commanders` whose messages count. A node without a known name does not.

    refused: messages and peers by topic.
    """

    def __init__(self, names: Sequence[str] | None) -> None:
        self._names = None if names is None else frozenset(names)
        self.refused: Counter[str] = Counter()
        self._problems: list[str] = []

    @property
    def everyone(self) -> bool:
        """Whether every node may command."""
        return self._names is None

    def listed(self, node: str | None) -> bool:
        """Whether the node may command; `node` is its full name, as /helm."""
        return self._names is None or node in self._names

    def admit(self, topic: str, node: str | None) -> bool:
        """The same for a message of the topic; counts a refusal, and reports the first of each topic."""
        if self.listed(node):
            return True
        if topic not in self.refused:
            who = node or "a node without a name"
            self._problems.append(f"ros: {topic}: {who} may not command; list its name in ros.commanders to allow it")
        self.refused[topic] += 1
        return False

    def problems(self) -> list[str]:
        """New sentences since the last call."""
        problems, self._problems = self._problems, []
        return problems


class WriterNames:
    """Nodes by the GUIDs of their writers, as participants announce them on `ros_discovery_info`."""

    def __init__(self) -> None:
        self._nodes: dict[bytes, dict[bytes, str]] = {}

    def update(self, sender: bytes, message: Any) -> None:
        """Take in a rmw_dds_common/ParticipantEntitiesInfo. A participant speaks for itself alone.

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
        """Full name of the node that has this writer; None while it is not known."""
        return self._nodes.get(writer[:PREFIX_BYTES], {}).get(writer[:GUID_BYTES])


class SenderCheck:
    """Passes a message on once the name of its sender is known, and refuses it where that node may not command.

    node_of: the full name of the node with a writer. A message whose sender stays unknown for UNKNOWN_S is refused.
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
        """Decide about messages whose sender is known by now, or has been unknown for too long."""
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
    """`/boats/helm` of `/boats` and `helm`."""
    return f"{namespace.rstrip('/')}/{name}"
