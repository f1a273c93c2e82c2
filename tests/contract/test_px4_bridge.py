"""A bridge to PX4 as a whole node: the host's lockstep on one side, on the other what a real PX4 1.16 sent."""

from __future__ import annotations

import socket
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from agent.assembly import assemble
from agent.bridges import px4
from agent.bridges.hil_messages import BAROMETER
from agent.node import AgentNode
from agent.options import Options
from agent.wire import dialect as mav
from agent.wire.codec import decode
from agent.wire.framing import Framer, is_known
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from sim_core.geodesy import LocalFrame
from tests.doubles.capture import MAVLINK, OUTPUTS, SENSORS, read_capture
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.run.links.agent_view import AgentView

DATA = Path(__file__).parents[1] / "data" / "px4"
RECORDS = list(read_capture(DATA / "mission.xz"))
SAMPLE_US = 10_000
FRAMES = 700  # it arms after 400
ARMED = 128


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

    def exchange(self, patience_s: float = PATIENCE_S, samples: int = 1) -> Any:
        """Samples and a tick, asked for again until it is answered."""
        self.tick += 1
        now_us = self.tick * samples * SAMPLE_US
        for stamp_us in range(now_us - (samples - 1) * SAMPLE_US, now_us + 1, SAMPLE_US):
            self.link.send(mav.MAVLink_xitl_imu_message(stamp_us, (0.0, 0.0, -0.25), (0.0, 0.0, -9.8), 20.0))
        until_s = time.monotonic() + patience_s
        while time.monotonic() < until_s:
            self.link.send(mav.MAVLink_xitl_tick_message(now_us, self.tick))
            self.node.poll()
            for message in self.link.receive():
                if isinstance(message, mav.MAVLink_xitl_actuators_message) and message.tick == self.tick:
                    return message
        return None


class Stamps(list[int]):
    """Of the samples that the double has got and answered."""

    def wait_for(self, count: int) -> None:
        """The real one is not overtaken before its outputs set the pace: it has the time of its own for that."""
        wait_until(lambda: len(self) >= count, f"not all of {count} samples were taken", look_s=0.0)


@contextmanager
def replaying(port: int) -> Iterator[Stamps]:
    """What the real one sent to its simulator, at the sample after which it came; the stamps of what it got."""
    stamps = Stamps()
    sock = socket.create_connection(("127.0.0.1", port), 5.0)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    outputs = deque(record for record in RECORDS if record.kind == OUTPUTS)

    def serve() -> None:
        parser, frame = mavlink.MAVLink(None), 0
        while True:
            while outputs and outputs[0].frame <= frame:
                sock.sendall(outputs.popleft().data)
            data = sock.recv(65536)
            if not data:
                return
            for message in parser.parse_buffer(data) or ():
                if message.get_type() == "HIL_SENSOR":
                    frame += 1
                    while outputs and outputs[0].frame <= frame:
                        sock.sendall(outputs.popleft().data)
                    stamps.append(message.time_usec)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield stamps
    finally:
        sock.shutdown(socket.SHUT_RDWR)
        thread.join()
        sock.close()


def captured(kind: int, name: str) -> Iterator[tuple[int, Any]]:
    """(frame, message) as pymavlink reads them."""
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    for record in RECORDS:
        if record.kind == kind:
            for message in parser.parse_buffer(record.data) or ():
                if message.get_type() == name:
                    yield record.frame, message


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Iterator[Host]:
    monkeypatch.setattr(px4, "PATIENCE_S", PATIENCE_S)
    monkeypatch.setattr(px4, "PACE", 100.0)  # what sends again needs no time
    with ExitStack() as opened, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        yield Host(opened, taken.getsockname()[1])


@pytest.mark.medium
@pytest.mark.parametrize("samples", [1, 2])
def test_the_motors_of_a_tick_are_what_px4_put_out_for_its_last_sample(host: Host, samples: int) -> None:
    put_out: dict[int, Any] = {}
    for frame, message in captured(OUTPUTS, "HIL_ACTUATOR_CONTROLS"):
        put_out[frame] = message
    first = min(put_out)
    assert 300 < first < FRAMES - 200
    compared = 0
    with replaying(host.port) as stamps:
        for sample in range(samples, FRAMES, samples):
            answer = host.exchange(samples=samples)
            stamps.wait_for(sample)
            assert answer is not None
            if sample < first:
                assert tuple(answer.command[:2]) == (0.0, 0.0)
            elif sample > first + px4.RHYTHM and sample in put_out:
                assert put_out[sample].mode & ARMED
                assert tuple(answer.command[:2]) == pytest.approx(put_out[sample].controls[1::-1], abs=1e-6)
                compared += 1
    assert compared > 200 // samples
    assert stamps == [px4.FIRST_US + sample * SAMPLE_US for sample in range(1, FRAMES)][: len(stamps)]


def test_the_barometer_has_the_bits_with_which_the_real_one_armed() -> None:
    """Whole: pressure, pressure altitude and temperature. With two of the three it said: barometer 0 missing."""
    bits = {message.fields_updated & ~0x1FF for _, message in captured(SENSORS, "HIL_SENSOR")}
    assert bits == {0, 0x1A00}
    assert BAROMETER in bits


def test_a_refusal_is_told_by_its_cause_and_without_its_tab() -> None:
    view = AgentView(LocalFrame(-8.8, -63.95, 70.0), lambda *_: None, lambda *_: None)
    framer = Framer(stream=False, foreign=True)
    for record in read_capture(DATA / "refused.xz"):
        if record.kind == MAVLINK:
            for frame in framer.feed(record.data):
                if is_known(frame):
                    view.handle(decode(frame))
    assert view.texts[-1] == "Arming denied: Resolve system health failures first"
    assert view.why_not_armed() == "; it said: Preflight Fail: barometer 0 missing"
    assert "barometer" in view.unhealthy
    assert not view.ready_to_arm


def test_every_position_of_px4_makes_an_estimate() -> None:
    estimates: list[int] = []
    view = AgentView(LocalFrame(-8.8, -63.95, 70.0), lambda *_: None, lambda stamp_us, _: estimates.append(stamp_us))
    view.pair_ms = 50
    framer, positions = Framer(stream=False, foreign=True), 0
    for record in RECORDS:
        if record.kind == MAVLINK:
            for frame in framer.feed(record.data):
                if is_known(frame):
                    message = decode(frame)
                    view.handle(message)
                    positions += view.has_origin and isinstance(message, mav.MAVLink_local_position_ned_message)
    assert positions > 100
    assert len(estimates) == pytest.approx(positions, abs=1)


@pytest.mark.medium
def test_a_run_repeats(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the samples before PX4 arms to those after it."""
    monkeypatch.setattr(px4, "PATIENCE_S", PATIENCE_S)
    monkeypatch.setattr(px4, "PACE", 100.0)
    told = []
    for _ in range(2):
        with ExitStack() as opened, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            again = Host(opened, taken.getsockname()[1])
            answers = []
            with replaying(again.port) as stamps:
                for tick in range(1, 501):
                    answers.append(again.exchange())
                    stamps.wait_for(tick)
            told.append([tuple(answer.command) for answer in answers])
    assert told[0][450:] == told[1][450:]
    assert any(any(command) for command in told[0])


def test_no_tick_is_answered_without_px4(host: Host, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.bridges.px4.BLOCK_S", 0.005)
    assert host.exchange(patience_s=0.1) is None
