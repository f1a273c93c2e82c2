"""Frames of every kind with any content, whole and cut, from the host of a run and from a station: nothing raises."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from urllib.parse import urlsplit

import pytest
from node_host import START

from agent.assembly import assemble
from agent.node import AgentNode
from agent.options import Options
from agent.wire import dialect as mav
from agent.wire.crc import checksum
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from agent.wire.transport import Transport

FRAMES = 1500
WELL_KNOWN = (0, 1, 190, 255, 0x7F)


def frame(rng: random.Random, sequence: int) -> bytes:
    number = rng.choice(list(mav.mavlink_map))
    kind = mav.mavlink_map[number]
    size = kind.unpacker.size
    payload = bytes(rng.choice(WELL_KNOWN) if rng.random() < 0.5 else rng.randrange(256) for _ in range(size))
    body = bytes([size, 0, 0, sequence & 0xFF, rng.choice((255, 1, 7)), 190]) + number.to_bytes(3, "little") + payload
    whole = b"\xfd" + body + checksum(body + bytes([kind.crc_extra]))
    return whole if rng.random() < 0.8 else whole[: rng.randrange(len(whole))]


@pytest.fixture
def agent() -> Iterator[tuple[Transport, AgentNode]]:
    here, there = memory_pair()
    with ExitStack() as opened:
        node = assemble(there, Options(ground=("tcp://127.0.0.1:0",)), opened)
        Link(here, 255, 190).send(mav.MAVLink_xitl_run_message(0, b"fuzz", START, 0, 2))
        node.poll()
        yield here, node


@pytest.mark.medium
@pytest.mark.parametrize("seed", [1, 2])
def test_any_frames_from_both_sides(agent: tuple[Transport, AgentNode], seed: int) -> None:
    host, node = agent
    rng = random.Random(seed)
    port = urlsplit(node.role.addresses[0]).port
    with socket.create_connection(("127.0.0.1", port)) as station:
        station.setblocking(False)
        for number in range(FRAMES):
            host.send(frame(rng, number))
            try:
                station.send(frame(rng, number))
                station.recv(1 << 16)
            except BlockingIOError:
                pass
            node.poll()
            host.receive()
    link = Link(host, 255, 190)
    link.send(mav.MAVLink_xitl_run_message(0, b"fuzz", mav.XITL_RUN_COMMAND_HELLO, 0, 2))
    node.poll()
    status = [message for message in link.receive() if message.get_type() == "XITL_NODE_STATUS"][-1]
    assert status.frames_received + status.frames_dropped > 0  # a frame that starts or ends a run counts from zero
