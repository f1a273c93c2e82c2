"""VectorNav frames against values packed field by field, as the unit's manual lists them."""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx

import pytest

from agent.bridges import vectornav
from agent.bridges.samples import InertialSample, Navigation, ReceiverFix

SAMPLE = InertialSample(5_000_000, (0.1, -0.2, 0.3), (0.5, -0.25, -9.75), (0.25, -0.125, 0.0625), 101_325.0, 21.5)
FIX = ReceiverFix(7, 9, -8.8, -63.95, 60.5, (1.0, -2.0, 0.25), 0.75, 1.5, 0.05, 3, 14)
HALF = math.sqrt(0.5)
NAVIGATION = Navigation(
    11,
    13,
    (HALF, 0.0, 0.0, HALF),
    (0.1, -0.2, math.pi / 2),
    -8.8,
    -63.95,
    60.5,
    (1.0, -2.0, 0.25),
    0.5,
    2.0,
    0.75,
    1.5,
    0.05,
)


def contents(frame: bytes, header: bytes) -> bytes:
    """Values of a frame whose sync byte, header and checksum are right."""
    assert frame[:1] == b"\xfa"
    assert frame[1 : 1 + len(header)] == header
    assert crc_hqx(frame[1:], 0) == 0  # over a content and its own checksum
    return frame[1 + len(header) : -2]


def test_an_inertial_frame() -> None:
    values = contents(vectornav.pack_inertial_frame(SAMPLE), bytes.fromhex("012107"))
    assert len(values) == 76
    assert values[:8] == (5_000_000).to_bytes(8, "little")
    numbers = struct.unpack("<17f", values[8:])
    rate, accel = numbers[0:3], numbers[3:6]
    assert rate == pytest.approx((0.1, -0.2, 0.3))
    assert accel == (0.5, -0.25, -9.75)
    assert numbers[6:9] == accel
    assert numbers[9:12] == rate
    assert numbers[12:15] == (0.25, -0.125, 0.0625)
    assert numbers[15] == 21.5
    assert numbers[16] == pytest.approx(101.325)  # kPa


def test_a_frame_byte_for_byte() -> None:
    zeros = InertialSample(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1000.0, 0.0)
    expected = "fa012107" + "0100000000000000" + 64 * "00" + "0000803f"  # 1 ns, 1 kPa
    assert vectornav.pack_inertial_frame(zeros)[:-2].hex() == expected


def test_a_solution_frame() -> None:
    values = contents(vectornav.pack_solution_frame(NAVIGATION), bytes.fromhex("31010006011306"))
    time_ns, *rest = struct.unpack("<Q10fH3d5f", values)
    assert time_ns == 11
    assert rest[:3] == pytest.approx((90.0, math.degrees(-0.2), math.degrees(0.1)))  # yaw, pitch, roll
    assert rest[3:7] == pytest.approx((0.0, 0.0, HALF, HALF))  # x, y, z, w
    assert rest[7:10] == [2.0, 0.5, 0.5]
    assert rest[10] == 0b110  # tracking, with a fix
    assert rest[11:14] == [-8.8, -63.95, 60.5]
    assert rest[14:17] == [1.0, -2.0, 0.25]
    assert rest[17:] == pytest.approx((0.75, 0.05))


def test_a_solution_frame_tells_of_a_dead_compass() -> None:
    values = contents(vectornav.pack_solution_frame(NAVIGATION, vectornav.FIELD_FAULT), bytes.fromhex("31010006011306"))
    assert struct.unpack_from("<H", values, 8 + 40)[0] == 0b100_0110


def test_a_receiver_frame() -> None:
    values = contents(vectornav.pack_receiver_frame(FIX), bytes.fromhex("490300b8261800"))
    stamp_ns, gps_ns, satellites, kind, *rest = struct.unpack("<QQBB3d3f3f1f7fBB", values)
    assert (stamp_ns, gps_ns, satellites, kind) == (7, 9, 14, 3)
    assert rest[:3] == [-8.8, -63.95, 60.5]
    assert rest[3:6] == [1.0, -2.0, 0.25]
    assert rest[6:9] == [0.75, 0.75, 1.5]  # north, east, up
    assert rest[9] == pytest.approx(0.05)
    geometric, position, time, vertical, horizontal, north, east = rest[10:17]
    assert (vertical, horizontal) == (1.5, 0.75)
    assert position == pytest.approx(math.hypot(vertical, horizontal))
    assert geometric == pytest.approx(math.hypot(position, time))
    assert math.hypot(north, east) == pytest.approx(horizontal)
    assert rest[17:] == [14, 3]
