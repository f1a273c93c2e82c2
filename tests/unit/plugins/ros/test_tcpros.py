"""A node of ROS 1 against peers of the test's own, friendly and hostile, and a master of a page."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit
from xmlrpc.client import ServerProxy
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import numpy as np
import pytest

from tests.doubles.ros_master import FakeMaster
from tests.free_ports import free_port
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.plugins.ros import tcpros_middleware as middleware_module
from xitl_cli.plugins.ros.definitions import deserialize, ros1_definition, ros2_types, serialize
from xitl_cli.plugins.ros.middleware import LATCHED, RELIABLE, QosProfile
from xitl_cli.plugins.ros.tcpros import master as master_module
from xitl_cli.plugins.ros.tcpros import slave as slave_module
from xitl_cli.plugins.ros.tcpros import topics as topics_module
from xitl_cli.plugins.ros.tcpros.wire import (
    TcprosError,
    block,
    encode_header,
    parse_header,
    receive_block,
    receive_header,
)
from xitl_cli.plugins.ros.tcpros_middleware import TcprosMiddleware
from xitl_cli.profile.schema.ros import RosSpec

STRING = "std_msgs/msg/String"
SET_BOOL = "std_srvs/srv/SetBool"
FLOAT = "std_msgs/msg/Float64"


def cdr(type_name: str, **fields: Any) -> bytes:
    return serialize(ros2_types().types[type_name](**fields))


def wait(condition: Callable[[], object], *nodes: TcprosMiddleware) -> None:
    """Until the condition holds, with the nodes spinning."""

    def holds() -> bool:
        for node in nodes:
            node.spin(0.002)
        return bool(condition())

    wait_until(holds, look_s=0.0 if nodes else 0.002)


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(master_module, "RETRY_S", 0.02)
    monkeypatch.setattr(topics_module, "AGAIN_S", 0.02)


@pytest.fixture
def master() -> Iterator[FakeMaster]:
    made = FakeMaster()
    yield made
    made.stop()


@pytest.fixture
def nodes(master: FakeMaster) -> Iterator[Callable[[str], TcprosMiddleware]]:
    opened: list[TcprosMiddleware] = []

    def open_node(name: str) -> TcprosMiddleware:
        opened.append(TcprosMiddleware(RosSpec(master=master.uri), name))
        return opened[-1]

    yield open_node
    for node in opened:
        node.close()


def connect(node: TcprosMiddleware, topic: str, **fields: str) -> socket.socket:
    """A subscriber by hand."""
    place = node.place_of(topic)
    assert place is not None
    connection = socket.create_connection(place, PATIENCE_S)
    connection.sendall(encode_header({"callerid": "/by_hand", "topic": topic, **fields}))
    return connection


def test_the_bytes_are_those_of_the_specification() -> None:
    """The example of ROS wiki, "ROS/TCPROS": `rostopic pub chatter std_msgs/String hello`, as it is on the wire."""
    wire = bytes.fromhex("b000000020000000") + b"message_definition=string data\n\n"
    wire += bytes.fromhex("25000000") + b"callerid=/rostopic_4767_1316912741557"
    wire += bytes.fromhex("0a000000") + b"latching=1" + bytes.fromhex("27000000")
    wire += b"md5sum=992ce8a1687cec8c8bd883ec73ca41d1" + bytes.fromhex("0e000000") + b"topic=/chatter"
    wire += bytes.fromhex("14000000") + b"type=std_msgs/String"
    fields = parse_header(wire[4:])
    assert fields["md5sum"] == ros1_definition(STRING)[1]
    assert encode_header(fields) == wire


def test_noise_is_a_header_or_refused() -> None:
    rng = np.random.default_rng(5)
    whole = encode_header({"callerid": "/a", "topic": "/b", "md5sum": "*"})[4:]
    for _ in range(2000):
        noisy = bytearray(whole)
        for place in rng.integers(len(whole), size=2).tolist():
            noisy[place] = int(rng.integers(256))
        try:
            parse_header(bytes(noisy[: int(rng.integers(len(whole) + 1))]))
        except TcprosError:
            continue


def test_messages_go_from_node_to_node(nodes: Callable[[str], TcprosMiddleware]) -> None:
    giver, taker = nodes("giver"), nodes("taker")
    publish = giver.advertise("/boat/imu", "sensor_msgs/msg/Imu", RELIABLE)
    described = giver.advertise("/boat/robot_description", STRING, LATCHED)
    described(cdr(STRING, data="<robot/>"))
    got: list[bytes] = []
    texts: list[bytes] = []
    taker.subscribe("/boat/imu", "sensor_msgs/msg/Imu", RELIABLE, got.append)
    taker.subscribe("/boat/robot_description", STRING, LATCHED, texts.append)
    wait(lambda: texts and len(giver.connections()) == 2, giver, taker)
    assert deserialize(texts[0], STRING).data == "<robot/>"  # though it was published before
    t = ros2_types().types
    header = t["std_msgs/msg/Header"](t["builtin_interfaces/msg/Time"](12, 345), "imu_link")
    vector = t["geometry_msgs/msg/Vector3"](1.0, -2.0, 9.8)
    nine = np.arange(9.0)
    imu = t["sensor_msgs/msg/Imu"](
        header, t["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.6, 0.8), nine, vector, nine, vector, nine
    )
    sent = [serialize(imu)] * 50
    for payload in sent:
        publish(payload)
    wait(lambda: len(got) == len(sent), taker)
    assert got == sent
    assert giver.connections() == [("/taker", "o", "/boat/imu"), ("/taker", "o", "/boat/robot_description")]
    assert not giver.losses().dropped
    assert not giver.problems()


def test_the_master_knows_all_of_it_and_forgets_it_at_the_end(
    master: FakeMaster, nodes: Callable[[str], TcprosMiddleware]
) -> None:
    node = nodes("xitl")
    node.advertise("/robot_description", STRING, LATCHED)(cdr(STRING, data="<robot/>"))
    node.subscribe("/cmd_vel", "geometry_msgs/msg/Twist", RELIABLE, lambda cdr: None)
    node.serve("/arm", SET_BOOL, lambda cdr: cdr)
    expected = {"/use_sim_time": True, "/robot_description": "<robot/>"}
    wait(lambda: master.parameters == expected and master.services and master.subscribers.get("/cmd_vel"))
    with ServerProxy(master.nodes["/xitl"]) as api:
        assert api.getPublications("/me")[2] == [["/robot_description", "std_msgs/String"]]
        assert api.getSubscriptions("/me")[2] == [["/cmd_vel", "geometry_msgs/Twist"]]
        assert api.requestTopic("/me", "/robot_description", [["UDPROS"]])[0] == 0
        assert api.requestTopic("/me", "/nothing", [["TCPROS"]])[0] == -1
        assert api.getBusInfo("/me")[0] == 1
    node.close()
    assert not master.parameters
    assert not master.services
    assert not any(master.publishers.values())
    assert not any(master.subscribers.values())


def test_a_service_answers(nodes: Callable[[str], TcprosMiddleware]) -> None:
    node = nodes("xitl")
    place = ("127.0.0.1", node.port)

    def answer(request: bytes) -> bytes:
        armed = deserialize(request, f"{SET_BOOL}_Request").data
        return cdr(f"{SET_BOOL}_Response", success=armed, message="as you say")

    node.serve("/arm", SET_BOOL, answer)
    replies: list[bytes] = []

    def ask() -> None:
        with socket.create_connection(place, PATIENCE_S) as connection:
            connection.sendall(encode_header({"callerid": "/c", "service": "/arm", "md5sum": "*", "persistent": "1"}))
            assert receive_header(connection)["type"] == "std_srvs/SetBool"
            for request in (b"\x01", b"\x00", b""):  # the last is too short
                connection.sendall(block(request))
                good = connection.recv(1)
                replies.append(good + (receive_block(connection, 1000) or b""))

    client = threading.Thread(target=ask)
    client.start()
    wait(lambda: len(replies) == 3, node)
    client.join()
    assert replies[0] == b"\x01" + b"\x01" + block(b"as you say")
    assert replies[1] == b"\x01" + b"\x00" + block(b"as you say")
    assert replies[2][:1] == b"\x00"
    assert b"std_srvs/SetBool" in replies[2]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"md5sum": "0" * 32, "type": "std_msgs/Float64"}, "MD5"),
        ({"md5sum": "*", "type": "std_msgs/Int8"}, "std_msgs/Float64"),
    ],
)
def test_another_type_is_refused_with_a_reason(
    nodes: Callable[[str], TcprosMiddleware], fields: dict[str, str], said: str
) -> None:
    node = nodes("xitl")
    publish = node.advertise("/thrust", FLOAT, RELIABLE)
    with connect(node, "/thrust", **fields) as connection:
        assert said in receive_header(connection)["error"]
        assert connection.recv(1) == b""
    assert node.losses().refused == {"/thrust": 1}
    assert any(said in problem for problem in node.problems())
    with connect(node, "/thrust", md5sum="*", type="*") as connection:  # and others are still served
        assert receive_header(connection)["md5sum"] == ros1_definition(FLOAT)[1]
        wait(node.connections)
        publish(cdr(FLOAT, data=2.5))
        assert receive_block(connection, 100) == np.float64(2.5).tobytes()


@pytest.mark.parametrize(
    "sent",
    [
        b"\xff\xff\xff\xff",
        b"\x10\x00\x00\x00short",
        b"GET / HTTP/1.1\r\n\r\n",
        block(b"\x04\x00\x00\x00none"),
        block(b"\xff\xff\xff\xffx=y"),
        encode_header({"callerid": "/x"}),
        encode_header({"topic": "/no such"}),
        encode_header({"service": "/no such", "md5sum": "*"}),
    ],
)
def test_a_hostile_peer_is_refused_and_counted(nodes: Callable[[str], TcprosMiddleware], sent: bytes) -> None:
    node = nodes("xitl")
    with socket.create_connection(("127.0.0.1", node.port), PATIENCE_S) as peer:
        peer.sendall(sent)
        with suppress(OSError):  # it may have hung up already
            peer.shutdown(socket.SHUT_WR)
        wait(lambda: sum(node.losses().refused.values()) == 1)
    assert len(node.problems()) == 1


class OvertakenMaster(FakeMaster):
    """Tells a subscriber of a publisher that is new before it answers that there was none. late: where that one is."""

    late = ""

    def on_register_subscriber(self, node: str, topic: str, kind: str, uri: str) -> list[str]:
        before = super().on_register_subscriber(node, topic, kind, uri)
        with ServerProxy(uri) as subscriber:
            subscriber.publisherUpdate("/master", topic, [self.late])
        return before


def test_a_publisher_that_comes_while_the_master_answers_is_kept() -> None:
    master = OvertakenMaster()
    late = TcprosMiddleware(RosSpec(master=master.uri), "late")
    publish = late.advertise("/thrust", FLOAT, RELIABLE)
    wait(lambda: master.publishers.get("/thrust"))
    master.late = master.publishers.pop("/thrust")[0][1]  # not there yet when the subscriber asks
    node = TcprosMiddleware(RosSpec(master=master.uri), "xitl")
    got: list[bytes] = []
    try:
        node.subscribe("/thrust", FLOAT, RELIABLE, got.append)
        wait(lambda: node.connections() and master.subscribers.get("/thrust"))
        wait(lambda: got or publish(cdr(FLOAT, data=2.5)), node)
    finally:
        master.publishers["/thrust"] = [("/late", master.late)]
        for each in (node, late):
            each.close()
        master.stop()


@pytest.mark.parametrize("behaviour", ["4 GB", "garbage", "other type", "closes"])
def test_a_hostile_publisher_is_refused_and_counted(
    master: FakeMaster, nodes: Callable[[str], TcprosMiddleware], behaviour: str
) -> None:
    node = nodes("xitl")
    got: list[bytes] = []
    listener = socket.create_server(("127.0.0.1", 0))
    api = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
    api.register_function(lambda *_: [1, "", ["TCPROS", "127.0.0.1", listener.getsockname()[1]]], "requestTopic")
    threading.Thread(target=api.serve_forever, args=(0.02,), daemon=True).start()
    node.subscribe("/thrust", FLOAT, RELIABLE, got.append)
    wait(lambda: master.subscribers.get("/thrust"))
    master.on_register_publisher("/hostile", "/thrust", "std_msgs/Float64", f"http://127.0.0.1:{api.server_address[1]}")
    connection, _ = listener.accept()
    receive_header(connection)
    md5 = "0" * 32 if behaviour == "other type" else ros1_definition(FLOAT)[1]
    connection.sendall(encode_header({"md5sum": md5, "type": "std_msgs/Float64"}))
    if behaviour == "closes":
        connection.close()
        connection, _ = listener.accept()  # it tries again
    else:
        connection.sendall({"4 GB": b"\xff" * 8, "garbage": block(b"abc"), "other type": b""}[behaviour])
        wait(lambda: node.losses().refused == {"/thrust": 1}, node)
        assert "std_msgs/Float64" in (said := node.problems()[0]) or "bytes" in said
    assert not got
    for each in (connection, listener):
        each.close()
    api.shutdown()
    api.server_close()


@pytest.mark.parametrize(
    "place",
    [
        5,
        [],
        ["TCPROS"],
        ["TCPROS", "127.0.0.1", "a port"],
        ["TCPROS", "127.0.0.1", 99_999],
        ["TCPROS", "." + "x" * 300, 1],
        ["UDPROS", "127.0.0.1", 1],
    ],
)
def test_a_publisher_without_a_place_is_refused_and_counted(
    master: FakeMaster, nodes: Callable[[str], TcprosMiddleware], place: Any
) -> None:
    node = nodes("xitl")
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as api:
        api.register_function(lambda *_: [1, "", place], "requestTopic")
        threading.Thread(target=api.serve_forever, args=(0.02,), daemon=True).start()
        uri = f"http://127.0.0.1:{api.server_address[1]}"
        master.publishers["/thrust"] = [("/hostile", uri)]
        node.subscribe("/thrust", FLOAT, RELIABLE, lambda cdr: None)
        wait(lambda: node.losses().refused == {"/thrust": 1})
        api.shutdown()
    assert uri in node.problems()[0]


@pytest.mark.parametrize("value", [5, None, [5], [["x"]], {"a": 1}, "nothing"])
def test_a_master_that_answers_nonsense_is_said_and_asked_again(
    master: FakeMaster, nodes: Callable[[str], TcprosMiddleware], value: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def answer(method: str, arguments: tuple[Any, ...]) -> list[Any]:
        asked.append(method)
        return [1, "", value]

    with monkeypatch.context() as hostile:
        hostile.setattr(master, "_dispatch", answer)
        node = nodes("xitl")
        node.subscribe("/thrust", FLOAT, RELIABLE, lambda cdr: None)
        node.advertise("/speed", FLOAT, RELIABLE)
        wait(lambda: asked.count("getPid") > 3)
    master.number = 7  # another master from here on
    wait(lambda: master.subscribers.get("/thrust") and master.publishers.get("/speed"))


@pytest.mark.parametrize(
    "value",
    [
        "<bigdecimal>x</bigdecimal>",
        "<struct><member><name>a</name></member></struct>",
        "<struct><member><name>a</name><value><int>1</int></value></member><value><int>2</int></value></struct>",
    ],
)
def test_a_value_that_is_no_xml_rpc_is_a_refusal(value: str) -> None:
    body = f"<methodResponse><params><param><value>{value}</value></param></params></methodResponse>".encode()

    class Broken(SimpleXMLRPCRequestHandler):
        def do_POST(self) -> None:  # noqa: N802
            self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

    with SimpleXMLRPCServer(("127.0.0.1", 0), Broken, logRequests=False) as api:
        threading.Thread(target=api.handle_request, daemon=True).start()
        with pytest.raises(master_module.MasterRefusedError, match="does not follow the API of ROS"):
            master_module.call(f"http://127.0.0.1:{api.server_address[1]}", "getPid", "/xitl")


def test_a_page_in_place_of_a_master_is_said_once_and_asked_again() -> None:
    asked = 0

    class Page(SimpleXMLRPCRequestHandler):
        def do_POST(self) -> None:  # noqa: N802
            nonlocal asked
            asked += 1
            self.send_error(404)

        def log_message(self, *_: Any) -> None:
            pass

    with SimpleXMLRPCServer(("127.0.0.1", 0), Page) as page:
        threading.Thread(target=page.serve_forever, args=(0.02,), daemon=True).start()
        node = TcprosMiddleware(RosSpec(master=f"ros1://127.0.0.1:{page.server_address[1]}"))
        wait(lambda: asked > 3)
        (said,) = node.problems()
        assert "404" in said
        node.close()
        page.shutdown()


def test_peers_that_ask_for_anything_are_told_of_once(nodes: Callable[[str], TcprosMiddleware]) -> None:
    node = nodes("xitl")
    for number in range(20):
        asked = {"topic": f"/{number}" * 10_000} if number % 2 else {"service": f"/{number}" * 10_000}
        with socket.create_connection(("127.0.0.1", node.port), PATIENCE_S) as peer:
            peer.sendall(encode_header(asked))
            assert "not" in receive_header(peer)["error"]
    assert node.losses().refused == {"connections": 20}
    (said,) = node.problems()
    assert len(said) < 500


def test_more_subscribers_than_a_topic_takes_are_refused(
    nodes: Callable[[str], TcprosMiddleware], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(topics_module, "MOST_SUBSCRIBERS", 2)
    node = nodes("xitl")
    node.advertise("/thrust", FLOAT, RELIABLE)
    with connect(node, "/thrust", md5sum="*") as one, connect(node, "/thrust", md5sum="*") as two:
        for each in (one, two):
            assert "error" not in receive_header(each)
        wait(lambda: len(node.connections()) == 2)
        with connect(node, "/thrust", md5sum="*") as third:
            assert "2 subscribers" in receive_header(third)["error"]
        assert node.losses().refused == {"/thrust": 1}


def test_a_call_that_was_answered_with_nobody_is_not_carried_out_later(
    nodes: Callable[[str], TcprosMiddleware], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(middleware_module, "ANSWER_S", 0.05)
    node = nodes("xitl")
    carried_out: list[bytes] = []

    def answer(request: bytes) -> bytes:
        carried_out.append(request)
        return cdr(f"{SET_BOOL}_Response", success=True, message="")

    node.serve("/arm", SET_BOOL, answer)

    def call() -> bytes:
        """Whether it was good."""
        with socket.create_connection(("127.0.0.1", node.port), PATIENCE_S) as connection:
            connection.sendall(encode_header({"service": "/arm", "md5sum": "*"}) + block(b"\x01"))
            receive_header(connection)
            return connection.recv(1)

    assert call() == b"\0"
    node.spin(0.0)
    assert not carried_out


def test_a_connection_that_fails_to_be_accepted_is_not_the_last(
    nodes: Callable[[str], TcprosMiddleware], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = nodes("xitl")
    node.advertise("/thrust", FLOAT, RELIABLE)
    accept, failures = socket.socket.accept, [1]

    def failing(listener: socket.socket) -> Any:
        if failures and listener.getsockname()[1] == node.port:
            failures.pop()
            raise OSError(24, "Too many open files")
        return accept(listener)

    monkeypatch.setattr(socket.socket, "accept", failing)
    for _ in range(3):
        with connect(node, "/thrust", md5sum="*") as peer:
            assert receive_header(peer)["topic"] == "/thrust"
    assert not failures


def test_a_subscriber_that_does_not_read_loses_messages_and_holds_nobody_up(
    nodes: Callable[[str], TcprosMiddleware],
) -> None:
    node = nodes("xitl")
    publish = node.advertise("/text", STRING, QosProfile(depth=5))
    with connect(node, "/text", md5sum="*") as slow, connect(node, "/text", md5sum="*") as quick:
        receive_header(slow)
        receive_header(quick)
        wait(lambda: len(node.connections()) == 2)
        payload = cdr(STRING, data="x" * 100_000)
        for _ in range(400):  # 40 MB: more than the buffers of any system
            publish(payload)
            assert len(receive_block(quick, 1 << 20) or b"") == 100_004
        assert 0 < node.losses().dropped["/text"] <= 400


@pytest.mark.medium
def test_of_a_flood_the_latest_are_handled(nodes: Callable[[str], TcprosMiddleware]) -> None:
    giver, taker = nodes("giver"), nodes("taker")
    publish = giver.advertise("/thrust", FLOAT, QosProfile(depth=20_000))
    got: list[float] = []
    taker.subscribe("/thrust", FLOAT, QosProfile(depth=10), lambda data: got.append(deserialize(data, FLOAT).data))
    wait(giver.connections)
    for number in range(10_000):
        publish(cdr(FLOAT, data=float(number)))
    wait(lambda: taker.losses().dropped.get("/thrust", 0) == 9_990)
    wait(lambda: got and got[-1] == 9_999.0, taker)
    assert got == [float(number) for number in range(9_990, 10_000)]
    assert taker.losses().dropped == {"/thrust": 9_990}


def test_a_master_that_is_away_is_said_once_and_found_when_it_comes_and_again() -> None:
    port = free_port()
    node = TcprosMiddleware(RosSpec(master=f"ros1://127.0.0.1:{port}"))
    node.advertise("/thrust", FLOAT, RELIABLE)
    told: list[str] = []
    wait(lambda: told.extend(node.problems()) or told)
    assert "roscore" in told[0]
    for number in (1, 2):
        master = FakeMaster(port, number)
        wait(lambda master=master: master.publishers.get("/thrust"))
        master.stop()
        wait(lambda number=number: told.extend(node.problems()) or len(told) == 1 + number)
    node.close()


def test_a_name_that_is_taken_becomes_another(nodes: Callable[[str], TcprosMiddleware], master: FakeMaster) -> None:
    first = nodes("xitl")
    first.advertise("/thrust", FLOAT, RELIABLE)
    wait(lambda: master.nodes)
    second = nodes("xitl")
    second.advertise("/thrust", FLOAT, RELIABLE)
    told: list[str] = []
    wait(lambda: told.extend(second.problems()) or len(told) == 2)
    assert second.node != first.node == "/xitl"
    assert "namespace" in told[1]


def test_the_master_may_stop_the_node(nodes: Callable[[str], TcprosMiddleware], master: FakeMaster) -> None:
    node = nodes("xitl")
    publish = node.advertise("/thrust", FLOAT, RELIABLE)
    wait(lambda: master.nodes)
    with ServerProxy(master.nodes["/xitl"]) as api:
        api.shutdown("/rosnode", "user request")
    assert any("user request" in problem for problem in node.problems())
    publish(cdr(FLOAT, data=1.0))
    node.spin(0.0)


def persistent_call(node: TcprosMiddleware, caller: str = "/helm") -> socket.socket:
    """A client that has asked for a persistent connection to /arm, and has its answer to that."""
    connection = socket.create_connection(("127.0.0.1", node.port), PATIENCE_S)
    asked = {"callerid": caller, "service": "/arm", "md5sum": "*", "persistent": "1"}
    connection.sendall(encode_header(asked))
    return connection


def serve_arm(node: TcprosMiddleware) -> None:
    node.serve("/arm", SET_BOOL, lambda request: cdr(f"{SET_BOOL}_Response", success=True, message=""))


@pytest.mark.medium
def test_idle_persistent_calls_lock_nobody_out(nodes: Callable[[str], TcprosMiddleware]) -> None:
    node = nodes("xitl")
    serve_arm(node)
    idle = []
    for _ in range(300):
        idle.append(persistent_call(node))
        receive_header(idle[-1])
    replies: list[bytes] = []

    def call() -> None:
        with persistent_call(node) as client:
            assert "error" not in receive_header(client)
            client.sendall(block(b"\x01"))
            replies.append(client.recv(1))

    caller = threading.Thread(target=call)
    caller.start()
    wait(lambda: replies, node)
    caller.join()
    assert replies == [b"\x01"]
    assert node.losses().refused == {"connections": 301 - middleware_module.MOST_OF_HOST}
    assert any("longest idle one" in problem for problem in node.problems())
    for each in idle:
        each.close()


def test_an_idle_persistent_call_ends_and_is_counted(
    nodes: Callable[[str], TcprosMiddleware], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(middleware_module, "IDLE_S", 0.05)
    node = nodes("xitl")
    serve_arm(node)
    with persistent_call(node) as client:
        receive_header(client)
        assert client.recv(1) == b""  # closed
    wait(lambda: node.losses().refused == {"/arm": 1})
    assert any("idle for too long" in problem for problem in node.problems())


def test_a_node_that_is_not_listed_may_not_command(master: FakeMaster) -> None:
    commanded = TcprosMiddleware(RosSpec(master=master.uri, commanders=("/helm",)), "xitl")
    helm, stranger = (TcprosMiddleware(RosSpec(master=master.uri), name) for name in ("helm", "stranger"))
    got: list[float] = []
    try:
        commanded.subscribe("/thrust", FLOAT, RELIABLE, lambda data: got.append(deserialize(data, FLOAT).data))
        serve_arm(commanded)
        publish = [node.advertise("/thrust", FLOAT, RELIABLE) for node in (helm, stranger)]
        wait(lambda: commanded.losses().refused.get("/thrust") and helm.connections())
        of_helm, of_stranger = publish
        of_stranger(cdr(FLOAT, data=1.0))
        wait(lambda: got or of_helm(cdr(FLOAT, data=0.0)), commanded)  # news of the master may renew a connection
        with persistent_call(commanded, "/stranger") as client:
            assert "ros.commanders" in receive_header(client)["error"]
        with persistent_call(commanded, "/helm") as client:
            assert "error" not in receive_header(client)
        commanded.spin(0.0)
        assert set(got) == {0.0}
        assert {*commanded.losses().refused} == {"/thrust", "/arm"}
    finally:
        for node in (commanded, helm, stranger):
            node.close()


@pytest.mark.medium
def test_idle_connections_to_the_slave_api_lock_nobody_out_and_are_few(
    nodes: Callable[[str], TcprosMiddleware], master: FakeMaster
) -> None:
    node = nodes("xitl")
    node.advertise("/pose", "std_msgs/msg/String", QosProfile())
    wait(lambda: master.nodes)
    (uri,) = master.nodes.values()
    place = urlsplit(uri)
    too_many = 20
    count = slave_module.MOST_CONNECTIONS + too_many
    idle = [socket.create_connection((place.hostname, place.port), PATIENCE_S) for _ in range(count)]
    assert ServerProxy(uri).getPid("/helm")[0] == 1
    for end in idle[:too_many]:
        end.settimeout(PATIENCE_S / 2)
        assert end.recv(1) == b""  # closed
    for end in idle:
        end.close()
