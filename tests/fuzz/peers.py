"""Targets that play the other side of a connection: a browser, a client of a stream, a ROS node, a ground station."""

from __future__ import annotations

import asyncio
import errno
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from itertools import count
from typing import Any, cast

from agent.companion.clouds import CloudReassembler
from agent.companion.sonar import PingReassembler, echo_points
from agent.mavlink import ftp
from agent.mavlink.ftp_server import FtpServer, ServedFile
from agent.wire import dialect as mav
from agent.wire.codec import Message, Packer, decode
from agent.wire.crc import checksum
from sim_core.sensors.camera_spec import CameraSpec, GimbalSpec
from xitl_cli.http_access import BadRequestError, parse_request
from xitl_cli.plugins.cameras.image_feed import NewestImage, StreamCounts
from xitl_cli.plugins.cameras.mavlink_camera import MavlinkCamera
from xitl_cli.plugins.cameras.rtsp import RtspSession
from xitl_cli.plugins.ros.inputs import RosInputs
from xitl_cli.plugins.ros.middleware import Middleware, QosProfile
from xitl_cli.plugins.view.live_foxglove import ASK, GOALS, POINT, action_from_message
from xitl_cli.plugins.view.live_gate import refusal
from xitl_cli.plugins.view.server import ViewAddress
from xitl_cli.profile import load_profile
from xitl_cli.run.operator.actions import ENVIRONMENT, ActionError, action_name, read_action

PAYLOAD_BYTES = 255
"""Longest payload of a MAVLink message."""


# HTTP and RTSP


def http(data: bytes) -> None:
    """The head of a request."""
    with suppress(BadRequestError):
        parse_request(data)
    refusal(ViewAddress("127.0.0.1", 8470, "secret"), data)


class _Writer:
    """The side of a connection to which a server writes."""

    transport = property(lambda self: self)

    def write(self, data: bytes) -> None: ...
    def abort(self) -> None: ...
    async def drain(self) -> None: ...


@cache
def _loop() -> asyncio.AbstractEventLoop:
    return asyncio.new_event_loop()


def rtsp(data: bytes) -> None:
    """The requests of a client, up to its end."""
    head, empty, rest = data.partition(b"\r\n\r\n")

    async def serve() -> None:
        reader = asyncio.StreamReader()
        reader.feed_data(rest)
        reader.feed_eof()
        cameras = {"front": NewestImage(CameraSpec(width_px=64, height_px=48))}
        writer = cast(asyncio.StreamWriter, _Writer())
        await RtspSession("127.0.0.1", cameras, reader, writer, StreamCounts()).serve(head + empty)

    _loop().run_until_complete(serve())


# Actions


def _refusal(action: Mapping[str, Any]) -> str | None:
    """Return the refusal of an action, as a run does before it carries it out."""
    try:
        name = action_name(action)
        read_action(action, ENVIRONMENT[name]() if name in ENVIRONMENT else None)
    except ActionError as error:
        return str(error)
    return None


def foxglove(data: bytes) -> None:
    """A message of a Foxglove client: a byte chooses its topic."""
    topic = (ASK, GOALS[0], POINT)[data[0] % 3] if data else ASK
    with suppress(ActionError):
        action = action_from_message(topic, data[1:])
        if action is not None:
            (_refusal(action) or "").encode()


class _Node:
    """A middleware that delivers the messages of one node."""

    name = "fuzz"

    def __init__(self) -> None:
        self.inputs: list[Callable[[bytes], object]] = []
        seconds = count()
        profiles = load_profile("sitl").run_profiles()
        middleware = cast(Middleware, self)
        self._inputs = RosInputs(profiles, middleware, _refusal, self._post, now_s=lambda: float(next(seconds)))

    def _post(self, action: Mapping[str, Any]) -> None:
        self._inputs.refused_by_run(_refusal(action) or "")

    def advertise(self, topic: str, type_name: str, qos: QosProfile) -> Callable[[bytes], None]:
        return lambda cdr: None

    def subscribe(self, topic: str, type_name: str, qos: QosProfile, handle: Callable[[bytes], None]) -> None:
        self.inputs.append(handle)

    def serve(self, service: str, type_name: str, answer: Callable[[bytes], bytes]) -> None:
        self.inputs.append(answer)


@cache
def _node() -> _Node:
    return _Node()


def ros_input(data: bytes) -> None:
    """A message or a request of a ROS node: a byte chooses topic or service, and its CDR follows."""
    if data:
        inputs = _node().inputs
        inputs[data[0] % len(inputs)](data[1:])


# MAVLink


def message(number: int, payload: bytes) -> bytes:
    """Return the frame of a MAVLink message with this payload, cut or filled up to the size of its kind."""
    kind = mav.mavlink_map[number]
    payload = payload[: kind.unpacker.size].ljust(kind.unpacker.size, b"\0")
    body = bytes([len(payload), 0, 0, 0, 255, 190]) + number.to_bytes(3, "little") + payload
    return b"\xfd" + body + checksum(body + bytes([kind.crc_extra]))


def messages(numbers: Sequence[int], data: bytes) -> Iterator[bytes]:
    """Yield frames of these messages: each has a byte for its kind, one for the length of its payload, the payload."""
    at = 0
    while at + 2 <= len(data):
        size = data[at + 1]
        yield message(numbers[data[at] % len(numbers)], data[at + 2 : at + 2 + size])
        at += 2 + size


_TO_CAMERA = (
    mav.MAVLINK_MSG_ID_COMMAND_LONG,
    mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_PITCHYAW,
    mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_ATTITUDE,
)


@cache
def _camera() -> tuple[MavlinkCamera, socket.socket]:
    station = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    station.bind(("127.0.0.1", 0))
    url = f"udp://127.0.0.1:{station.getsockname()[1]}"
    camera = MavlinkCamera(url, 1, 0, CameraSpec(gimbal=GimbalSpec()), "rtsp://127.0.0.1:8554/front")
    camera.poll(0)
    station.connect(station.recvfrom(2048)[1])
    station.setblocking(False)
    return camera, station


def camera(data: bytes) -> None:
    """Commands of a ground station to a camera with a gimbal."""
    component, station = _camera()
    for frame in messages(_TO_CAMERA, data):
        station.send(frame)
        component.poll(0)
        with suppress(BlockingIOError):
            while station.recv(2048):
                pass


class _File:
    size = 5000

    def read(self, offset: int, count: int) -> bytes:
        return bytes(self.size)[offset : offset + count]


class _Files:
    def entries(self, path: str) -> Sequence[str]:
        if path != "@SYS":
            raise FileNotFoundError(errno.ENOENT, path)
        return ("Ftasks.txt\t5000", "Dlogs")

    def open(self, path: str) -> ServedFile:
        if path != "@SYS/tasks.txt":
            raise FileNotFoundError(errno.ENOENT, path)
        return _File()


def ftp_server(data: bytes) -> None:
    """Requests of a client, each preceded by its length."""
    server = FtpServer(_Files())
    for frame in messages((mav.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL,), data):
        request = decode(frame)
        for answer in [*server.handlers[request.get_msgId()](request, 0), *server.poll(0)]:
            Packer(1, 1).pack(answer)


def ftp_client(data: bytes) -> None:
    """Answers of a vehicle, each preceded by its length: operation, size and data. Other fields are as requested."""
    client = ftp.FtpClient((1, 1))
    content = bytes(600)
    operations = (
        ftp.read_file("@SYS/tasks.txt", 1000), ftp.read_checksum("a.bin"), ftp.make_folder("logs"),
        ftp.write_file("a.bin", content),
    )  # fmt: skip
    exchange: Any = client.start(operations[data[0] % len(operations)] if data else operations[0])  # type: ignore[arg-type]
    at = 1
    for now_s in count():
        requests = exchange.poll(now_s * 1_000_000_000)
        if exchange.done:
            break
        for request in requests:
            asked = ftp.FtpPacket.from_payload(bytes(request.payload))
            answer = data[at + 1 : at + 1 + data[at]] if at < len(data) else b""
            at += 1 + len(answer)
            operation, size = (*answer[:2], 0, 0)[:2]
            packet = ftp.FtpPacket(
                (asked.sequence + 1) & 0xFFFF, asked.session, operation, size, asked.operation, 0, answer[2:]
            )
            payload = packet.pack()[: ftp.PAYLOAD_BYTES]
            exchange.handle(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, payload), now_s * 1_000_000_000)
    with suppress(ftp.FtpRefusedError, ftp.FtpSilentError):
        repr(exchange.result)


def perception(data: bytes) -> None:
    """Chunks of clouds and pings."""
    clouds, pings = CloudReassembler(), PingReassembler()
    for frame in messages((mav.MAVLINK_MSG_ID_XITL_CLOUD, mav.MAVLINK_MSG_ID_XITL_PING), data):
        chunk: Message = decode(frame)
        if chunk.get_msgId() == mav.MAVLINK_MSG_ID_XITL_CLOUD:
            for cloud in clouds.handle(chunk):
                repr(cloud.end_ns)
        else:
            for ping in pings.handle(chunk):
                echo_points(ping)
    clouds.flush()
