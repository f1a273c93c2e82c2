"""Launches asked for by UDP, from the command line and from garbage."""

from __future__ import annotations

import math
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from agent.wire import dialect
from agent.wire.codec import Packer, decode
from agent.wire.framing import Framer
from sim_core.world.debris import BodyKind, Launch
from xitl_cli.commands.world import launch as launch_command
from xitl_cli.errors import UserError
from xitl_cli.run.links.launch_requests import LaunchPort, request_launch

NOW_NS = 5_000_000_000
EAST_RAD = struct.unpack("<f", struct.pack("<f", math.pi / 2))[0]  # as it comes over the wire


@pytest.fixture
def port() -> Iterator[LaunchPort]:
    made = LaunchPort("udp://127.0.0.1:0")
    yield made
    made.close()


@contextmanager
def served(port: LaunchPort, takes: bool = True) -> Iterator[list[Launch]]:
    """A run that looks at its port now and then."""
    taken: list[Launch] = []
    over = threading.Event()

    def ask(launch: Launch) -> bool:
        taken.append(launch)
        return takes

    def serve() -> None:
        while not over.wait(0.005):
            port.serve(NOW_NS, ask)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield taken
    finally:
        over.set()
        thread.join()


def send(port: LaunchPort, *datagrams: bytes) -> tuple[list[Launch], list[Any]]:
    """Datagrams of one sender: what the run took for a launch, and its answers."""
    host, _, number = port.address.removeprefix("udp://").rpartition(":")
    taken: list[Launch] = []
    answers: list[Any] = []

    def ask(launch: Launch) -> bool:
        taken.append(launch)
        return True

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect((host, int(number)))
        sender.settimeout(2.0)
        for datagram in datagrams:
            sender.send(datagram)
            port.serve(NOW_NS, ask)
        sender.setblocking(False)
        while True:
            try:
                answers += [decode(frame) for frame in Framer(stream=False).feed(sender.recv(2048))]
            except BlockingIOError:
                return taken, answers


def request(
    kind: int = 0, north_m: float = 3.0, size_m: float = 0.0, heading_rad: float = 0.5, number: int = 7
) -> bytes:
    message = dialect.MAVLink_xitl_launch_message((north_m, -4.0), heading_rad, size_m, number, kind)
    return Packer(255, 191).pack(message)


def test_the_command_line_puts_a_body_into_the_water(port: LaunchPort, capsys: pytest.CaptureFixture[str]) -> None:
    with served(port) as taken:
        launch_command("animal", "12.5,-3", heading=90.0, length=1.5, to=port.address)
        launch_command("trunk", "1,2", to=port.address)
    assert taken == [
        Launch(NOW_NS, BodyKind.ANIMAL, 12.5, -3.0, EAST_RAD, 1.5),
        Launch(NOW_NS, BodyKind.TRUNK, 1.0, 2.0, 0.0, None),
    ]
    assert capsys.readouterr().out.splitlines()[0] == "animal of 1.5 m in the water at 12.5 N -3 E"


def test_a_refusal_is_told(port: LaunchPort) -> None:
    with served(port, takes=False), pytest.raises(UserError, match="the run refused the trunk: no body is as long"):
        request_launch(port.address, "trunk", 0.0, 0.0, 0.0, 99.0)
    assert port.report() == {"asked": 1, "again": 0, "refused": 1, "dropped": 0}


def test_nobody_answers() -> None:
    with pytest.raises(UserError, match="no run answers; start one"):
        request_launch("udp://127.0.0.1:9", "trunk", 0.0, 0.0, 0.0, None, wait_s=0.2)


@pytest.mark.parametrize("at", ["x", "1", "1,2,3", "nan,1"])
def test_a_place_that_is_none(at: str) -> None:
    with pytest.raises(UserError, match="is no position; write metres north and east"):
        launch_command("trunk", at)


def test_who_asks_again_gets_the_same_answer_and_no_second_body(port: LaunchPort) -> None:
    taken, answers = send(port, request(), request(), request(number=8))
    assert len(taken) == 2
    assert [(answer.result, answer.result_param2) for answer in answers] == [(0, 7), (0, 7), (0, 8)]
    assert port.report() == {"asked": 2, "again": 1, "refused": 0, "dropped": 0}


@pytest.mark.parametrize(
    "bad",
    [
        {"kind": 9},
        {"north_m": math.nan},
        {"north_m": 1e9},
        {"size_m": -1.0},
        {"heading_rad": math.inf},
        {"size_m": math.nan},
    ],
)
def test_what_cannot_be_is_denied(port: LaunchPort, bad: dict[str, Any]) -> None:
    taken, answers = send(port, request(**bad))
    assert taken == []
    assert [answer.result for answer in answers] == [dialect.MAV_RESULT_DENIED]


def test_garbage_is_counted(port: LaunchPort) -> None:
    beat = Packer(255, 191).pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    taken, _ = send(port, b"", b"\xfd\x00", bytes(300), beat, request()[:-1], request())
    assert taken == [Launch(NOW_NS, BodyKind.TRUNK, 3.0, -4.0, 0.5, None)]
    assert port.report() == {"asked": 1, "again": 0, "refused": 0, "dropped": 5}


def test_a_port_that_is_taken(port: LaunchPort) -> None:
    with pytest.raises(UserError, match=r"world\.debris\.control: .* in use"):
        LaunchPort(port.address)
