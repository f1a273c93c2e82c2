"""The connection to Foxglove: what its clients may ask a run for, and what they get. No client connects here."""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Annotated, Any, Literal, cast

import pytest

from sim_core.dataclass import dataclass
from sim_core.keys import Bounds, Required, Specification
from xitl_cli.errors import UserError
from xitl_cli.plugins.view import live_foxglove
from xitl_cli.plugins.view.live_foxglove import (
    ASK,
    ENDED,
    KEPT,
    READ_ONLY,
    FoxgloveOutput,
    LiveFoxgloveNode,
    _Listener,
    action_from_message,
    json_schema,
)
from xitl_cli.profile import load_profile
from xitl_cli.run.operator.actions import GROUPS, ActionError

foxglove = pytest.importorskip("foxglove")


class Server:
    """Stands in for the server of foxglove-sdk."""

    port = 1

    def __init__(self) -> None:
        self.times_ns: list[int] = []
        self.published: list[dict[str, Any]] = []
        self.warnings: list[str] = []
        self.stopped = False

    def broadcast_time(self, now_ns: int) -> None:
        self.times_ns.append(now_ns)

    def publish_parameter_values(self, parameters: list[Any]) -> None:
        self.published.append({item.name: item.get_value() for item in parameters})

    def publish_status(self, text: str, level: object) -> None:
        self.warnings.append(text)

    def stop(self) -> None:
        self.stopped = True


class Operator:
    """Stands in for the run's operator, which refuses to launch."""

    paused, factor = False, 2.0
    environment = load_profile("sitl").environment

    def __init__(self) -> None:
        self.asked: list[tuple[Mapping[str, Any], str]] = []
        self.listeners: list[Any] = []

    def listen(self, poll: Any) -> None:
        self.listeners.append(poll)

    def ask(self, action: Mapping[str, Any], source: str) -> str | None:
        self.asked.append((action, source))
        return "no room" if action["action"] == "launch" else None


class Live:
    """A node with commands, between a server and an operator of the test."""

    def __init__(self, commands: bool = True) -> None:
        self.server, self.operator = Server(), Operator()
        self.node = LiveFoxgloveNode("boat", None, lambda text: None, commands)
        self.node.attach_operator(cast(Any, self.operator))
        self.node._server = cast(Any, self.server)
        self.listener = _Listener(self.node)

    def during_a_run(self, call: Any) -> Any:
        """The result of a call in a thread of the server, while the run polls."""
        results: list[Any] = []
        thread = threading.Thread(target=lambda: results.append(call()))
        thread.start()
        while thread.is_alive():
            self.operator.listeners[0]()
        return results[0]


CLIENT = cast(Any, SimpleNamespace(id=4))


def channel(topic: str, number: int = 9) -> Any:
    return SimpleNamespace(topic=topic, id=number)


# -- messages of clients


POSE = {"position": {"x": 3.0, "y": 4.0, "z": 9.0}}


@pytest.mark.parametrize("topic", ["/goal", "/goal_pose", "/move_base_simple/goal"])
@pytest.mark.parametrize("message", [POSE, {"pose": POSE}])
def test_a_pose_in_the_map_is_a_goal(topic: str, message: Any) -> None:
    goal = action_from_message(topic, json.dumps(message).encode())
    assert goal == {"action": "goto", "north_m": 4.0, "east_m": 3.0}


@pytest.mark.parametrize("message", [{"x": 3, "y": 4}, {"point": {"x": 3, "y": 4}, "header": {}}])
def test_a_clicked_point_launches_a_trunk(message: Any) -> None:
    launch = action_from_message("/clicked_point", json.dumps(message).encode())
    assert launch == {"action": "launch", "kind": "trunk", "north_m": 4.0, "east_m": 3.0}


def test_an_action_is_passed_on_as_it_is_and_other_topics_are_not_used() -> None:
    assert action_from_message(ASK, b'{"action": "wind", "mean_mps": 6}') == {"action": "wind", "mean_mps": 6}
    assert action_from_message("/chatter", b'{"action": "wind"}') is None


@pytest.mark.parametrize(
    ("topic", "data"),
    [
        (ASK, b"[]"),
        (ASK, b"{"),
        ("/goal", b"{}"),
        ("/goal", b'{"pose": {}}'),
        ("/goal", b"7"),
        ("/goal", b'{"position": {"x": "a", "y": 1}}'),
        ("/clicked_point", b"[]"),
        ("/clicked_point", b'{"point": null}'),
        (ASK, b"[" * 100_000),
    ],
)
def test_a_message_that_does_not_fit_its_topic_is_refused(topic: str, data: bytes) -> None:
    with pytest.raises(ActionError, match=rf"^{topic}: invalid message \(.*\); publish JSON of the topic's usual"):
        action_from_message(topic, data)


def test_what_clients_publish_is_asked_for_and_refusals_are_told_to_them() -> None:
    live = Live()
    live.listener.on_client_advertise(CLIENT, channel("/goal", 1))
    live.listener.on_client_advertise(CLIENT, channel("/clicked_point", 2))
    live.listener.on_message_data(CLIENT, 1, json.dumps(POSE).encode())
    live.listener.on_message_data(CLIENT, 2, b'{"x": 3, "y": 4}')
    live.node.poll()
    assert live.operator.asked == [
        ({"action": "goto", "north_m": 4.0, "east_m": 3.0}, "foxglove"),
        ({"action": "launch", "kind": "trunk", "north_m": 4.0, "east_m": 3.0}, "foxglove"),
    ]
    assert live.server.warnings == ["no room"]
    live.listener.on_message_data(CLIENT, 2, b"[]")
    assert "/clicked_point: invalid message" in live.server.warnings[-1]
    report = live.node.report()["live"]
    assert (report["actions"], report["refused"], report["clients"], report["dropped"]) == (2, 1, 1, None)


def test_a_topic_that_the_run_does_not_use_is_told_at_once() -> None:
    live = Live()
    live.listener.on_client_advertise(CLIENT, channel("/cmd_vel"))
    assert live.server.warnings == [
        "the run does not use /cmd_vel; publish on /operator/ask, /goal, /goal_pose, /move_base_simple/goal, "
        "/clicked_point"
    ]
    live.listener.on_message_data(CLIENT, 9, b"{}")
    live.listener.on_client_advertise(CLIENT, channel("/goal", 9))
    live.listener.on_client_unadvertise(CLIENT, 9)
    live.listener.on_client_unadvertise(CLIENT, 9)
    live.listener.on_message_data(CLIENT, 9, json.dumps(POSE).encode())
    live.node.poll()
    assert live.operator.asked == []
    assert len(live.server.warnings) == 1


# -- services


def request(action: str, payload: bytes) -> Any:
    return SimpleNamespace(service_name=f"/operator/{action}", payload=payload)


def served(live: Live, action: str, payload: bytes) -> Any:
    return json.loads(live.during_a_run(lambda: live.node._serve(request(action, payload))))


def test_a_service_asks_the_run_and_answers_with_its_refusal() -> None:
    live = Live()
    assert served(live, "wind", b'{"mean_mps": 6}') == {"success": True, "message": ""}
    assert served(live, "pause", b"") == {"success": True, "message": ""}
    assert served(live, "launch", b"{}") == {"success": False, "message": "no room"}
    assert [action for action, _ in live.operator.asked] == [
        {"action": "wind", "mean_mps": 6},
        {"action": "pause"},
        {"action": "launch"},
    ]
    assert served(live, "wind", b"[1]")["message"] == "wind: write its keys as a JSON object, such as {}"
    assert served(live, "wind", b"{")["message"].startswith("wind: is not JSON (")
    assert len(live.operator.asked) == 3


def test_a_run_that_does_not_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_foxglove, "ANSWER_S", 0.01)
    assert Live().node.ask({"action": "pause"}) == "the run did not answer within 0.01 s"


def test_a_run_without_an_operator_accepts_nothing() -> None:
    live = Live()
    live.node._operator = None
    answer = live.node.post({"action": "pause"})
    live.node.poll()
    assert answer.result(0.0) == "this run accepts no actions"
    assert live.node.parameters() == {}


def test_clients_of_a_run_without_commands_only_read() -> None:
    live = Live(commands=False)
    assert live.node.post({"action": "pause"}).result(0.0) == READ_ONLY
    assert live.node.parameters() == {}
    live.node.poll()
    assert live.operator.asked == []


def test_actions_that_wait_at_the_end_are_answered() -> None:
    live = Live()
    answer = live.node.post({"action": "pause"})
    live.node.close()
    assert answer.result(0.0) == ENDED
    assert live.server.stopped
    assert live.node.post({"action": "pause"}).result(0.0) == ENDED
    live.node.warn("nobody hears it")
    assert live.server.warnings == []


def test_each_action_is_a_service_with_the_schema_of_its_keys() -> None:
    services = {service.name: service for service in LiveFoxgloveNode("boat", None, id, True)._services()}
    assert set(services) == {f"/operator/{action}" for action in GROUPS}
    wind = services["/operator/wind"].schema
    assert wind.name == "xitl.Wind"
    assert json.loads(wind.request.schema.data)["properties"]["mean_mps"]["type"] == "number"
    assert set(json.loads(wind.response.schema.data)["properties"]) == {"success", "message"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Inner(Specification):
    place_m: Annotated[float, Bounds(at_least=0.0, at_most=5.0), Required]
    on: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Outer(Specification):
    inner: Inner
    kind: Literal["a", "b"] = "a"
    number: Annotated[int | None, Bounds(at_least=1), "how many"] = None
    several: tuple[float, ...] = ()
    name: str = ""


def test_a_schema_has_types_bounds_meanings_and_what_is_needed() -> None:
    schema = json_schema(Outer)
    assert schema["properties"] == {
        "inner": {
            "type": "object",
            "properties": {
                "place_m": {"type": "number", "minimum": 0.0, "maximum": 5.0},
                "on": {"type": "boolean"},
            },
            "required": ["place_m"],
        },
        "kind": {"type": "string", "enum": ["a", "b"]},
        "number": {"type": ["integer", "null"], "minimum": 1, "description": "how many"},
        "several": {"type": "array"},
        "name": {"type": "string"},
    }


# -- parameters


def values_of(parameters: list[Any]) -> dict[str, Any]:
    return {item.name: item.get_value() for item in parameters}


def test_parameters_are_the_pace_and_the_scalars_of_the_environment() -> None:
    live = Live()
    values = live.node.parameters()
    environment = live.operator.environment
    assert (values["paused"], values["pace"]) == (False, 2.0)
    assert values["environment.wind.mean_mps"] == environment.wind.mean_mps
    assert values["environment.waves.spectrum"] == environment.waves.spectrum
    assert all(isinstance(value, (bool, int, float, str)) for value in values.values())
    live.operator.factor = cast(Any, None)
    assert live.node.parameters()["pace"] == 0.0
    assert values_of(live.listener.on_get_parameters(CLIENT, ["pace", "none"])) == {"pace": 0.0}
    assert values_of(live.listener.on_get_parameters(CLIENT, [])) == live.node.parameters()
    assert live.node.report()["live"]["clients"] == 1


@pytest.mark.parametrize(
    ("name", "value", "action"),
    [
        ("paused", True, {"action": "pause"}),
        ("paused", False, {"action": "resume"}),
        ("pace", 0.5, {"action": "pace", "factor": 0.5}),
        ("pace", 0.0, {"action": "pace", "factor": None}),
        ("environment.wind.mean_mps", 7.0, {"action": "wind", "mean_mps": 7.0}),
    ],
)
def test_a_parameter_is_set_by_its_action(name: str, value: Any, action: Any) -> None:
    live = Live()
    assert live.during_a_run(lambda: live.node.set_parameter(name, value)) is None
    assert live.operator.asked == [(action, "foxglove")]


def test_a_key_of_a_subgroup_is_set_within_it() -> None:
    live = Live()
    name = next(name for name in live.node.parameters() if name.count(".") == 3)
    _, group, inner, key = name.split(".")
    live.during_a_run(lambda: live.node.set_parameter(name, 1.5))
    assert live.operator.asked == [({"action": group, inner: {key: 1.5}}, "foxglove")]


def test_an_unknown_parameter_is_refused_with_those_that_there_are() -> None:
    live = Live()
    refusal = live.node.set_parameter("speed", 3.0)
    assert refusal is not None
    assert refusal.startswith("speed is not a parameter; use paused, pace, environment.")


def test_a_client_sets_what_differs_and_gets_the_current_values() -> None:
    from foxglove.websocket import Parameter

    live = Live()
    wanted = [Parameter("pace", value=2.0), Parameter("paused", value=True), Parameter("none", value=1.0)]
    answer = live.during_a_run(lambda: live.listener.on_set_parameters(CLIENT, wanted))
    assert values_of(answer) == {"pace": 2.0, "paused": False}  # the operator of this test does not pause
    assert [action for action, _ in live.operator.asked] == [{"action": "pause"}]
    assert len(live.server.warnings) == 1
    assert live.server.warnings[0].startswith("none is not a parameter")


def test_time_is_sent_at_its_rate_and_parameters_when_they_change(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr(live_foxglove, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    live = Live()
    for wall_s, now_ns in ((100.0, 1), (100.04, 2), (100.06, 3), (100.1, 4), (100.2, 5)):
        now_s[0] = wall_s
        if now_ns == 3:
            live.operator.paused = True
        live.node.exchange(cast(Any, SimpleNamespace(now_ns=now_ns)))
    assert live.server.times_ns == [1, 3, 5]
    assert live.server.published[0]["paused"] is False
    assert live.server.published[1:] == [{"paused": True}]
    live.operator.factor = 4.0
    now_s[0] = 101.0
    live.node.poll()
    assert live.server.published[2:] == [{"pace": 4.0}]


# -- channels


class Channel:
    """Stands in for a channel of foxglove-sdk."""

    made: list[Channel]

    def __init__(self, topic: str, *, message_encoding: str, schema: Any, context: Any) -> None:
        self.topic, self.encoding, self.schema = topic, message_encoding, schema
        self.sent: list[tuple[bytes, int]] = []
        Channel.made.append(self)

    def log(self, payload: bytes, *, log_time: int) -> None:
        self.sent.append((payload, log_time))


def test_the_surroundings_are_sent_again_to_each_later_subscriber(monkeypatch: pytest.MonkeyPatch) -> None:
    Channel.made = []
    monkeypatch.setattr(foxglove, "Channel", Channel)
    live = Live()
    assert live.node.mirror() is live.node
    scene = live.node.open_channel(KEPT[0], "protobuf", "foxglove.SceneUpdate", "protobuf", b"scene")
    log = live.node.open_channel("/log", "protobuf", "foxglove.Log", "protobuf", b"log")
    scene(b"first", 1)
    log(b"text", 2)
    scene(b"second", 3)
    kept, other = Channel.made
    assert (kept.schema.name, kept.schema.data, kept.encoding) == ("foxglove.SceneUpdate", b"scene", "protobuf")
    assert (kept.sent, other.sent) == ([(b"first", 1), (b"second", 3)], [(b"text", 2)])
    live.listener.on_subscribe(CLIENT, channel(KEPT[0]))
    live.listener.on_subscribe(CLIENT, channel("/log"))
    live.node.poll()
    live.node.poll()
    assert (kept.sent[2:], len(other.sent)) == ([(b"first", 1), (b"second", 3)], 1)
    live.listener.on_unsubscribe(CLIENT, channel("/log"))
    assert live.node.report()["live"]["clients"] == 1


# -- with the server of foxglove-sdk


def test_the_server_listens_behind_its_token_and_frees_its_port() -> None:
    told: list[str] = []
    node = LiveFoxgloveNode("boat", None, told.append, commands=True)
    node.prepare()
    try:
        (line,) = told
        address = line.split()[1]
        assert address.startswith("ws://127.0.0.1:")
        assert "/?token=" in address
        assert "read-only" not in line
        port = int(address.split(":")[2].partition("/")[0])
        assert node.report()["live"]["address"] == f"ws://127.0.0.1:{port}"
        with pytest.raises(UserError, match=str(port)):
            LiveFoxgloveNode("boat", port, told.append).prepare()
    finally:
        node.close()
    assert node.report()["live"]["refused_connections"] == 0
    again = LiveFoxgloveNode("boat", port, told.append)
    again.prepare()
    again.close()
    assert told[-1].startswith(f"foxglove: ws://127.0.0.1:{port}/?token=")
    assert told[-1].endswith(" (read-only: --live-commands lets clients act)")


def test_the_output_of_a_profile_has_its_port_and_permission() -> None:
    profile = load_profile("sitl", ["live.foxglove=true", "live.commands=true", "live.port=8123"])
    (node,) = FoxgloveOutput([profile.runnable()]).world_nodes(cast(Any, SimpleNamespace(tell=print)))
    assert isinstance(node, LiveFoxgloveNode)
    assert (node._requested_port, node._commands, node._title) == (8123, True, "sitl")


@pytest.mark.medium
def test_a_client_reads_what_the_run_sends() -> None:
    connect = pytest.importorskip("websockets.sync.client").connect
    told: list[str] = []
    node = LiveFoxgloveNode("boat", None, told.append)
    node.prepare()
    try:
        send = node.open_channel("/text", "json", "text", "jsonschema", b"{}")
        with connect(told[0].split()[1], subprotocols=["foxglove.sdk.v1"], proxy=None) as socket:
            operations: dict[str, Any] = {}
            while "advertise" not in operations:
                frame = socket.recv(timeout=10.0)
                if isinstance(frame, str):
                    said = json.loads(frame)
                    operations[said["op"]] = said
            assert operations["serverInfo"]["name"] == "xitl boat"
            assert operations["serverInfo"]["capabilities"] == ["time"]
            (advertised,) = operations["advertise"]["channels"]
            subscription = {"id": 7, "channelId": advertised["id"]}
            socket.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
            until_s = time.monotonic() + 10.0
            while not node.report()["live"]["clients"] and time.monotonic() < until_s:
                time.sleep(0.005)
            send(b'{"a": 1}', 5)
            frame = socket.recv(timeout=10.0)
            while isinstance(frame, str):
                frame = socket.recv(timeout=10.0)
            assert struct.unpack_from("<BIQ", frame) == (1, 7, 5)
            assert frame[13:] == b'{"a": 1}'
    finally:
        node.close()
    assert node.report()["live"]["clients"] == 1
