"""The device's answers, and when they come: on simulation time, without a line."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_core.sensors.sonar import OVERHEAD_S, PingSettings, turning_s
from xitl_cli.run.sensors import ping_protocol as wire
from xitl_cli.run.sensors.ping360 import WAITING, Ping360Device
from xitl_cli.run.sensors.ping_protocol import AutoTransmitCommand, PingFrame, PingFramer, TransducerCommand, pack_frame

STEP_NS = 2_500_000
COMMAND = TransducerCommand(1, 1, 0, 32, 2000, 750, 200, 1)
SCAN = AutoTransmitCommand(1, 1, 32, 2000, 750, 200, 390, 10, 5, 0)
TRANSDUCER = struct.Struct("<2B5H2B")
AUTO_TRANSMIT = struct.Struct("<2B6H2B")
"""Payloads of the two commands, as the maker's protocol lays them out."""


class Bench:
    """A device stepped at 400 Hz; keeps (instant, frame) of what it sends and the settings of its pings."""

    def __init__(self) -> None:
        self.device = Ping360Device()
        self.now_ns = 0
        self.sent: list[tuple[float, PingFrame]] = []
        self.pinged: list[PingSettings] = []

    def echo(self, settings: PingSettings) -> NDArray[np.uint8]:
        self.pinged.append(settings)
        return np.full(settings.samples, len(self.pinged), np.uint8)

    def send(self, message: int, payload: bytes, destination: int = 0) -> None:
        self.device.enqueue(self.device.frames_in(pack_frame(PingFrame(message, 0, destination, payload))))

    def transducer(self, **changes: int) -> None:
        command = COMMAND._replace(**changes)
        self.send(wire.TRANSDUCER, TRANSDUCER.pack(*command))

    def auto_transmit(self, **changes: int) -> None:
        self.send(wire.AUTO_TRANSMIT, AUTO_TRANSMIT.pack(*SCAN._replace(**changes)))

    def run(self, seconds: float) -> list[PingFrame]:
        first = len(self.sent)
        until_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < until_ns:
            self.now_ns += STEP_NS
            for data in self.device.advance(self.now_ns, self.echo):
                (frame,) = PingFramer().feed(data)
                self.sent.append((self.now_ns * 1e-9, frame))
        return [frame for _, frame in self.sent[first:]]


def angle_of(frame: PingFrame) -> int:
    return int.from_bytes(frame.payload[2:4], "little")


def test_a_ping_is_answered_when_head_and_sound_have_had_their_time() -> None:
    bench = Bench()
    bench.transducer(angle=50)
    (answer,) = bench.run(2.0)
    assert answer.message == wire.DEVICE_DATA
    assert angle_of(answer) == 50
    assert answer.payload[14:] == bytes([1]) * 200
    expected_s = turning_s(0, 50) + 200 * 2000 * 25e-9 + OVERHEAD_S
    assert bench.sent[0][0] == pytest.approx(expected_s, abs=3 * STEP_NS * 1e-9)  # taken, pinged and answered at steps
    (settings,) = bench.pinged
    assert settings == PingSettings(50, 2000 * 25e-9, 200, 32e-6, 750.0, 1)


def test_a_move_without_a_ping_has_no_data() -> None:
    bench = Bench()
    bench.transducer(angle=9, transmit=0)
    (answer,) = bench.run(1.0)
    assert (answer.message, len(answer.payload), bench.pinged) == (wire.DEVICE_DATA, 14, [])


def test_an_auto_scan_goes_to_and_fro_until_the_motor_is_off() -> None:
    bench = Bench()
    bench.auto_transmit()
    frames = bench.run(1.0)
    assert {frame.message for frame in frames} == {wire.AUTO_DEVICE_DATA}
    assert [angle_of(frame) for frame in frames[:10]] == [390, 395, 0, 5, 10, 5, 0, 395, 390, 395]
    bench.send(wire.MOTOR_OFF, b"")
    frames = bench.run(1.0)
    assert [(frame.message, frame.payload) for frame in frames] == [(wire.ACK, wire.ack(wire.MOTOR_OFF))]


def test_a_delay_slows_the_auto_scan() -> None:
    slow, fast = Bench(), Bench()
    slow.auto_transmit(delay=100)
    fast.auto_transmit()
    counts = len(slow.run(10.0)), len(fast.run(10.0))
    ping_s = 200 * 2000 * 25e-9 + OVERHEAD_S + turning_s(0, 5)
    assert counts == (pytest.approx(10.0 / (ping_s + 0.1), rel=0.05), pytest.approx(10.0 / ping_s, rel=0.1))


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"gain_setting": 3}, b"gain_setting = 3; use 0 to 2"),
        ({"angle": 400}, b"angle = 400; use 0 to 399"),
        ({"sample_period": 79}, b"sample_period = 79; use 80 to 40000"),
        ({"number_of_samples": 1201}, b"number_of_samples = 1201; use 200 to 1200"),
        ({"transmit_frequency": 499}, b"transmit_frequency = 499; use 500 to 1000"),
        ({"transmit_duration": 0}, b"transmit_duration = 0; use 1 to 1000"),
    ],
)
def test_what_the_device_cannot_is_refused_with_the_reason(wrong: dict[str, int], reason: bytes) -> None:
    bench = Bench()
    bench.transducer(**wrong)
    (answer,) = bench.run(0.1)
    assert answer.message == wire.NACK
    assert answer.payload == wire.ack(wire.TRANSDUCER) + reason
    assert (bench.device.refused, bench.pinged) == (1, [])


def test_requests_ids_and_resets() -> None:
    bench = Bench()
    for wanted in (wire.PROTOCOL_VERSION, wire.DEVICE_INFORMATION, wire.DEVICE_DATA, 1234):
        bench.send(wire.GENERAL_REQUEST, wire.ack(wanted))
    bench.send(wire.GENERAL_REQUEST, b"")
    bench.send(4711, b"")
    bench.send(wire.SET_DEVICE_ID, bytes([0, 0]))
    bench.send(wire.SET_DEVICE_ID, bytes([9, 0]))
    bench.send(wire.GENERAL_REQUEST, wire.ack(wire.PROTOCOL_VERSION), destination=2)  # it was 2 until now
    answers = bench.run(0.1)
    version, information, data = answers[:3]
    assert (version.message, version.payload[0]) == (wire.PROTOCOL_VERSION, 1)
    assert (information.message, information.payload[0]) == (wire.DEVICE_INFORMATION, 2)
    assert (data.message, len(data.payload)) == (wire.DEVICE_DATA, 14)
    assert [answer.message for answer in answers[3:]] == [wire.NACK, wire.NACK, wire.NACK, wire.NACK, wire.ACK]
    bench.send(wire.GENERAL_REQUEST, wire.ack(wire.PROTOCOL_VERSION), destination=2)
    bench.send(wire.GENERAL_REQUEST, wire.ack(wire.PROTOCOL_VERSION), destination=9)
    (version,) = bench.run(0.1)
    assert version.source == 9
    assert bench.device.others == 2
    bench.transducer(gain_setting=2)
    bench.run(0.2)
    bench.send(wire.RESET, bytes([0, 0]))
    bench.send(wire.GENERAL_REQUEST, wire.ack(wire.DEVICE_DATA))
    (data,) = bench.run(1.0)
    assert (data.payload[1], len(data.payload)) == (0, 14)  # gain and data of before are gone


def test_commands_that_come_too_fast_are_dropped_and_counted() -> None:
    bench = Bench()
    for _ in range(WAITING + 5):
        bench.transducer()
    assert bench.device.dropped == 5
    assert len(bench.run(3.0)) == WAITING


@pytest.mark.medium
@given(st.lists(st.tuples(st.integers(0, 65535), st.binary(max_size=24)), max_size=20))
def test_no_message_raises(messages: list[tuple[int, bytes]]) -> None:
    bench = Bench()
    known = (wire.TRANSDUCER, wire.AUTO_TRANSMIT, wire.RESET, wire.SET_DEVICE_ID, wire.GENERAL_REQUEST)
    for number, payload in messages:
        bench.send(number, payload)
        bench.send(known[number % len(known)], payload)
        bench.run(0.01)
    assert bench.device.counts()["frames"] == 2 * len(messages)
