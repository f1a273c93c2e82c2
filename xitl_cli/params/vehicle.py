"""A live vehicle's parameters, by the MAVLink parameter protocol."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from agent.wire import dialect
from agent.wire.link import Link
from agent.wire.signing import Signing
from agent.wire.transport import Transport, TransportError, open_transport
from xitl_cli.errors import UserError
from xitl_cli.params.text import same

SYSTEM_ID = 254  # not a ground station's 255: coming and going must not look like one that was lost
COMPONENT_ID = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
CONNECT_S = 8.0
HEARTBEAT_S = 0.5
QUIET_S = 1.0
ROUNDS = 6
BATCH = 20
ANSWER_S = 1.0
TRIES = 4
REASON_S = 0.3
BYTEWISE_AUTOPILOTS = {12: "PX4"}
LOCAL_HOSTS = ("127.0.0.1", "0.0.0.0", "localhost", "[::1]", "[::]")


@dataclass(frozen=True, slots=True)
class Answer:
    """What a vehicle said to a new value: what it now keeps (None when it did not answer) and its own words."""

    kept: float | None
    texts: tuple[str, ...] = ()

    def took(self, value: float) -> bool:
        """Whether it keeps what was asked for."""
        return self.kept is not None and same(self.kept, value)


@contextmanager
def connected(url: str, key: bytes | None = None, wait_s: float | None = None) -> Iterator[Vehicle]:
    """The vehicle at `url`, heard and ready to be asked. Raises UserError when none is there.

    `serial:///dev/…` opens a line, `tcp://host:port` connects. `udp://host:port` waits for the vehicle where the host
    is this machine, as a ground station does, and goes to it elsewhere; `udpin://` and `udpout://` say which.
    """
    plain, listen = _direction(url)
    try:
        transport = open_transport(plain, listen)
    except TransportError as error:
        raise UserError(str(error)) from error
    with transport:
        vehicle = Vehicle(transport, url, None if key is None else Signing(key))
        vehicle.wait_for_it(CONNECT_S if wait_s is None else wait_s)
        yield vehicle


class Vehicle:
    """One vehicle, the first whose heartbeat is heard. Everything raises UserError when it falls silent.

    kind: its MAV_TYPE.
    """

    def __init__(self, transport: Transport, url: str, signing: Signing | None) -> None:
        self._link = Link(transport, SYSTEM_ID, COMPONENT_ID, signing=signing)
        self._url = url
        self._target: tuple[int, int] | None = None
        self.kind = 0
        self._beat_s = -HEARTBEAT_S
        self._types: dict[str, int] = {}
        self._texts: deque[str] = deque(maxlen=20)
        self._text_id = 0

    def wait_for_it(self, timeout_s: float) -> None:
        """Until an autopilot's heartbeat is heard."""
        deadline_s = time.monotonic() + timeout_s
        while self._target is None:
            if time.monotonic() > deadline_s:
                raise self._nobody(timeout_s)
            for message in self._receive(0.1):
                if message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT and _is_vehicle(message):
                    if message.autopilot in BYTEWISE_AUTOPILOTS:
                        name = BYTEWISE_AUTOPILOTS[message.autopilot]
                        raise UserError(f"{self._url}: is a {name} vehicle; only ArduPilot's parameters can be read")
                    self._target = (message.get_srcSystem(), message.get_srcComponent())
                    self.kind = int(message.type)
                    break

    def read_all(self) -> dict[str, float]:
        """Every parameter by name, in the vehicle's order. What gets lost is asked for again, some at a time."""
        assert self._target is not None
        found: dict[int, tuple[str, float]] = {}
        count: int | None = None
        fruitless = 0
        while fruitless < ROUNDS:
            if count is None:
                wanted: list[int] = []
                self._link.send(dialect.MAVLink_param_request_list_message(*self._target))
            else:
                wanted = [index for index in range(count) if index not in found][:BATCH]
                if not wanted:
                    return {name: value for _, (name, value) in sorted(found.items())}
                for index in wanted:
                    self._link.send(dialect.MAVLink_param_request_read_message(*self._target, b"", index))
            before, heard_s = len(found), time.monotonic()
            while time.monotonic() - heard_s < QUIET_S and len(found) != count:
                if wanted and all(index in found for index in wanted):
                    break
                for message in self._values(0.05):
                    heard_s = time.monotonic()
                    if message.param_index < message.param_count:
                        count, name = message.param_count, _name(message)
                        found[message.param_index] = (name, message.param_value)
                        self._types[name] = message.param_type
            fruitless = 0 if len(found) > before else fruitless + 1
        if count is None:
            raise UserError(f"{self._url}: the vehicle sends no parameters; check that it takes MAVLink 2 commands")
        raise UserError(f"{self._url}: only {len(found)} of {count} parameters came; the link loses too much")

    def read(self, name: str) -> float | None:
        """One parameter, None when the vehicle does not answer for it."""
        assert self._target is not None
        message = dialect.MAVLink_param_request_read_message(*self._target, name.encode("ascii", "replace"), -1)
        answer = self._ask(message, name)
        if answer is None:
            return None
        self._types[name] = answer.param_type
        return float(answer.param_value)

    def set(self, name: str, value: float) -> Answer:
        """Set one parameter and hear what it is now."""
        assert self._target is not None
        self._texts.clear()
        kind = self._types.get(name, dialect.MAV_PARAM_TYPE_REAL32)
        answer = self._ask(
            dialect.MAVLink_param_set_message(*self._target, name.encode("ascii", "replace"), value, kind), name
        )
        kept = None if answer is None else float(answer.param_value)
        if kept is None or not same(kept, value):
            deadline_s = time.monotonic() + REASON_S
            while time.monotonic() < deadline_s:
                self._receive(0.05)
        return Answer(kept, tuple(text for text in self._texts if name in text) or tuple(self._texts))

    @property
    def texts(self) -> tuple[str, ...]:
        """What it said lately."""
        return tuple(self._texts)

    @property
    def target(self) -> tuple[int, int]:
        """Its system and component."""
        assert self._target is not None
        return self._target

    def send(self, message: Any) -> bool:
        """Send a message of the dialect."""
        return self._link.send(message)

    def receive(self, timeout_s: float) -> list[Any]:
        """What it has said, waiting for it at most `timeout_s`."""
        return [
            message
            for message in self._receive(timeout_s)
            if (message.get_srcSystem(), message.get_srcComponent()) == self._target
        ]

    def command(self, number: int, *values: float) -> int | None:
        """A MAV_CMD with its parameters: the MAV_RESULT, None when it does not answer."""
        padded = (*values, *(0.0 for _ in range(7 - len(values))))
        for repeat in range(TRIES):
            self._link.send(dialect.MAVLink_command_long_message(*self.target, number, repeat, *padded))
            deadline_s = time.monotonic() + ANSWER_S
            while time.monotonic() < deadline_s:
                for message in self.receive(0.05):
                    if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_ACK and message.command == number:
                        return int(message.result)
        return None

    def request(self, number: int) -> Any:
        """One message of that number, None when it does not come."""
        for _ in range(TRIES):
            self._link.send(
                dialect.MAVLink_command_long_message(
                    *self.target, dialect.MAV_CMD_REQUEST_MESSAGE, 0, number, 0, 0, 0, 0, 0, 0
                )
            )
            deadline_s = time.monotonic() + ANSWER_S
            while time.monotonic() < deadline_s:
                for message in self.receive(0.05):
                    if message.get_msgId() == number:
                        return message
        return None

    def _ask(self, message: Any, name: str) -> Any:
        for _ in range(TRIES):
            self._link.send(message)
            deadline_s = time.monotonic() + ANSWER_S
            while time.monotonic() < deadline_s:
                for answer in self._values(0.05):
                    if _name(answer) == name:
                        return answer
        return None

    def _values(self, timeout_s: float) -> list[Any]:
        """PARAM_VALUEs of the vehicle."""
        return [
            message
            for message in self._receive(timeout_s)
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_PARAM_VALUE
            and (message.get_srcSystem(), message.get_srcComponent()) == self._target
        ]

    def _receive(self, timeout_s: float) -> list[Any]:
        now_s = time.monotonic()
        if now_s - self._beat_s >= HEARTBEAT_S:
            self._beat_s = now_s
            self._link.send(
                dialect.MAVLink_heartbeat_message(
                    dialect.MAV_TYPE_ONBOARD_CONTROLLER,
                    dialect.MAV_AUTOPILOT_INVALID,
                    0,
                    0,
                    dialect.MAV_STATE_ACTIVE,
                    3,
                )
            )
        messages = self._link.receive(timeout_s)
        for message in messages:
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_STATUSTEXT:
                self._note_text(message)
        return messages

    def _note_text(self, message: Any) -> None:
        """A sentence of more than 50 bytes comes in chunks with one number."""
        text, number = _text(message.text), getattr(message, "id", 0)
        if number and number == self._text_id and self._texts:
            self._texts[-1] += text
        else:
            self._texts.append(text)
        self._text_id = number

    def _nobody(self, waited_s: float) -> UserError:
        if self._link.refused_signature:
            return UserError(f"{self._url}: what is heard there is not signed with this key; check --signing-key")
        return UserError(
            f"{self._url}: no vehicle was heard for {waited_s:.0f} s; check that it runs and "
            "that its ground-station address leads here (docs/ground-stations.md)"
        )


def _direction(url: str) -> tuple[str, bool]:
    """The URL for the transport, and whether to wait there."""
    scheme, separator, place = url.partition("://")
    if scheme in ("udpin", "udpout"):
        return f"udp{separator}{place}", scheme == "udpin"
    if scheme == "udp":
        return url, place.rpartition(":")[0] in LOCAL_HOSTS
    if scheme not in ("tcp", "serial"):
        raise UserError(
            f"{url}: is no address of a vehicle; write tcp://host:port, udp://host:port or serial:///dev/ttyACM0"
        )
    return url, False


def _is_vehicle(heartbeat: Any) -> bool:
    return bool(heartbeat.autopilot != dialect.MAV_AUTOPILOT_INVALID and heartbeat.type != dialect.MAV_TYPE_GCS)


def _name(message: Any) -> str:
    return _text(message.param_id)


def _text(raw: bytes | str) -> str:
    return (raw if isinstance(raw, str) else raw.decode("utf-8", "replace")).partition("\0")[0]
