"""ROS 2 by rclpy, if one is sourced: with the middleware, the types and the configuration of that ROS."""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
import rclpy.context
import rclpy.executors
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind
from rclpy.serialization import deserialize_message, serialize_message

from xitl_cli.errors import UserError
from xitl_cli.plugins.ros.discovery import (
    GUID_BYTES,
    LOCAL_VARIABLE,
    RANGE_VARIABLE,
    Commanders,
    discovery_range,
    full_node_name,
)
from xitl_cli.plugins.ros.middleware import (
    CHECK_S,
    NODE_NAME,
    MiddlewareLosses,
    QosProfile,
    mismatch_text,
    others_text,
    type_text,
)
from xitl_cli.profile.schema.ros import RosSpec


class RclpyMiddleware:
    """A node in a separate context: see Middleware."""

    def __init__(self, spec: RosSpec, node_name: str = NODE_NAME) -> None:
        reach = discovery_range(spec)
        os.environ.pop(LOCAL_VARIABLE, None)  # deprecated, with priority over the other
        os.environ[RANGE_VARIABLE] = reach  # rclpy reads it
        self._commanders = Commanders(spec.commanders)
        self._context = rclpy.context.Context()
        rclpy.init(args=[], context=self._context, domain_id=spec.domain)
        self._node = rclpy.create_node(node_name, context=self._context, start_parameter_services=False)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._problems: list[str] = []
        self._published: list[str] = []
        self._types: dict[str, str] = {}
        self._shared: set[str] = set()
        self._next_check_s = 0.0
        self._reported: set[tuple[str, str]] = set()
        implementation = rclpy.get_rmw_implementation_identifier()
        distribution = os.environ.get("ROS_DISTRO", "")
        self.name = f"rclpy {distribution} ({implementation}), domain {self._context.get_domain_id()}, {reach}"
        self.name = self.name.replace("  ", " ")

    def advertise(self, topic: str, type_name: str, qos: QosProfile) -> Callable[[bytes], None]:
        """See Middleware."""
        kind = self._type_of(topic, type_name)
        if kind is None:
            return lambda cdr: None
        events = PublisherEventCallbacks(incompatible_qos=self._mismatch(topic, qos, True), use_default_callbacks=False)
        self._published.append(topic)
        self._types[topic] = type_name
        publisher = self._node.create_publisher(kind, topic, _qos(qos), event_callbacks=events)
        publish: Callable[[bytes], None] = publisher.publish
        return publish

    def subscribe(self, topic: str, type_name: str, qos: QosProfile, handle: Callable[[bytes], None]) -> None:
        """See Middleware."""
        kind = self._type_of(topic, type_name)
        if kind is None:
            return
        events = SubscriptionEventCallbacks(
            incompatible_qos=self._mismatch(topic, qos, False), use_default_callbacks=False
        )
        self._types[topic] = type_name

        def handle_checked(cdr: bytes, about: Mapping[str, Any]) -> None:
            if self._commanders.admit(topic, self._sender(topic, about)):
                handle(cdr)

        callback = handle if self._commanders.everyone else handle_checked
        self._node.create_subscription(kind, topic, callback, _qos(qos), event_callbacks=events, raw=True)

    def serve(self, service: str, type_name: str, answer: Callable[[bytes], bytes]) -> None:
        """See Middleware."""
        kind = self._type_of(service, type_name)
        if kind is None:
            return

        def serve(request: Any, response: Any) -> Any:
            if not self._commanders.everyone:
                requests = f"rq{self._node.resolve_service_name(service)}Request"
                if not self._commanders.admit(service, self._unlisted(requests, no_mangle=True)):
                    return response  # default response: without success
            return deserialize_message(answer(serialize_message(request)), kind.Response)

        self._node.create_service(kind, service, serve)

    def spin(self, timeout_s: float) -> None:
        """See Middleware."""
        self._executor.spin_once(timeout_sec=timeout_s)

    def losses(self) -> MiddlewareLosses:
        """See Middleware."""
        return MiddlewareLosses(refused=dict(self._commanders.refused))

    def problems(self) -> list[str]:
        """See Middleware."""
        problems, self._problems = self._problems, []
        problems += self._commanders.problems()
        now_s = time.monotonic()
        if now_s >= self._next_check_s:
            self._next_check_s = now_s + CHECK_S
            # Topics that other nodes publish too
            unshared = [topic for topic in self._published if topic not in self._shared]
            others = [topic for topic in unshared if self._node.count_publishers(topic) > 1]
            self._shared.update(others)
            if others:
                problems.append(others_text(others, f"in domain {self._context.get_domain_id()}"))
            # Topics that other nodes use with another type
            for topic, kinds in self._node.get_topic_names_and_types():
                if topic not in self._types:
                    continue
                ours = self._types[topic]
                for theirs in kinds:
                    if theirs != ours and (topic, theirs) not in self._reported:
                        self._reported.add((topic, theirs))
                        problems.append(type_text(topic, ours, theirs))
        return problems

    def _sender(self, topic: str, about: Mapping[str, Any]) -> str | None:
        """Return the full name of the node that sent a message. Since Kilted, rclpy reports its GID.

        For older versions, return any publisher that may not command, if there is one: then no message of the topic
        counts.
        """
        gid = about.get("publisher_gid")
        if gid is None:
            return self._unlisted(topic)
        sender = bytes(gid["data"])[:GUID_BYTES]
        for endpoint in self._node.get_publishers_info_by_topic(topic):
            if bytes(endpoint.endpoint_gid)[:GUID_BYTES] == sender:
                return full_node_name(endpoint.node_namespace, endpoint.node_name)
        return None

    def _unlisted(self, topic: str, no_mangle: bool = False) -> str | None:
        """Return a publisher without permission to command, else any other publisher, else None."""
        endpoints = self._node.get_publishers_info_by_topic(topic, no_mangle)
        names = [full_node_name(endpoint.node_namespace, endpoint.node_name) for endpoint in endpoints]
        return min(names, key=self._commanders.listed, default=None)

    def _type_of(self, name: str, type_name: str) -> Any:
        """Return the class; None with a warning if this ROS lacks it: the run continues without the topic."""
        try:
            return message_type(type_name)
        except UserError as error:
            self._problems.append(f"ros: {name} is omitted: {error}")
            return None

    def close(self) -> None:
        """See Middleware."""
        if self._context.ok():
            self._executor.shutdown()
            self._node.destroy_node()
            rclpy.shutdown(context=self._context)

    def _mismatch(self, topic: str, qos: QosProfile, offers: bool) -> Callable[[Any], None]:
        def note(event: Any) -> None:
            policy = qos_policy_name_from_kind(event.last_policy_kind).lower()
            if (topic, policy) not in self._reported:
                self._reported.add((topic, policy))
                self._problems.append(mismatch_text(topic, policy, qos, offers))

        return note


def message_type(type_name: str) -> Any:
    """Return the class of a message or service. Raises UserError if its package is missing."""
    package, kind, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError) as error:
        raise UserError(f"the sourced ROS has no type {type_name}; install its package {package}") from error


def _qos(qos: QosProfile) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy[qos.reliability.upper()],
        durability=DurabilityPolicy[qos.durability.upper()],
    )
