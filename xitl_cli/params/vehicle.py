"""A live vehicle: its parameters, commands and files, by the MAVLink protocols over one link."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

from agent.assembly import AUTOPILOT_COMPONENT_ID
from agent.mavlink.commands import CommandClient, StatusTextReceiver
from agent.mavlink.exchange import Exchange, Target, complete
from agent.mavlink.ftp import FtpClient, FtpSilentError, FtpSteps
from agent.mavlink.parameters import ParameterClient, same_value
from agent.options import HIGHEST_SYSTEM_ID
from agent.wire import dialect
from agent.wire.link import Link
from agent.wire.signing import Signing
from agent.wire.transport import Transport, TransportError, open_transport
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError

SYSTEM_ID = 254  # not a ground station's 255: a vehicle must not report a lost station when this program ends
COMPONENT_ID = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
CONNECT_S = 8.0
HEARTBEAT_S = 0.5
ANSWER_S = 1.0
TRIES = 4
REASON_S = 0.3
OTHERS_S = 1.2  # every autopilot sends a heartbeat once a second
LOCAL_HOSTS = ("127.0.0.1", "0.0.0.0", "localhost", "[::1]", "[::]")

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class SetResult:
    """A vehicle's answer to a new value."""

    kept: float | None
    """Value that the vehicle now has; None without an answer."""
    texts: tuple[str, ...] = ()
    """Its text messages."""

    def accepts(self, value: float) -> bool:
        """Whether the vehicle has the requested value."""
        return self.kept is not None and same_value(self.kept, value)


@contextmanager
def connect(url: str, key: bytes | None = None, wait_s: float | None = None) -> Iterator[VehicleConnection]:
    """Connect to the vehicle at `url`, after its first heartbeat. Raises UserError when none is there.

    `?system=3` at the end selects one of several, such as at the port of a fleet.

    `serial:///dev/…` opens a line, and `tcp://host:port` connects. `udp://host:port` listens if the host is this
    machine, as a ground station does, and sends to another machine. `udpin://` and `udpout://` select one of them.
    """
    place, wanted = _system_of(url)
    plain, listen = _direction(place)
    try:
        transport = open_transport(plain, listen)
    except TransportError as error:
        raise UserError(str(error)) from error
    with transport:
        vehicle = VehicleConnection(transport, url, None if key is None else Signing(key), wanted)
        vehicle.wait_for_heartbeat(CONNECT_S if wait_s is None else wait_s)
        yield vehicle


class VehicleConnection:
    """One vehicle: the first with a heartbeat, or the vehicle with `system_id`.

    target: its system and component. kind: its MAV_TYPE. px4: whether it is a PX4, which has its own integer encoding.

    Every method waits for the answer, and raises UserError when the vehicle becomes silent.
    """

    def __init__(self, transport: Transport, url: str, signing: Signing | None, system_id: int | None = None) -> None:
        self._wanted = system_id
        self._heard: set[int] = set()
        self._adopted_s = 0.0
        self.kind = 0
        self.px4 = False
        self._link = Link(transport, SYSTEM_ID, COMPONENT_ID, signing=signing)
        self._url = url
        self._target: Target | None = None
        self._beat_s = -HEARTBEAT_S
        self._texts: deque[str] = deque(maxlen=20)
        self._text = StatusTextReceiver()

    def wait_for_heartbeat(self, timeout_s: float) -> None:
        """Wait for the heartbeat of an autopilot."""
        deadline_s = time.monotonic() + timeout_s
        while self._target is None:
            if time.monotonic() > deadline_s:
                raise self._no_heartbeat(timeout_s)
            for message in self._receive(0.1):
                if message.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT or self._target is not None:
                    continue
                is_vehicle = message.autopilot != dialect.MAV_AUTOPILOT_INVALID and message.type != dialect.MAV_TYPE_GCS
                if is_vehicle and self._wanted in (None, message.get_srcSystem()):
                    self._target = (message.get_srcSystem(), message.get_srcComponent())
                    self._adopted_s = time.monotonic()
                    self.kind = int(message.type)
                    self.px4 = message.autopilot == dialect.MAV_AUTOPILOT_PX4
                    self._parameters = ParameterClient(self._target, self.px4, True, TRIES, ANSWER_S)
                    self._commands = CommandClient(self._target, TRIES, ANSWER_S)

    def _settle(self) -> None:
        """Wait until any other vehicle would have sent a heartbeat: before a change, and after a read."""
        while self._wanted is None and (left_s := self._adopted_s + OTHERS_S - time.monotonic()) > 0.0:
            self._receive(left_s)

    @property
    def _all_heard(self) -> str:
        return ", ".join(map(str, sorted(self._heard)))

    @property
    def target(self) -> Target:
        """MAVLink system and component of the vehicle."""
        assert self._target is not None
        return self._target

    @property
    def texts(self) -> tuple[str, ...]:
        """Latest text messages of the vehicle."""
        return tuple(self._texts)

    # -- Parameters

    @property
    def types(self) -> Mapping[str, int]:
        """MAV_PARAM_TYPE by name, of the parameters received so far."""
        return self._parameters.types

    def read_all(self) -> dict[str, float]:
        """Return every parameter by name, in the vehicle's order."""
        request = self._parameters.read_all()
        self._complete(request)
        self._settle()
        if request.count is None:
            raise UserError(f"{self._url}: the vehicle sends no parameters; check that it accepts MAVLink 2 commands")
        if not request.complete:
            raise UserError(
                f"{self._url}: only {len(request.values)} of {request.count} parameters arrived; the link loses too "
                "many frames"
            )
        return request.values

    def read(self, name: str) -> float | None:
        """Return one parameter, or None when the vehicle does not answer."""
        request = self._parameters.read(name)
        self._complete(request)
        return None if request.answer is None else self._parameters.value(request.answer)

    def set(self, name: str, value: float) -> SetResult:
        """Set one parameter and return the vehicle's new value."""
        self._settle()
        self._texts.clear()
        if self.px4 and name not in self.types:
            self.read(name)
        try:
            request = self._parameters.set(name, value)
        except ValueError as error:
            return SetResult(self.read(name), (str(error),))
        self._complete(request)
        kept = None if request.answer is None else self._parameters.value(request.answer)
        if kept is None or not same_value(kept, value):
            deadline_s = time.monotonic() + REASON_S
            while time.monotonic() < deadline_s:
                self._receive(0.05)
        return SetResult(kept, tuple(text for text in self._texts if name in text) or self.texts)

    # -- Commands and messages

    def command(self, number: int, *values: float) -> int | None:
        """Send a MAV_CMD with its parameters. Returns the MAV_RESULT, or None without an answer."""
        self._settle()
        request = self._commands.command(number, *values)
        self._complete(request)
        return None if request.answer is None else int(request.answer.result)

    def request_message(self, number: int) -> Any:
        """Return one message of that number, or None when it does not arrive."""
        request = self._commands.request_message(number)
        self._complete(request)
        return request.answer

    def send(self, message: Any) -> bool:
        """Send a message of the dialect."""
        return self._link.send(message)

    def receive(self, timeout_s: float) -> list[Any]:
        """Return the messages that have arrived, after at most `timeout_s`."""
        return [message for message in self._receive(timeout_s) if self._is_ours(message)]

    def _complete(self, exchange: Exchange) -> None:
        complete(exchange, self.send, self.receive)

    def _receive(self, timeout_s: float) -> list[Any]:
        now_s = time.monotonic()
        if now_s - self._beat_s >= HEARTBEAT_S:
            self._beat_s = now_s
            kind, none = dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID
            self._link.send(dialect.MAVLink_heartbeat_message(kind, none, 0, 0, dialect.MAV_STATE_ACTIVE, 3))
        messages = self._link.receive(timeout_s)
        for message in messages:
            if message.get_srcComponent() == AUTOPILOT_COMPONENT_ID and message.get_srcSystem() not in self._heard:
                self._heard.add(message.get_srcSystem())
                if self._wanted is None and len(self._heard) > 1:
                    raise UserError(
                        f"{self._url}: systems {self._all_heard} send there; select one of them with ?system="
                    )
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_STATUSTEXT and self._is_ours(message):
                text = self._text.handle(message)
                self._texts.extend([] if text is None else [text])
        return messages

    def _is_ours(self, message: Any) -> bool:
        return self._target is None or (message.get_srcSystem(), message.get_srcComponent()) == self._target

    def _no_heartbeat(self, waited_s: float) -> UserError:
        if self._wanted is not None and self._heard:
            return UserError(f"{self._url}: system {self._wanted} sends nothing, but {self._all_heard} does; use that")
        if self._link.refused_signature:
            return UserError(f"{self._url}: the messages there are not signed with this key; check --signing-key")
        return UserError(
            f"{self._url}: no vehicle sent a heartbeat for {waited_s:.0f} s; check that it runs and "
            "that it sends to this address (docs/ground-stations.md)"
        )


class VehicleFiles:
    """The files of one vehicle, by MAVLink FTP: `run` carries out an operation of agent/mavlink/ftp.py."""

    def __init__(self, vehicle: VehicleConnection) -> None:
        self._vehicle = vehicle
        self._client = FtpClient(vehicle.target)

    def run(self, steps: FtpSteps[Result]) -> Result:
        """Return the result. Raises UserError when the vehicle does not answer, FtpRefusedError when it refuses."""
        operation = self._client.start(steps)
        complete(operation, self._vehicle.send, self._vehicle.receive)
        try:
            return operation.result
        except FtpSilentError as error:
            raise UserError(str(error)) from None


def _system_of(url: str) -> tuple[str, int | None]:
    """Return the URL without `system=`, and its value. Raises UserError for an invalid system."""
    place, _, query = url.partition("?")
    words = query.split("&") if query else []
    given = [word.removeprefix("system=") for word in words if word.startswith("system=")]
    if not given:
        return url, None
    if len(given) > 1 or not given[0].isdigit() or not 1 <= int(given[0]) <= HIGHEST_SYSTEM_ID:
        raise UserError(f"{url}: invalid system of a vehicle; write it like ?system=3 (1 to {HIGHEST_SYSTEM_ID})")
    rest = "&".join(word for word in words if not word.startswith("system="))
    return f"{place}?{rest}" if rest else place, int(given[0])


def _direction(url: str) -> tuple[str, bool]:
    """Return the URL for the transport, and whether to listen there."""
    scheme, separator, place = url.partition("://")
    if scheme in ("udpin", "udpout"):
        return f"udp{separator}{place}", scheme == "udpin"
    if scheme == "udp":
        return url, place.rpartition(":")[0] in LOCAL_HOSTS
    if scheme not in ("tcp", "serial"):
        raise UserError(
            f"{url} is no address of a vehicle; write tcp://host:port, udp://host:port or serial:///dev/ttyACM0"
        )
    return url, False
