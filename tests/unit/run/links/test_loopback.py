"""Lines that are made here: bytes and frames come through, at the pace that was asked for and not before."""

from __future__ import annotations

import os
import time
from contextlib import suppress

import pytest

from agent.wire.can_transfer import NORMAL, URGENT, CanFrame, CanLine, Segmenter
from agent.wire.transport import Transport, open_transport
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.errors import UserError
from xitl_cli.run.links.loopback import CanLoopback, SerialLoopback, open_loopback


def arrivals(transport: Transport, size: int) -> list[tuple[float, int]]:
    """When how many bytes had arrived."""
    found, total = [], 0
    until_s = time.monotonic() + PATIENCE_S
    while total < size and time.monotonic() < until_s:
        total += sum(len(chunk) for chunk in transport.receive(0.01))
        found.append((time.monotonic(), total))
    return found


def test_bytes_come_at_the_baud_rate_and_never_before() -> None:
    """A slow machine may bring them later; no machine may bring them earlier."""
    line = SerialLoopback(57_600)
    with open_transport(line.host_url, False) as host, open_transport(line.agent_url, True) as agent:
        before_s = time.monotonic()
        assert host.send(bytes(1000))
        found = arrivals(agent, 1000)
        assert found[-1][1] == 1000
        assert all(count <= (at_s - before_s) * 5760.0 + 1.0 for at_s, count in found)
        agent.send(b"back")
        assert arrivals(host, 4)[-1][1] == 4
    line.close()
    line.close()


def as_line(frame: CanFrame) -> bytes:
    return b"T%08X%d%s\r" % (frame.identifier, len(frame.data), frame.data.hex().upper().encode())


class Adapters:
    """The two ends of a bus, read and written as bytes."""

    def __init__(self, line: CanLine) -> None:
        self.bus = CanLoopback(line)
        self.ends = [os.open(device, os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY) for device in self.bus.devices]

    def read(self, end: int, lines: int) -> list[bytes]:
        data = b""

        def whole() -> bool:
            nonlocal data
            with suppress(BlockingIOError):
                data += os.read(self.ends[end], 4096)
            return data.count(b"\r") >= lines

        wait_until(whole, look_s=0.001)
        return data.splitlines(keepends=True)

    def close(self) -> None:
        for end in self.ends:
            os.close(end)
        self.bus.close()


def test_the_bus_gives_way_to_the_lower_identifier_and_keeps_each_nodes_order() -> None:
    adapters = Adapters(CanLine(50_000))  # 3.2 ms a frame: both ends have written before the first is through
    rest = [as_line(frame) for frame in Segmenter(1, 2, False).cut(bytes(range(100)), NORMAL)]
    urgent = [as_line(frame) for frame in Segmenter(2, 1, False).cut(bytes(range(40)), URGENT)]
    before_s = time.monotonic()
    os.write(adapters.ends[0], b"C\rS8\rO\r" + b"".join(rest))
    os.write(adapters.ends[1], b"".join(urgent))
    assert adapters.read(0, len(urgent)) == urgent
    urgent_s = time.monotonic() - before_s
    assert adapters.read(1, len(rest)) == rest
    rest_s = time.monotonic() - before_s
    assert rest_s > urgent_s
    least_s = sum(CanLine(50_000).frame_s(8) for _ in range(len(rest) + len(urgent) - 2))
    assert rest_s > least_s - 0.02  # the first frames may have gone before the clock was read
    adapters.close()


def test_what_is_no_frame_goes_nowhere() -> None:
    adapters = Adapters(CanLine(1_000_000))
    os.write(adapters.ends[0], b"V\rT\rT1234567\rT123456789\xff\xff\rT000000012AB\rt1231AA\rnonsense\r")
    assert adapters.read(1, 1) == [b"t1231AA\r"]
    adapters.close()


def test_links_that_ask_for_a_line() -> None:
    assert open_loopback("udp://127.0.0.1:14660") is None
    assert open_loopback("serial:///dev/ttyS1?baud=9600") is None
    assert open_loopback("can://slcan/dev/ttyACM0?bitrate=500000") is None
    for link in ("serial://pty?baud=921600", "can://slcan/pty?bitrate=1000000"):
        line = open_loopback(link)
        assert line is not None
        with open_transport(line.agent_url, True) as agent, open_transport(line.host_url, False) as host:
            assert host.send(b"hello")
            assert arrivals(agent, 5)[-1][1] == 5
        line.close()
    with pytest.raises(UserError, match=r"autopilot\.link: .*baud is missing"):
        open_loopback("serial://pty")
