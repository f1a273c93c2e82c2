"""ROS 2 without an installed ROS: Cyclone DDS with the names, types and QoS of ROS 2's middleware.

Cyclone DDS accepts and returns serialised bytes, so a topic needs no conversion here. `ros_discovery_info` makes a node
visible in `ros2 node list` (rmw_dds_common). A topic's user data makes the type hashes visible to tools (REP 2011, REP
2016).
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import replace
from functools import cache, partial
from importlib.metadata import version
from typing import Any

import numpy as np
from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import (
    DDSException,
    GuardCondition,
    InstanceState,
    Listener,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import DomainParticipantQos, Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError

from xitl_cli.errors import UserError
from xitl_cli.plugins.ros.definitions import deserialize, ros2_types, serialize, type_hash
from xitl_cli.plugins.ros.discovery import (
    RANGE_VARIABLE,
    Commanders,
    SenderCheck,
    WriterNames,
    discovery_range,
    stays_on_machine,
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
from xitl_cli.plugins.ros.rtps_services import RtpsServices, ServiceRequest
from xitl_cli.profile.schema.ros import RosSpec

CONFIGURATION = """<CycloneDDS><Domain>
<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>
<Internal><Watermarks><WhcHigh>64 MB</WhcHigh></Watermarks></Internal>
</Domain></CycloneDDS>"""
"""Vendor 1.15 is eProsima: Fast DDS 3 describes types in a way that Cyclone DDS does not accept, and no data arrives.

The watermark is the amount of data that a publisher keeps for readers without confirmation before it blocks for all of
them.
"""
LOCAL_CONFIGURATION = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="localhost"/></Peers></Discovery>
</Domain></CycloneDDS>"""
"""Restriction to this machine. Peers are listed by number, because multicast does not find Fast DDS nodes restricted to
it.
"""
DOMAIN_VARIABLE, CONFIGURATION_VARIABLE = "ROS_DOMAIN_ID", "CYCLONEDDS_URI"
PEERS_VARIABLE = "ROS_STATIC_PEERS"
BLOCKED_NS = 100_000_000
MOST_TAKEN = 100
MOST_ENDPOINTS = 10_000
GRAPH = "ros_discovery_info"
GRAPH_TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"
GRAPH_DEPTH = 1000
GRAPH_QOS = QosProfile(durability="transient_local", depth=1)
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any
_TYPES: dict[str, Any] = {
    **{name: getattr(types, name) for name in ("int8", "int16", "int32", "int64", "float32", "float64")},
    **{name: getattr(types, name) for name in ("uint8", "uint16", "uint32", "uint64")},
    **{"bool": bool, "byte": types.byte, "char": types.uint8, "string": str},
}
_POLICIES = {2: "durability", 11: "reliability"}
"""QoS policies by their number in DDS."""


class CycloneMiddleware:
    """A node in a separate participant: see Middleware."""

    def __init__(self, spec: RosSpec, node_name: str = NODE_NAME) -> None:
        self._domain_id = ros_domain(spec)
        self._node = node_name
        user_configuration = os.environ.get(CONFIGURATION_VARIABLE)
        self._local = stays_on_machine(spec)
        parts = (LOCAL_CONFIGURATION if self._local else "", user_configuration, CONFIGURATION)
        try:
            self._domain = Domain(self._domain_id, ",".join(filter(None, parts)))
            about = Policy.Userdata(data=b"enclave=/;")
            self._participant = DomainParticipant(self._domain_id, qos=DomainParticipantQos(about))
        except DDSException as error:
            hint = f"; check {CONFIGURATION_VARIABLE}" if user_configuration else ""
            raise UserError(f"ros: cannot join domain {self._domain_id} ({error}){hint}") from error
        reach = "this machine" if self._local else "subnet"
        self.name = f"cyclonedds {version('cyclonedds')}, domain {self._domain_id}, {reach}"
        self._topics: dict[str, Topic[Any]] = {}
        self._writers: list[DataWriter[Any]] = []
        self._published: list[str] = []
        self._readers: list[tuple[str, DataReader[Any], Callable[[bytes], None]]] = []
        self._names = WriterNames()
        self._commanders = Commanders(spec.commanders)
        self._senders = SenderCheck(self._commanders, self._names.node_of)
        self._waiting = WaitSet(self._participant)
        self._conditions: list[ReadCondition] = []
        self._services: RtpsServices | None = None
        self._answers: dict[str, Callable[[bytes], bytes]] = {}
        self._requests: deque[ServiceRequest] = deque()
        self._request_arrived = GuardCondition(self._participant)
        self._waiting.attach(self._request_arrived)
        self._problems = list(unread_variables(spec))
        self._reported: set[tuple[str, int]] = set()
        self._others = OtherEndpoints(self._participant)
        self._next_check_s = 0.0
        self._lock = threading.Lock()
        self._graph = self._writer(GRAPH, GRAPH_TYPE, GRAPH_QOS)
        self._graph_reader: DataReader[Any] | None = None
        if not self._commanders.everyone:
            qos = _qos(replace(GRAPH_QOS, depth=GRAPH_DEPTH), GRAPH_TYPE)
            self._graph_reader = DataReader(self._participant, self._topic(GRAPH, GRAPH_TYPE), qos)
            self._attach(self._graph_reader)
        self._graph_changed = True
        self._closed = False

    def advertise(self, topic: str, type_name: str, qos: QosProfile) -> Callable[[bytes], None]:
        """See Middleware."""
        writer = self._writer(f"rt{topic}", type_name, qos, self._mismatch(topic, qos, True))
        self._writers.append(writer)
        self._published.append(topic)
        self._graph_changed = True
        ref = writer._ref

        def publish(cdr: bytes) -> None:
            ddspy_write(ref, cdr)  # a slow reader costs BLOCKED_NS, and the message is then kept

        return publish

    def subscribe(self, topic: str, type_name: str, qos: QosProfile, handle: Callable[[bytes], None]) -> None:
        """See Middleware."""
        listener = self._mismatch(topic, qos, False)
        named = self._topic(f"rt{topic}", type_name)
        reader = DataReader(self._participant, named, _qos(qos, type_name), listener)
        self._attach(reader)
        self._readers.append((topic, reader, handle))
        self._graph_changed = True

    def _attach(self, reader: DataReader[Any]) -> None:
        condition = ReadCondition(reader, _ANY)
        self._conditions.append(condition)
        self._waiting.attach(condition)

    def serve(self, service: str, type_name: str, answer: Callable[[bytes], bytes]) -> None:
        """See Middleware. A separate participant serves requests, see `rtps_services`."""
        if self._services is None:
            try:
                self._services = RtpsServices(self._domain_id, self._on_request, self._local)
            except OSError as error:
                if not self._answers:
                    text = f"ros: services are not available ({error}); use the topics of the same names instead"
                    self._problems.append(text)
                self._answers[service] = answer
                return
        self._answers[self._services.serve(service, type_name).name] = answer
        self._graph_changed = True

    def _on_request(self, request: ServiceRequest) -> None:
        """Receive a request in the thread of the services."""
        self._requests.append(request)
        self._request_arrived.set(True)

    def spin(self, timeout_s: float) -> None:
        """See Middleware."""
        if self._graph_changed:
            self._graph_changed = False
            ddspy_write(self._graph._ref, self._node_graph())
        if self._waiting.wait(round(timeout_s * 1e9)) > 0:
            self._request_arrived.take()
            self._read_names()
            while self._requests:
                request = self._requests.popleft()
                self._senders.check(request.service.name, request.writer, partial(self._respond, request))
            for topic, reader, handle in self._readers:
                for payload, about in _taken(reader):
                    if self._commanders.everyone:
                        handle(payload)
                    else:
                        self._senders.check(topic, _writer_guid(reader, about), partial(handle, payload))
        self._senders.flush()

    def _respond(self, request: ServiceRequest) -> None:
        assert self._services is not None
        self._services.respond(request, self._answers[request.service.name](request.cdr))

    def _read_names(self) -> None:
        """Read the nodes of writers from the announcements of other participants."""
        if self._graph_reader is None:
            return
        for payload, about in _taken(self._graph_reader):
            try:
                message = deserialize(payload, GRAPH_TYPE)
            except (SerdeError, ValueError, IndexError):
                self._commanders.refused[GRAPH] += 1
                continue
            self._names.update(_writer_guid(self._graph_reader, about), message)

    def losses(self) -> MiddlewareLosses:
        """See Middleware."""
        refused = dict(self._commanders.refused)
        if self._services is not None and self._services.refused:
            refused["services"] = self._services.refused
        return MiddlewareLosses(refused=refused)

    def problems(self) -> list[str]:
        """See Middleware."""
        with self._lock:
            problems, self._problems = self._problems, []
        problems += self._commanders.problems()
        now_s = time.monotonic()
        if now_s >= self._next_check_s:
            self._next_check_s = now_s + CHECK_S
            others = self._others.publishers({f"rt{topic}" for topic in self._published})
            if others:
                problems.append(others_text([name[2:] for name in others], f"in domain {self._domain_id}"))
            ours = {name: topic.typename for name, topic in self._topics.items()}
            for name, theirs in self._others.other_types(ours):
                problems.append(type_text(name[2:], ros_type(ours[name]), ros_type(theirs)))
        return problems

    def close(self) -> None:
        """See Middleware."""
        if not self._closed:
            self._closed = True
            if self._services is not None:
                self._services.close()
            self._domain._delete(self._domain._ref)  # with all its entities

    def _topic(self, name: str, type_name: str) -> Topic[Any]:
        if name not in self._topics:
            self._topics[name] = Topic(self._participant, name, dds_type(type_name))
        return self._topics[name]

    def _writer(self, name: str, type_name: str, qos: QosProfile, listener: Listener | None = None) -> DataWriter[Any]:
        return DataWriter(self._participant, self._topic(name, type_name), _qos(qos, type_name), listener)

    def _mismatch(self, topic: str, qos: QosProfile, offers: bool) -> Listener:
        """Note a QoS mismatch with another node; called in threads of Cyclone DDS."""

        def note(entity: object, status: Any) -> None:
            policy = _POLICIES.get(int(status.last_policy_id), "QoS")
            with self._lock:
                if (topic, status.last_policy_id) not in self._reported:
                    self._reported.add((topic, status.last_policy_id))
                    self._problems.append(mismatch_text(topic, policy, qos, offers))

        return Listener(on_offered_incompatible_qos=note, on_requested_incompatible_qos=note)

    def _node_graph(self) -> bytes:
        kinds = ros2_types().types

        def gid(guid: bytes) -> Any:
            return kinds["rmw_dds_common/msg/Gid"](data=np.frombuffer(guid, dtype=np.uint8))

        readers = [reader.get_guid().bytes for _, reader, _ in self._readers]
        writers = [writer.get_guid().bytes for writer in self._writers]
        if self._services is not None:
            of_services = self._services.gids()
            readers, writers = readers + of_services[0], writers + of_services[1]
        node = kinds["rmw_dds_common/msg/NodeEntitiesInfo"](
            node_namespace="/",
            node_name=self._node,
            reader_gid_seq=[gid(guid) for guid in readers],
            writer_gid_seq=[gid(guid) for guid in writers],
        )
        message = kinds[GRAPH_TYPE](gid=gid(self._participant.get_guid().bytes), node_entities_info_seq=[node])
        return serialize(message)


class OtherEndpoints:
    """Publishers and subscribers of other participants in the domain. Each is reported once, by names on the wire."""

    def __init__(self, participant: DomainParticipant) -> None:
        self._publications = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
        self._subscriptions = BuiltinDataReader(participant, BuiltinTopicDcpsSubscription)
        self._own = participant.get_guid()
        self._reported: set[str] = set()
        self._reported_types: set[tuple[str, str]] = set()

    def publishers(self, topics: Set[str]) -> list[str]:
        """Return the members of `topics` that others publish."""
        shared = {name for name, _ in self._seen(self._publications) if name in topics}
        new = sorted(shared - self._reported)
        self._reported |= shared
        return new

    def other_types(self, types_of: Mapping[str, str]) -> list[tuple[str, str]]:
        """Return topics that others use with a type different from `types_of`, each with that type."""
        seen = {*self._seen(self._publications), *self._seen(self._subscriptions)}
        different = {(name, kind) for name, kind in seen if name in types_of and types_of[name] != kind}
        new = sorted(different - self._reported_types)
        self._reported_types |= different
        return new

    def _seen(self, reader: BuiltinDataReader[Any]) -> Iterator[tuple[str, str]]:
        for endpoint in reader.read(MOST_ENDPOINTS):
            if getattr(endpoint, "participant_key", self._own) != self._own:
                yield endpoint.topic_name, endpoint.type_name


def ros_type(wire_name: str) -> str:
    """Return a type in ROS notation: `std_msgs::msg::dds_::String_` is std_msgs/msg/String."""
    return wire_name.replace("::dds_::", "::").replace("::", "/").removesuffix("_")


def ros_domain(spec: RosSpec) -> int:
    """Return the domain. Raises UserError for an environment variable that is not a number."""
    domain = os.environ.get(DOMAIN_VARIABLE, "")
    if spec.domain is not None or not domain:
        return spec.domain or 0
    if domain.isdecimal() and int(domain) <= 232:
        return int(domain)
    raise UserError(f"{DOMAIN_VARIABLE}={domain} is not a domain of ROS 2; use 0 to 232, or ros.domain")


def unread_variables(spec: RosSpec) -> Iterator[str]:
    """Yield a sentence for each set variable of ROS 2's discovery that has no effect here."""
    if discovery_range(spec) == "OFF":
        fix = "to exclude nodes of this machine, use another domain, or ros.way: rclpy"
        yield f"ros: {RANGE_VARIABLE}=OFF has the effect of LOCALHOST without rclpy; {fix}"
    if os.environ.get(PEERS_VARIABLE):
        fix = f"give peers in {CONFIGURATION_VARIABLE}, or use ros.way: rclpy"
        yield f"ros: {PEERS_VARIABLE} has no effect without rclpy; {fix}"


def _taken(reader: DataReader[Any]) -> Iterator[tuple[bytes, Any]]:
    """Yield new samples with their information."""
    taken = ddspy_take(reader._ref, _ANY, MOST_TAKEN)
    if isinstance(taken, list):
        for payload, about in taken:
            if about.valid_data:
                yield payload, about


def _writer_guid(reader: DataReader[Any], about: Any) -> bytes:
    """Return the GUID of the writer of a sample; empty for a writer that has left."""
    writer = reader.get_matched_publication_data(about.publication_handle)
    return b"" if writer is None else writer.key.bytes


@cache
def dds_type(type_name: str) -> Any:
    """Return the type of a message for DDS."""
    store = ros2_types()
    package, kind, name = type_name.split("/")

    def dds(node: Any) -> Any:
        form, inner = node
        if form is Nodetype.BASE:
            return _TYPES[inner[0]]
        if form is Nodetype.NAME:
            return dds_type(inner)
        element = dds(inner[0])
        return types.array[element, inner[1]] if form is Nodetype.ARRAY else types.sequence[element]

    fields = {field: dds(node) for field, node in store.fielddefs[type_name][1]}
    fields = fields or {"structure_needs_at_least_one_member": types.uint8}
    return make_idl_struct(name, f"{package}.{kind}.dds_.{name}_", fields)


def _qos(qos: QosProfile, type_name: str) -> Qos:
    reliable = qos.reliability == "reliable"
    hashed = type_hash(type_name)
    return Qos(
        Policy.Reliability.Reliable(BLOCKED_NS) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if qos.durability == "transient_local" else Policy.Durability.Volatile,
        Policy.History.KeepLast(qos.depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(data=f"typehash={hashed};".encode()),
    )
