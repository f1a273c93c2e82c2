"""MIP packets against a reader of its own, written from the protocol's description."""

from __future__ import annotations

import math
import struct

import pytest

from agent.bridges import microstrain
from agent.bridges.readings import InertialSample, Navigation, ReceiverFix
from agent.navigation.gps_time import SECOND_NS, WEEK_S

SAMPLE = InertialSample(5, (0.1, -0.2, 0.3), (0.5, -0.25, -9.80665), (0.25, -0.125, 0.0625), 101_325.0, 21.5)
GPS_NS = (2_371 * WEEK_S + 100_000) * SECOND_NS + 250_000_000
FIX = ReceiverFix(7, GPS_NS, -8.8, -63.95, 60.5, (3.0, -4.0, 0.0), 0.75, 1.5, 0.05, 3, 14)
HALF = math.sqrt(0.5)
NAVIGATION = Navigation(
    11,
    GPS_NS,
    (HALF, 0.0, 0.0, HALF),
    (0.1, -0.2, 1.5),
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


def fields(packet: bytes, descriptor_set: int) -> dict[int, bytes]:
    """Values by descriptor of a packet whose checksum is right."""
    assert packet[:3] == bytes((0x75, 0x65, descriptor_set))
    assert len(packet) == packet[3] + 6
    first = second = 0
    for byte in packet[:-2]:
        first = (first + byte) % 256
        second = (second + first) % 256
    assert packet[-2:] == bytes((first, second))
    found, rest = {}, packet[4:-2]
    while rest:
        found[rest[1]] = rest[2 : rest[0]]
        rest = rest[rest[0] :]
    return found


def test_a_checksum_of_the_manual() -> None:
    """The ping command of the protocol's description, and its checksum."""
    assert microstrain.packet(0x01, bytes.fromhex("0201")).hex() == "756501020201e0c6"


def test_an_inertial_packet() -> None:
    found = fields(microstrain.pack_inertial_frame(SAMPLE), 0x80)
    assert set(found) == {0x17, 0x06, 0x04, 0x05}
    assert struct.unpack(">f", found[0x17])[0] == pytest.approx(1013.25)  # mbar
    assert struct.unpack(">3f", found[0x06]) == (0.25, -0.125, 0.0625)  # gauss
    assert struct.unpack(">3f", found[0x04]) == pytest.approx((0.0509858, -0.0254929, -1.0))  # g
    assert struct.unpack(">3f", found[0x05]) == pytest.approx((0.1, -0.2, 0.3))


def test_a_filter_packet() -> None:
    found = fields(microstrain.pack_solution_frame(NAVIGATION), 0x82)
    assert struct.unpack(">dHH", found[0xD3]) == (100_000.25, 2_371, 3)
    assert struct.unpack(">3H", found[0x10]) == (4, 3, 0)
    assert struct.unpack(">3dH", found[0x01]) == (-8.8, -63.95, 60.5, 1)
    assert struct.unpack(">3fH", found[0x02]) == (1.0, -2.0, 0.25, 1)
    assert struct.unpack(">4fH", found[0x03]) == pytest.approx((HALF, 0.0, 0.0, HALF, 1))
    assert struct.unpack(">3fH", found[0x08]) == (0.75, 0.75, 1.5, 1)
    assert struct.unpack(">3fH", found[0x09]) == pytest.approx((0.05, 0.05, 0.05, 1))


def test_a_receiver_packet() -> None:
    found = fields(microstrain.pack_receiver_frame(FIX), 0x91)
    assert struct.unpack(">dHH", found[0xD3])[:2] == (100_000.25, 2_371)
    assert struct.unpack(">BBHH", found[0x0B])[:2] == (0, 14)
    assert struct.unpack(">4d2fH", found[0x03])[:6] == (-8.8, -63.95, 60.5, 60.5, 0.75, 1.5)
    assert struct.unpack(">8fH", found[0x05])[:7] == pytest.approx((3.0, -4.0, 0.0, 5.0, 5.0, 306.8699, 0.05))
    geometric, position, horizontal, vertical, *_ = struct.unpack(">7fH", found[0x07])
    assert (horizontal, vertical) == (0.75, 1.5)
    assert geometric > position == pytest.approx(math.hypot(0.75, 1.5))


@pytest.mark.parametrize(("fix_type", "kind"), [(3, 0), (2, 1), (1, 3), (0, 3), (4, 0), (5, 5), (6, 6)])
def test_kinds_of_fix(fix_type: int, kind: int) -> None:
    """GPS_FIX_TYPE, where 1 is no fix, to the unit's."""
    assert fields(microstrain.pack_receiver_frame(FIX._replace(fix_type=fix_type)), 0x91)[0x0B][0] == kind
