"""A bridge to PX4 as a whole node: the host's lockstep on one side, on the other what PX4's documentation describes."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from agent.assembly import assemble
from agent.bridges import px4
from agent.node import AgentNode
from agent.options import Options
from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from tests.doubles.px4 import Px4Double, calling

TICK_US, IMU_US = 10_000, 5_000


class Host:
    """Drives the node in lockstep; the motors are port and starboard, PX4's outputs 2 and 1."""

    def __init__(self, opened: ExitStack, mavlink_port: int) -> None:
        here, there = memory_pair()
        self.link = Link(here, 255, 190)
        options = Options(
            role="bridge",
            autopilot=f"udp://127.0.0.1:{mavlink_port}",
            sensors="px4",
            sensor_link="tcp://127.0.0.1:0",
            outputs=(2, 1),
        )
        self.node: AgentNode = assemble(there, options, opened)
        self.tick = 0
        start = mav.MAVLink_xitl_run_message(0, b"test", mav.XITL_RUN_COMMAND_START, mav.XITL_CLOCK_MODE_LOCKSTEP, 2)
        self.link.send(start)
        self.node.poll()
        self.link.receive()

    @property
    def port(self) -> int:
        return int(self.node.role.addresses[-1].rpartition(":")[2])

    def exchange(self) -> Any:
        """Two samples and a tick, asked for again until it is answered."""
        self.tick += 1
        now_us = self.tick * TICK_US
        for stamp_us in (now_us - IMU_US, now_us):
            accel = (acceleration_at(stamp_us), 0.0, -9.8)
            self.link.send(mav.MAVLink_xitl_imu_message(stamp_us, (0.0, 0.0, -0.25), accel, 20.0))
        for _ in range(20):
            self.link.send(mav.MAVLink_xitl_tick_message(now_us, self.tick))
            self.node.poll()
            for message in self.link.receive():
                if isinstance(message, mav.MAVLink_xitl_actuators_message) and message.tick == self.tick:
                    return message
        return None


def acceleration_at(stamp_us: int) -> float:
    return (stamp_us // 1000 % 400) / 512 - 0.25


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Iterator[Host]:
    monkeypatch.setattr(px4, "PATIENCE_S", 5.0)
    with ExitStack() as opened, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        yield Host(opened, taken.getsockname()[1])


def test_samples_in_and_the_motors_of_the_same_tick_out(host: Host) -> None:
    with calling(Px4Double(), host.port) as double:
        for _ in range(200):
            answer = host.exchange()
            assert answer is not None
            if host.tick > 10:
                assert answer.command[0] == pytest.approx(-0.25)
                assert answer.command[1] == pytest.approx(acceleration_at(host.tick * TICK_US), abs=1e-6)
                assert (answer.count, answer.imu_time_usec) == (2, host.tick * TICK_US)
    assert double.steps_back == 0
    assert len(double.sensors) == 400


def test_a_run_repeats(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4, "PATIENCE_S", 5.0)
    told = []
    for _ in range(2):
        with ExitStack() as opened, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            host = Host(opened, taken.getsockname()[1])
            with calling(Px4Double(), host.port):
                for _ in range(10):
                    host.exchange()
                told.append([tuple(host.exchange().command) for _ in range(50)])
    assert told[0] == told[1]


def test_no_tick_is_answered_without_px4(host: Host, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.bridges.px4.BLOCK_S", 0.005)
    assert host.exchange() is None
