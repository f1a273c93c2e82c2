#!/usr/bin/env python3
"""Takes the command line of px4 and sends again what a real one sent: XITL_CAPTURE names the file.

Outputs and streams come at the frame, counted in HIL_SENSOR, at which they came from the real one. What answers a
request comes when that request does: before PX4 is armed nothing ties its MAVLink to a frame. A TIMESYNC gets the real
one's answer with the time that was asked. XITL_REPLAY_DIES ends it at that frame.
"""

from __future__ import annotations

import os
import socket
import sys
import time
from collections import defaultdict, deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))
from pymavlink.dialects.v20 import common as mavlink

from tests.doubles.capture import COMMANDS, MAVLINK, OUTPUTS, Record, read_capture

LOCAL = "127.0.0.1"
SIMULATOR_PORT, MAVLINK_PORT = 4560, 14580
CALLS_S = 30.0
Question = tuple[str, str | int]
ANSWERS = ("PARAM_VALUE", "COMMAND_ACK", "MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK", "TIMESYNC")


def instance_in(arguments: list[str]) -> int:
    """Of px4's command line."""
    return int(arguments[arguments.index("-i") + 1])


def called(port: int) -> socket.socket:
    """The simulator there, called again until it answers, as PX4 does."""
    until_s = time.monotonic() + CALLS_S
    while True:
        try:
            simulator = socket.create_connection((LOCAL, port))
        except ConnectionRefusedError:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.01)
            continue
        simulator.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return simulator


def parsed(parser: Any, data: bytes) -> Iterator[Any]:
    """Messages in the bytes; those that `common` does not have are not among them."""
    yield from parser.parse_buffer(data) or ()


def new_parser() -> Any:
    """For one stream of bytes."""
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return parser


class Answers:
    """What the real one answered, by what was asked, in its order; the last answer comes again."""

    def __init__(self, records: list[Record]) -> None:
        self._by_request: dict[Question, deque[list[Any]]] = defaultdict(deque)
        asked, answered = new_parser(), new_parser()
        open_requests: dict[Question, list[Any]] = {}
        for record in records:
            if record.kind == COMMANDS:
                for message in parsed(asked, record.data):
                    if (key := asks_for(message)) is not None:
                        open_requests[key] = []
                        self._by_request[key].append(open_requests[key])
            elif record.kind == MAVLINK:
                for message in parsed(answered, record.data):
                    key = answers(message)
                    if message.get_type() == "MISSION_ACK":
                        key = max((asked for asked in open_requests if asked[0] == "mission"), default=None)
                    if key in open_requests:
                        open_requests[key].append(message)

    def to(self, request: Any) -> Iterator[bytes]:
        """Frames that answer it."""
        key = asks_for(request)
        known = self._by_request.get(key)
        if not known:
            return
        for message in known[0] if len(known) == 1 else known.popleft():
            if message.get_type() == "TIMESYNC":
                message.tc1 += request.ts1 - message.ts1
                message.ts1 = request.ts1
                yield message.pack(mavlink.MAVLink(None, message.get_srcSystem(), message.get_srcComponent()))
            else:
                yield bytes(message.get_msgbuf())


def asks_for(message: Any) -> Question | None:
    """What kind of answer it wants, None for none."""
    kind = message.get_type()
    if kind in ("PARAM_REQUEST_READ", "PARAM_SET"):
        return ("parameter", message.param_id)
    if kind in ("COMMAND_LONG", "COMMAND_INT"):
        return ("command", message.command)
    if kind == "MISSION_COUNT":
        return ("mission", 0)
    if kind == "MISSION_ITEM_INT":
        return ("mission", message.seq + 1)
    return ("time", 0) if kind == "TIMESYNC" and not message.tc1 else None


def answers(message: Any) -> Question | None:
    """What it answers; a MISSION_ACK answers the last item."""
    kind = message.get_type()
    if kind == "PARAM_VALUE":
        return ("parameter", message.param_id)
    if kind == "COMMAND_ACK":
        return ("command", message.command)
    if kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
        return ("mission", message.seq)
    return ("time", 0) if kind == "TIMESYNC" and message.tc1 else None


def streamed(records: list[Record]) -> Iterator[Record]:
    """Outputs and streams, in their order."""
    parser = new_parser()
    for record in records:
        if record.kind == OUTPUTS:
            yield record
        elif record.kind == MAVLINK:
            frames = [bytes(m.get_msgbuf()) for m in parsed(parser, record.data) if m.get_type() not in ANSWERS]
            if frames:
                yield Record(MAVLINK, record.frame, b"".join(frames))


def main() -> None:
    """Until the simulator leaves."""
    records = list(read_capture(Path(os.environ["XITL_CAPTURE"])))
    replies, waiting = Answers(records), deque(streamed(records))
    dies = int(os.environ.get("XITL_REPLAY_DIES", "-1"))
    instance = instance_in(sys.argv[1:])
    vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    vehicle.bind((LOCAL, MAVLINK_PORT + instance))
    vehicle.setblocking(False)
    print("Waiting for simulator to accept connection", flush=True)
    simulator = called(SIMULATOR_PORT + instance)
    sensors, asked = new_parser(), new_parser()
    frame, station = 0, None

    def send_due() -> None:
        while waiting and waiting[0].frame <= frame:
            record = waiting.popleft()
            if record.kind == OUTPUTS:
                simulator.sendall(record.data)
            elif station is not None:
                vehicle.sendto(record.data, station)

    send_due()
    while data := simulator.recv(65536):
        with suppress(BlockingIOError):
            while True:
                told, station = vehicle.recvfrom(65536)
                for message in parsed(asked, told):
                    for answer in replies.to(message):
                        vehicle.sendto(answer, station)
        for message in parsed(sensors, data):
            if message.get_type() == "HIL_SENSOR":
                frame += 1
                if frame == dies:
                    print("Segmentation fault", flush=True)
                    os.abort()
                send_due()


if __name__ == "__main__":
    main()
