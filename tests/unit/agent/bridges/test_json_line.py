"""Datagrams of the JSON interface."""

from __future__ import annotations

import json
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.bridges.json_line import extras_text, frame_text, imu_text, pack_datagrams, parse_servo_head, read_pulses_us

MOTION = (1.0, -2.0, 0.5, 0.8, 0.0, 0.0, 0.6, 3.0, -0.25, 0.0)
IMU = imu_text((0.1, -0.2, 0.3), (0.0, 0.5, -9.81))


def packet(magic: int, channels: int, rate_hz: int = 1200, frame: int = 7) -> bytes:
    return struct.pack(f"<HHI{channels}H", magic, rate_hz, frame, *range(1000, 1000 + channels))


@pytest.mark.parametrize(("magic", "channels"), [(18458, 16), (29569, 32)])
def test_servo_packets(magic: int, channels: int) -> None:
    data = packet(magic, channels)
    assert parse_servo_head(data) == (1200, 7)
    assert read_pulses_us(data) == tuple(range(1000, 1000 + channels))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x1a",
        packet(18458, 16)[:-1],
        packet(18458, 16) + b"\0",
        packet(18458, 32),
        packet(29569, 16),
        packet(18457, 16),
        packet(18458, 16, rate_hz=0),
        packet(18458, 16, rate_hz=10),
        packet(18458, 16, rate_hz=20_001),
    ],
)
def test_what_is_no_servo_packet(data: bytes) -> None:
    assert parse_servo_head(data) is None


@pytest.mark.medium
@given(st.binary(max_size=100))
def test_garbage_never_raises(data: bytes) -> None:
    parse_servo_head(data)


def test_an_answer_is_json_without_space_before_values() -> None:
    text = frame_text(12.000833001, IMU, MOTION, extras_text([None, 2.5, None, None, None, 0.25], (1.5, 3.0)))
    (data,) = pack_datagrams([text])
    assert json.loads(data) == {
        "timestamp": 12.000833001,
        "imu": {"gyro": [0.1, -0.2, 0.3], "accel_body": [0.0, 0.5, -9.81]},
        "position": [1.0, -2.0, 0.5],
        "quaternion": [0.8, 0.0, 0.0, 0.6],
        "velocity": [3.0, -0.25, 0.0],
        "rng_2": 2.5,
        "rng_6": 0.25,
        "windvane": {"direction": 1.5, "speed": 3.0},
    }
    assert data[:2] == b"\n{"
    assert data[-2:] == b"}\n"
    assert b'": ' not in data
    assert b"[1.00000, -2.00000, 0.50000]" in data


def test_answers_are_of_one_length() -> None:
    texts = [frame_text(time_s, IMU, MOTION, "") for time_s in (9.999, 10.0, 1234.5)]
    made = pack_datagrams(texts)
    assert len({len(data) for data in made}) == 1
    assert [json.loads(data)["timestamp"] for data in made] == [9.999, 10.0, 1234.5]
    assert all(data.startswith(b"\n{") and data.endswith(b"\n") for data in made)
    assert pack_datagrams([]) == []
