"""Services without an installed ROS: called by another DDS, as rmw_cyclonedds calls, in the same process."""

from __future__ import annotations

import queue
import struct
from typing import Any

import pytest
from ros2 import own_domain

from tests.patience import PATIENCE_S, wait_until

cyclonedds = pytest.importorskip("cyclonedds")

from cyclonedds._clayer import ddspy_take, ddspy_write  # noqa: E402
from cyclonedds.core import InstanceState, SampleState, ViewState  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import make_idl_struct, types  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.qos import Policy, Qos  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402

from xitl_cli.plugins.ros.rtps_services import RtpsServices, ServiceRequest  # noqa: E402

DOMAIN = own_domain()
BEFORE = struct.pack("<Qq", 0x1234, 7)
"""GUID of the client and number of the request, as rmw_cyclonedds puts them before it."""
RELIABLE = Qos(
    Policy.Reliability.Reliable(100_000_000),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


def topic(participant: DomainParticipant, name: str, kind: str) -> Topic[Any]:
    bytes_of = make_idl_struct(kind, f"std_srvs.srv.dds_.{kind}", {"data": types.uint8})
    return Topic(participant, name, bytes_of)


def handle_of(end: DataReader[Any] | DataWriter[Any]) -> int:
    """What the C layer of Cyclone DDS knows it by."""
    return end._ref


def test_a_request_has_its_response() -> None:
    requests: queue.SimpleQueue[ServiceRequest] = queue.SimpleQueue()
    services = RtpsServices(DOMAIN, requests.put)
    try:
        services.serve("/arm", "std_srvs/srv/SetBool")
        client = DomainParticipant(DOMAIN)
        reader = DataReader(client, topic(client, "rr/armReply", "SetBool_Response_"), qos=RELIABLE)
        writer = DataWriter(client, topic(client, "rq/armRequest", "SetBool_Request_"), qos=RELIABLE)
        wait_until(lambda: bool(writer.get_matched_subscriptions() and reader.get_matched_publications()))
        ddspy_write(handle_of(writer), b"\0\1\0\0" + BEFORE + b"\1\0\0\0")
        request = requests.get(timeout=PATIENCE_S)
        assert (request.service.name, request.cdr[:5], request.before) == ("/arm", b"\0\1\0\0\1", BEFORE)
        text = b"armed\0"
        body = struct.pack("<?xxxI", True, len(text)) + text
        services.respond(request, b"\0\1\0\0" + body)
        taken: list[bytes] = []

        def answered() -> bool:
            found = ddspy_take(handle_of(reader), SampleState.Any | ViewState.Any | InstanceState.Any, 10)
            taken.extend(payload for payload, about in found if about.valid_data)
            return bool(taken)

        wait_until(answered)
        assert [payload[: 20 + len(body)] for payload in taken] == [b"\0\1\0\0" + BEFORE + body]
    finally:
        services.close()


def test_the_second_node_of_a_machine_has_a_port_of_its_own() -> None:
    first = RtpsServices(DOMAIN, lambda request: None)
    second = RtpsServices(DOMAIN, lambda request: None)
    first.close()
    second.close()
    assert second.port > first.port
