"""The way into ROS 2 by rclpy, at an rclpy that the test plays."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from enum import Enum
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from xitl_cli.plugins.ros.discovery import LOCAL_VARIABLE, RANGE_VARIABLE
from xitl_cli.plugins.ros.middleware import QosProfile
from xitl_cli.profile.schema.ros import RosSpec


class Policy(Enum):
    RELIABLE = 1
    BEST_EFFORT = 2
    VOLATILE = 3
    TRANSIENT_LOCAL = 4


class Events:
    def __init__(self, incompatible_qos: Callable[[Any], None], use_default_callbacks: bool) -> None:
        assert not use_default_callbacks
        self.incompatible_qos = incompatible_qos


class Context:
    def __init__(self) -> None:
        self.domain: int | None = None
        self.up = False

    def get_domain_id(self) -> int:
        return 0 if self.domain is None else self.domain

    def ok(self) -> bool:
        return self.up


class Node:
    """A node of rclpy: what it was asked for, and the other nodes."""

    def __init__(self) -> None:
        self.publishers: dict[str, Any] = {}
        self.subscriptions: dict[str, Any] = {}
        self.services: dict[str, Any] = {}
        self.sent: list[tuple[str, bytes]] = []
        self.counts: dict[str, int] = {}
        self.others: dict[str, list[Any]] = {}
        self.types: list[tuple[str, list[str]]] = []
        self.destroyed = 0

    def create_publisher(self, kind: Any, topic: str, qos: Any, event_callbacks: Events) -> Any:
        self.publishers[topic] = SimpleNamespace(kind=kind, qos=qos, events=event_callbacks)
        return SimpleNamespace(publish=lambda cdr: self.sent.append((topic, cdr)))

    def create_subscription(
        self, kind: Any, topic: str, callback: Any, qos: Any, event_callbacks: Events, raw: bool
    ) -> None:
        assert raw
        self.subscriptions[topic] = SimpleNamespace(kind=kind, call=callback, qos=qos, events=event_callbacks)

    def create_service(self, kind: Any, service: str, serve: Any) -> None:
        self.services[service] = SimpleNamespace(kind=kind, serve=serve)

    def resolve_service_name(self, service: str) -> str:
        return f"/{service.lstrip('/')}"

    def count_publishers(self, topic: str) -> int:
        return self.counts.get(topic, 1)

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return self.types

    def get_publishers_info_by_topic(self, topic: str, no_mangle: bool = False) -> list[Any]:
        assert no_mangle == topic.startswith("rq")
        return self.others.get(topic, [])

    def destroy_node(self) -> None:
        self.destroyed += 1


class Executor:
    def __init__(self, context: Context) -> None:
        self.nodes: list[Node] = []
        self.spins: list[float] = []
        self.ended = 0

    def add_node(self, node: Node) -> None:
        self.nodes.append(node)

    def spin_once(self, timeout_sec: float) -> None:
        self.spins.append(timeout_sec)

    def shutdown(self) -> None:
        self.ended += 1


class Imu: ...


class SetBool:
    class Response: ...


class Played:
    """The modules of an rclpy, and the middleware that uses them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.node = Node()
        self.contexts: list[Context] = []
        self.executors: list[Executor] = []
        self.shut: list[Context] = []

        def module(name: str, **values: Any) -> None:
            made = ModuleType(name)
            made.__dict__.update(values)
            monkeypatch.setitem(sys.modules, name, made)

        def make_context() -> Context:
            self.contexts.append(Context())
            return self.contexts[-1]

        def make_executor(context: Context) -> Executor:
            self.executors.append(Executor(context))
            return self.executors[-1]

        def init(args: list[str], context: Context, domain_id: int | None) -> None:
            assert args == []
            context.domain, context.up = domain_id, True

        def create_node(name: str, context: Context, start_parameter_services: bool) -> Node:
            assert (name, start_parameter_services) == ("xitl", False)
            return self.node

        def shutdown(context: Context) -> None:
            context.up = False
            self.shut.append(context)

        module("rclpy.context", Context=make_context)
        module("rclpy.executors", SingleThreadedExecutor=make_executor)
        module("rclpy.event_handler", PublisherEventCallbacks=Events, SubscriptionEventCallbacks=Events)
        module(
            "rclpy.qos",
            DurabilityPolicy=Policy,
            ReliabilityPolicy=Policy,
            HistoryPolicy=SimpleNamespace(KEEP_LAST="keep last"),
            QoSProfile=lambda **values: values,
            qos_policy_name_from_kind=lambda kind: kind,
        )
        module(
            "rclpy.serialization",
            serialize_message=lambda message: b"request:" + message,
            deserialize_message=lambda cdr, kind: (cdr, kind),
        )
        module(
            "rclpy",
            init=init,
            create_node=create_node,
            shutdown=shutdown,
            get_rmw_implementation_identifier=lambda: "rmw_fast",
            context=sys.modules["rclpy.context"],
            executors=sys.modules["rclpy.executors"],
        )
        module("sensor_msgs.msg", Imu=Imu)
        module("std_srvs.srv", SetBool=SetBool)
        monkeypatch.delitem(sys.modules, "xitl_cli.plugins.ros.rclpy_middleware", raising=False)
        self.module = importlib.import_module("xitl_cli.plugins.ros.rclpy_middleware")

    def open(self, **keys: Any) -> Any:
        return self.module.RclpyMiddleware(RosSpec(**keys))


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> Iterator[Played]:
    monkeypatch.setenv(LOCAL_VARIABLE, "0")
    monkeypatch.setenv(RANGE_VARIABLE, "SUBNET")
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    yield Played(monkeypatch)
    sys.modules.pop("xitl_cli.plugins.ros.rclpy_middleware", None)


def endpoint(namespace: str, name: str, gid: bytes = b"") -> Any:
    return SimpleNamespace(node_namespace=namespace, node_name=name, endpoint_gid=list(gid))


def test_the_node_is_in_the_domain_and_range_of_the_profile(played: Played, monkeypatch: pytest.MonkeyPatch) -> None:
    middleware = played.open(domain=7, discovery="localhost")
    assert middleware.name == "rclpy jazzy (rmw_fast), domain 7, LOCALHOST"
    assert played.module.os.environ[RANGE_VARIABLE] == "LOCALHOST"
    assert LOCAL_VARIABLE not in played.module.os.environ
    assert played.executors[0].nodes == [played.node]
    monkeypatch.delenv("ROS_DISTRO")
    assert played.open(discovery="subnet").name == "rclpy (rmw_fast), domain 0, SUBNET"


def test_messages_are_published_as_they_are_with_their_qos(played: Played) -> None:
    middleware = played.open()
    publish = middleware.advertise("/imu", "sensor_msgs/msg/Imu", QosProfile("best_effort", "transient_local", 9))
    publish(b"cdr")
    assert played.node.sent == [("/imu", b"cdr")]
    publisher = played.node.publishers["/imu"]
    assert publisher.kind is Imu
    assert publisher.qos == {
        "history": "keep last",
        "depth": 9,
        "reliability": Policy.BEST_EFFORT,
        "durability": Policy.TRANSIENT_LOCAL,
    }


def test_a_type_that_this_ros_lacks_is_told_and_the_topic_left_out(played: Played) -> None:
    middleware = played.open()
    middleware.advertise("/a", "no_msgs/msg/Thing", QosProfile())(b"cdr")
    middleware.subscribe("/b", "sensor_msgs/msg/Nothing", QosProfile(), print)
    middleware.serve("/c", "no_msgs/srv/Thing", lambda request: request)
    assert (played.node.sent, played.node.publishers, played.node.subscriptions, played.node.services) == (
        [],
        {},
        {},
        {},
    )
    lacks = "the sourced ROS has no type {}; install its package {}"
    assert middleware.problems() == [
        f"ros: /a is omitted: {lacks.format('no_msgs/msg/Thing', 'no_msgs')}",
        f"ros: /b is omitted: {lacks.format('sensor_msgs/msg/Nothing', 'sensor_msgs')}",
        f"ros: /c is omitted: {lacks.format('no_msgs/srv/Thing', 'no_msgs')}",
    ]
    assert middleware.problems() == []


def test_without_a_list_every_node_may_command(played: Played) -> None:
    middleware = played.open()
    came: list[bytes] = []
    middleware.subscribe("/cmd", "sensor_msgs/msg/Imu", QosProfile(), came.append)
    subscription = played.node.subscriptions["/cmd"]
    subscription.call(b"one")
    assert came == [b"one"]
    assert subscription.qos["reliability"] == Policy.RELIABLE
    middleware.serve("/arm", "std_srvs/srv/SetBool", lambda request: request + b"!")
    service = played.node.services["/arm"]
    assert service.kind is SetBool
    assert service.serve(b"on", object()) == (b"request:on!", SetBool.Response)


def test_only_listed_nodes_command_by_the_gid_of_their_publisher(played: Played) -> None:
    helm, other = b"\1" * 16, b"\2" * 16
    played.node.others["/cmd"] = [endpoint("/boats/", "helm", helm + b"\0" * 8), endpoint("/", "joystick", other)]
    middleware = played.open(commanders=("/boats/helm",))
    came: list[bytes] = []
    middleware.subscribe("/cmd", "sensor_msgs/msg/Imu", QosProfile(), came.append)
    call = played.node.subscriptions["/cmd"].call
    call(b"one", {"publisher_gid": {"data": helm}})
    call(b"two", {"publisher_gid": {"data": other + b"\7" * 8}})
    call(b"three", {"publisher_gid": {"data": b"\3" * 16}})
    assert came == [b"one"]
    assert dict(middleware.losses().refused) == {"/cmd": 2}
    assert middleware.problems() == [
        "ros: /cmd: /joystick may not command; list its name in ros.commanders to allow it"
    ]


def test_without_gids_one_unlisted_publisher_refuses_the_topic(played: Played) -> None:
    middleware = played.open(commanders=("/helm",))
    came: list[bytes] = []
    middleware.subscribe("/cmd", "sensor_msgs/msg/Imu", QosProfile(), came.append)
    call = played.node.subscriptions["/cmd"].call
    call(b"of nobody", {})
    played.node.others["/cmd"] = [endpoint("/", "helm")]
    call(b"of the helm", {})
    played.node.others["/cmd"] = [endpoint("/", "helm"), endpoint("/", "joystick")]
    call(b"of either", {})
    assert came == [b"of the helm"]
    assert dict(middleware.losses().refused) == {"/cmd": 2}


def test_a_service_answers_a_node_that_is_not_listed_with_the_default(played: Played) -> None:
    middleware = played.open(commanders=("/helm",))
    middleware.serve("/arm", "std_srvs/srv/SetBool", lambda request: request)
    serve, default = played.node.services["/arm"].serve, object()
    played.node.others["rq/armRequest"] = [endpoint("/", "joystick")]
    assert serve(b"on", default) is default
    played.node.others["rq/armRequest"] = [endpoint("/", "helm")]
    assert serve(b"on", default) == (b"request:on", SetBool.Response)
    assert dict(middleware.losses().refused) == {"/arm": 1}


def test_other_publishers_and_other_types_are_told_once(played: Played, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [50.0]
    monkeypatch.setattr(played.module.time, "monotonic", lambda: now_s[0])
    middleware = played.open(domain=3)
    for topic in ("/imu", "/fix"):
        middleware.advertise(topic, "sensor_msgs/msg/Imu", QosProfile())
    assert middleware.problems() == []
    played.node.counts = {"/imu": 2}
    played.node.types = [("/fix", ["sensor_msgs/msg/Imu", "other_msgs/msg/Fix"]), ("/their", ["a_msgs/msg/B"])]
    now_s[0] = 50.99
    assert middleware.problems() == [], "checked once a second"
    now_s[0] = 51.0
    shared, mistyped = middleware.problems()
    assert shared.startswith("ros: another node also publishes /imu in domain 3")
    assert mistyped.startswith("ros: /fix: another node uses the type other_msgs/msg/Fix")
    now_s[0] = 52.0
    assert middleware.problems() == []
    played.node.counts = {"/imu": 2, "/fix": 2}
    now_s[0] = 53.0
    (shared,) = middleware.problems()
    assert shared.startswith("ros: another node also publishes /fix in domain 3")


def test_a_policy_that_does_not_match_is_told_once_for_a_topic(played: Played) -> None:
    middleware = played.open()
    middleware.advertise("/imu", "sensor_msgs/msg/Imu", QosProfile("best_effort"))
    middleware.subscribe("/cmd", "sensor_msgs/msg/Imu", QosProfile(), print)
    for _ in range(2):
        played.node.publishers["/imu"].events.incompatible_qos(SimpleNamespace(last_policy_kind="RELIABILITY"))
        played.node.subscriptions["/cmd"].events.incompatible_qos(SimpleNamespace(last_policy_kind="DURABILITY"))
    offered, requested = middleware.problems()
    assert offered.startswith("ros: /imu: a node requests reliability reliable, but xitl offers best_effort")
    assert requested.startswith("ros: /cmd: a node publishes with durability volatile")


def test_it_spins_and_leaves_the_graph_once(played: Played) -> None:
    middleware = played.open()
    middleware.spin(0.05)
    (executor,) = played.executors
    assert executor.spins == [0.05]
    middleware.close()
    middleware.close()
    assert (executor.ended, played.node.destroyed, played.shut) == (1, 1, played.contexts)
