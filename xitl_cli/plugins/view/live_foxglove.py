"""Live connection to Foxglove: the recorder's channels over a WebSocket, and operator actions from its panels.

Services `/operator/<action>` take an action's keys as JSON. Parameters are the pace and the environment. Clients may
publish an action on `/operator/ask`, a pose on `/goal` and a point on `/clicked_point`. foxglove-sdk serves from
separate threads and drops the oldest messages of a slow client. Requests for actions wait until the run polls them.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

from sim_core.keys import Bounds, Specification, alternatives, key_annotations, meaning_of, optional, required_keys
from xitl_cli.plugins.view.live_gate import Gate, hidden_host
from xitl_cli.plugins.view.server import listen
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.core.live_output import LiveOutput, LiveRun
from xitl_cli.run.core.node import RunNode, RunStep
from xitl_cli.run.nodes.operator import OperatorNode
from xitl_cli.run.operator.actions import ENVIRONMENT, GROUPS, ActionError

if TYPE_CHECKING:
    from foxglove.websocket import (
        ChannelView,
        Client,
        ClientChannel,
        Parameter,
        PlaybackControlRequest,
        ServiceRequest,
        WebSocketServer,
    )

SOURCE = "foxglove"
HOST = "127.0.0.1"
USUAL_PORT = 8765
READ_ONLY = "clients can only read in this run; start it with --live-commands to let them act"
BACKLOG = 256
"""Maximum number of queued messages per client before the oldest is dropped: 50 MB for clouds of 200 kB."""
TIME_RATE_HZ = 20.0
ANSWER_S = 5.0
KEPT = ("/scene",)
"""Topics that are sent once, and again to each later subscriber."""
SERVICE, ASK = "/operator/", "/operator/ask"
GOALS, POINT = ("/goal", "/goal_pose", "/move_base_simple/goal"), "/clicked_point"
UNLIMITED = 0.0
"""Pace of a run that is as fast as possible."""
ENDED = "the run has ended"


class LiveFoxgloveNode(RunNode):
    """Foxglove server of a run. It mirrors the recording, see McapFile.

    port: port on this machine; None for the usual one or a free one. tell: prints the address. commands: clients may
    act. Otherwise, the server offers no services, parameters or publications.

    `prepare` raises UserError if a given port is taken.
    """

    def __init__(self, title: str, port: int | None, tell: Callable[[str], object], commands: bool = False) -> None:
        self._commands = commands
        self._gate: Gate | None = None
        self._title = title
        self._requested_port = port
        self._tell = tell
        self._operator: OperatorNode | None = None
        self._context: Any = None
        self._server: WebSocketServer | None = None
        self._requests: deque[tuple[Mapping[str, Any], Future[str | None]]] = deque()
        """Actions that wait for the run's own thread, each with its refusal."""
        self._subscribed: deque[str] = deque()
        """Topics of `KEPT` with a new subscriber."""
        self._kept: dict[str, tuple[Any, list[tuple[bytes, int]]]] = {}
        self._values: dict[str, Any] = {}
        self._clients: set[int] = set()
        self._port = 0
        self._now_ns = 0
        self._time_s = 0.0
        self._actions = self._refused = self._refused_connections = 0

    def attach_operator(self, operator: OperatorNode) -> None:
        """Set the operator that carries out the actions."""
        self._operator = operator
        operator.listen(self.poll)

    def prepare(self) -> None:
        import foxglove
        from foxglove.websocket import Capability

        self._context = foxglove.Context()
        listener, address = listen(HOST, self._requested_port, "live.host", "live.port", USUAL_PORT)
        acting = [Capability.Parameters, Capability.Services, Capability.ClientPublish]
        inner = hidden_host()
        try:
            self._server = foxglove.start_server(
                name=f"xitl {self._title}",
                host=inner,
                port=0,
                context=self._context,
                capabilities=[Capability.Time, *(acting if self._commands else ())],
                supported_encodings=["json"] if self._commands else None,
                services=list(self._services()) if self._commands else None,
                server_listener=_Listener(self),
                message_backlog_size=BACKLOG,
            )
        except (OSError, RuntimeError):
            listener.close()
            raise
        self._gate = Gate(listener, address, (inner, self._server.port))
        self._port = address.port
        moved = "" if address.moved is None else f" (port {address.moved} is taken)"
        acts = "" if self._commands else " (read-only: --live-commands lets clients act)"
        self._tell(f"foxglove: ws://{HOST}:{address.port}/?token={address.token}{acts}{moved}")

    def mirror(self) -> LiveFoxgloveNode:
        return self

    def open_channel(
        self, topic: str, encoding: str, schema_name: str, schema_encoding: str, definition: bytes
    ) -> Callable[[bytes, int], object]:
        """Open a channel as in the recording. Return a function that sends a payload with its stamp in ns."""
        import foxglove

        schema = foxglove.Schema(name=schema_name, encoding=schema_encoding, data=definition)
        channel = foxglove.Channel(topic, message_encoding=encoding, schema=schema, context=self._context)
        log = channel.log
        if topic not in KEPT:
            return lambda payload, stamp_ns: log(payload, log_time=stamp_ns)
        sent: list[tuple[bytes, int]] = []
        self._kept[topic] = log, sent

        def keep(payload: bytes, stamp_ns: int) -> None:
            sent.append((payload, stamp_ns))
            log(payload, log_time=stamp_ns)

        return keep

    def exchange(self, step: RunStep) -> None:
        self._now_ns = step.now_ns
        self._send_time_and_parameters()

    def _send_time_and_parameters(self) -> None:
        """Send the time, and the parameters that changed since the last call, at `TIME_RATE_HZ`."""
        now_s = time.monotonic()
        if self._server is None or now_s - self._time_s < 1.0 / TIME_RATE_HZ:
            return
        self._time_s = now_s
        self._server.broadcast_time(self._now_ns)
        values = self.parameters()
        if values != self._values:
            changed = {name: value for name, value in values.items() if self._values.get(name, _UNKNOWN) != value}
            self._values = values
            self._server.publish_parameter_values(as_parameters(changed))

    def poll(self) -> None:
        """Pass waiting actions to the operator. Send the messages of `KEPT` topics again to new subscribers."""
        while self._subscribed:
            log, sent = self._kept[self._subscribed.popleft()]
            for payload, stamp_ns in sent:
                log(payload, log_time=stamp_ns)
        while self._requests:
            action, answer = self._requests.popleft()
            self._actions += 1
            refusal: str | None = "this run accepts no actions"
            if self._operator is not None:
                refusal = self._operator.ask(action, SOURCE)
                self._refused += refusal is not None
            answer.set_result(refusal)
        self._send_time_and_parameters()  # otherwise, changes just before a pause would wait

    def close(self) -> None:
        server, self._server = self._server, None
        while self._requests:  # a waiting thread would delay the end of the server
            self._requests.popleft()[1].set_result(ENDED)
        gate, self._gate = self._gate, None
        if gate is not None:
            gate.close()
            self._refused_connections = gate.refused
        if server is not None:
            server.stop()

    def report(self) -> dict[str, Any]:
        """Return `live`: address without the token, number of clients, refused connections, actions and refusals.

        `dropped` is null, because foxglove-sdk does not count the messages that slow clients lost.
        """
        return {
            "live": {
                "address": f"ws://{HOST}:{self._port}",
                "clients": len(self._clients),
                "refused_connections": self._refused_connections if self._gate is None else self._gate.refused,
                "dropped": None,
                "actions": self._actions,
                "refused": self._refused,
            }
        }

    # Called in threads of the server

    def ask(self, action: Mapping[str, Any]) -> str | None:
        """Pass an action to the run and wait. Return the refusal, None if the run accepts it."""
        try:
            return self.post(action).result(ANSWER_S)
        except TimeoutError:
            return f"the run did not answer within {ANSWER_S:g} s"

    def post(self, action: Mapping[str, Any]) -> Future[str | None]:
        """Pass an action to the run without waiting. Return its later refusal."""
        answer: Future[str | None] = Future()
        if not self._commands:
            answer.set_result(READ_ONLY)
        elif self._server is None:
            answer.set_result(ENDED)
        else:
            self._requests.append((action, answer))
        return answer

    def warn(self, text: str | None) -> None:
        """Send a warning to all clients, unless it is None."""
        from foxglove.websocket import StatusLevel

        server = self._server
        if text is not None and server is not None:
            server.publish_status(text, StatusLevel.Warning)

    def register(self, client: int, topic: str | None = None) -> None:
        """Register a client that is active or subscribes to a topic."""
        self._clients.add(client)
        if topic in self._kept:
            self._subscribed.append(topic)

    def _services(self) -> Iterator[Any]:
        from foxglove import Schema, Service
        from foxglove.websocket import MessageSchema, ServiceSchema

        def shaped(name: str, schema: Mapping[str, Any]) -> Any:
            return MessageSchema(
                encoding="json", schema=Schema(name=name, encoding="jsonschema", data=json.dumps(schema).encode())
            )

        answer = shaped("xitl.Answer", _ANSWER)
        for action, group in GROUPS.items():
            named = f"xitl.{action.capitalize()}"
            schema = ServiceSchema(named, request=shaped(named, json_schema(group)), response=answer)
            yield Service(f"{SERVICE}{action}", schema=schema, handler=self._serve)

    def _serve(self, request: ServiceRequest) -> bytes:
        """Return the answer of a service. A refusal is a normal answer, so that a panel shows it."""
        name = request.service_name.removeprefix(SERVICE)
        try:
            keys = json.loads(request.payload or b"{}")
        except (ValueError, RecursionError) as error:
            refusal: str | None = f"{name}: is not JSON ({error})"
        else:
            refusal = f"{name}: write its keys as a JSON object, such as {{}}"
            if isinstance(keys, dict):
                refusal = self.ask({"action": name, **keys})
        return json.dumps({"success": refusal is None, "message": refusal or ""}).encode()

    # Parameters

    def parameters(self) -> dict[str, Any]:
        """Return the parameters that clients can set, by the names of the profile's keys."""
        operator = self._operator
        if operator is None or not self._commands:
            return {}
        values: dict[str, Any] = {"paused": operator.paused, "pace": operator.factor or UNLIMITED}
        for group in ENVIRONMENT:
            values.update(_flat(f"environment.{group}", getattr(operator.environment, group)))
        return values

    def set_parameter(self, name: str, value: Any) -> str | None:
        """Set a parameter. Return the refusal, None if the run accepts it."""
        if name not in self.parameters():
            return f"{name} is not a parameter; use {', '.join(self.parameters())}"
        if name == "paused":
            return self.ask({"action": "pause" if value else "resume"})
        if name == "pace":
            return self.ask({"action": "pace", "factor": value or None})
        _, group, *path = name.split(".")
        for key in reversed(path):
            value = {key: value}
        return self.ask({"action": group, **value})


_UNKNOWN = object()
_ANSWER = {
    "type": "object",
    "properties": {"success": {"type": "boolean"}, "message": {"type": "string", "description": "why it was refused"}},
}
_JSON_TYPES = {bool: "boolean", int: "integer", float: "number", str: "string"}


def as_parameters(values: Mapping[str, Any]) -> list[Parameter]:
    """Return the values as parameters of foxglove-sdk."""
    from foxglove.websocket import Parameter

    return [Parameter(name, value=value) for name, value in values.items()]


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield names and values of all scalars in a group and its subgroups."""
    if isinstance(value, Specification):
        group: Any = type(value)
        for key in key_annotations(group):
            yield from _flat(f"{name}.{key}", getattr(value, key))
    elif isinstance(value, (bool, int, float, str)):
        yield name, value


def json_schema(group: Any) -> dict[str, Any]:
    """Return the JSON schema of an action's keys, with types, bounds and meanings of the specification."""
    properties = {name: _property(annotation) for name, annotation in key_annotations(group).items()}
    needed = list(required_keys(group))
    return {"type": "object", "properties": properties, **({"required": needed} if needed else {})}


def _property(annotation: Any) -> dict[str, Any]:
    from typing import Literal, get_args, get_origin

    kind, markers = alternatives(annotation)[0]
    schema: dict[str, Any] = {"type": "array"}
    if isinstance(kind, type) and issubclass(kind, Specification):
        return json_schema(kind)
    if get_origin(kind) is Literal:
        schema = {"type": "string", "enum": list(get_args(kind))}
    elif kind in _JSON_TYPES:
        name = _JSON_TYPES[kind]
        schema = {"type": [name, "null"] if optional(annotation) else name}
    for bounds in (marker for marker in markers if isinstance(marker, Bounds)):
        if bounds.at_least is not None:
            schema["minimum"] = bounds.at_least
        if bounds.at_most is not None:
            schema["maximum"] = bounds.at_most
    if meaning := meaning_of(annotation):
        schema["description"] = meaning
    return schema


class _Listener:
    """Callbacks of foxglove-sdk about clients. They run in its threads."""

    def __init__(self, node: LiveFoxgloveNode) -> None:
        self._node = node
        self._published: dict[tuple[int, int], str] = {}

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self._node.register(client.id, channel.topic)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        pass

    def on_client_advertise(self, client: Client, channel: ClientChannel) -> None:
        self._node.register(client.id)
        if channel.topic not in (ASK, POINT, *GOALS):
            self._node.warn(f"the run does not use {channel.topic}; publish on {', '.join((ASK, *GOALS, POINT))}")
        self._published[client.id, channel.id] = channel.topic

    def on_client_unadvertise(self, client: Client, client_channel_id: int) -> None:
        self._published.pop((client.id, client_channel_id), None)

    def on_message_data(self, client: Client, client_channel_id: int, data: bytes) -> None:
        topic = self._published.get((client.id, client_channel_id), "")
        try:
            action = action_from_message(topic, data)
        except ActionError as error:
            self._node.warn(str(error))
            return
        if action is not None:
            self._node.post(action).add_done_callback(lambda answer: self._node.warn(answer.result()))

    def on_get_parameters(
        self, client: Client, param_names: list[str], request_id: str | None = None
    ) -> list[Parameter]:
        self._node.register(client.id)
        values = self._node.parameters()
        return as_parameters({name: values[name] for name in param_names or values if name in values})

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """Set the parameters and return their current values. A refused parameter keeps its value."""
        self._node.register(client.id)
        before = self._node.parameters()
        for parameter in parameters:
            value = parameter.get_value()
            if before.get(parameter.name, _UNKNOWN) != value:
                self._node.warn(self._node.set_parameter(parameter.name, value))
        values = self._node.parameters()
        return as_parameters({item.name: values[item.name] for item in parameters if item.name in values})

    def on_parameters_subscribe(self, param_names: list[str]) -> None:
        pass

    def on_parameters_unsubscribe(self, param_names: list[str]) -> None:
        pass

    def on_connection_graph_subscribe(self) -> None:
        pass

    def on_connection_graph_unsubscribe(self) -> None:
        pass

    def on_playback_control_request(self, playback_control_request: PlaybackControlRequest) -> None:
        pass


def action_from_message(topic: str, data: bytes) -> Mapping[str, Any] | None:
    """Return a client's message, which is JSON, as an action, None for an unused topic.

    A pose or a point is in the map, x east and y north, as Foxglove's 3D panel publishes it. Raises ActionError for a
    message that does not fit the topic.
    """
    try:
        message = json.loads(data)
        if topic == ASK:
            if not isinstance(message, dict):
                raise TypeError("an action is a JSON object")
            return message
        if topic in GOALS:
            place = message["pose"]["position"] if "pose" in message else message["position"]
            return {"action": "goto", "north_m": float(place["y"]), "east_m": float(place["x"])}
        if topic == POINT:
            place = message.get("point", message)
            return {"action": "launch", "kind": "trunk", "north_m": float(place["y"]), "east_m": float(place["x"])}
        return None
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise ActionError(f"{topic}: invalid message ({error!r}); publish JSON of the topic's usual schema") from error


class FoxgloveOutput(LiveOutput):
    """Foxglove as a live output of a run."""

    def __init__(self, profiles: Sequence[RunProfile]) -> None:
        self._lead = profiles[0]

    def world_nodes(self, run: LiveRun) -> Sequence[RunNode]:
        live = self._lead.live
        return [LiveFoxgloveNode(self._lead.name, live.port, run.tell, live.commands)]
