"""VectorNav: binary frames against the unit's manual, and the command port as ArduPilot's driver uses it."""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.bridges import vectornav
from agent.bridges.readings import InertialSample, Navigation, ReceiverFix
from agent.bridges.vectornav import INERTIAL, RECEIVER, SOLUTION, CommandPort, sentence

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
    assert rest[6:9] == pytest.approx([0.75 / 2**0.5, 0.75 / 2**0.5, 1.5])  # north, east, up
    assert rest[9] == pytest.approx(0.05)
    geometric, position, time, vertical, horizontal, north, east = rest[10:17]
    assert (vertical, horizontal) == (1.5, 0.75)
    assert position == pytest.approx(math.hypot(vertical, horizontal))
    assert geometric == pytest.approx(math.hypot(position, time))
    assert math.hypot(north, east) == pytest.approx(horizontal)
    assert rest[17:] == [14, 3]


SET_UP = (
    "VNASY,0",
    "VNWRG,06,0,1",
    "VNWRG,06,0,2",
    "VNRRG,01",
    "VNWRG,75,3,2,01,0721",
    "VNWRG,76,3,8,31,0001,0106,0613",
    "VNWRG,77,3,80,49,0003,26B8,0018",
    "VNASY,1",
)


def answers(port: CommandPort, *bodies: str) -> list[str]:
    return [answer.decode() for body in bodies for answer in port.feed(sentence(body))]


def test_set_up() -> None:
    port = CommandPort()
    found = answers(port, *SET_UP)
    assert found == [sentence("VNRRG,01,VN-300" if body == "VNRRG,01" else body).decode() for body in SET_UP]
    assert port.set_up
    assert port.divisors == {INERTIAL: 2, SOLUTION: 8, RECEIVER: 80}
    assert (port.commands, port.refused, port.restarts, port.junk) == (8, 0, 0, 0)


def test_type_and_rate_of_the_text_output_are_registers_6_and_7_of_each_port() -> None:
    port = CommandPort()
    answers(port, "VNWRG,06,14,1", "VNWRG,07,20,2")
    asked = ("VNRRG,06,1", "VNRRG,06,2", "VNRRG,07,1", "VNRRG,07,2")
    assert answers(port, *asked) == [
        sentence(f"{body[:8]},{value}").decode() for body, value in zip(asked, (14, 0, 40, 20), strict=True)
    ]
    answers(port, "VNWRG,07,5")
    assert answers(port, *asked[2:]) == [sentence("VNRRG,07,5").decode()] * 2


def test_nothing_is_set_up_before_the_outputs_are_on() -> None:
    port = CommandPort()
    for body in SET_UP[:-1]:
        answers(port, body)
        assert not port.set_up


def test_set_up_again_is_a_restart() -> None:
    port = CommandPort()
    answers(port, *SET_UP)
    answers(port, "VNASY,0")
    assert not port.set_up
    answers(port, "VNASY,0", *SET_UP[1:])
    assert port.set_up
    assert port.restarts == 1


def test_a_checksum_of_the_manual() -> None:
    """The header of the driver's inertial packet as the unit's maker writes it, with a 16-bit checksum."""
    port = CommandPort()
    assert port.feed(b"$VNWRG,75,3,16,01,0721*D415\r\n") == [sentence("VNWRG,75,3,16,01,0721")]
    assert port.divisors == {INERTIAL: 16}


def test_no_checksum_when_it_says_so() -> None:
    assert CommandPort().feed(b"$VNRRG,01*XX\r\n") == [sentence("VNRRG,01,VN-300")]


@pytest.mark.parametrize(
    ("line", "number"),
    [
        (b"$VNASY,0*00\r\n", 3),
        (b"$VNASY,0\r\n", 3),
        (sentence("VNABC,1"), 4),
        (sentence(""), 4),
        (sentence("VNASY"), 5),
        (sentence("VNWRG,06"), 5),
        (sentence("VNWRG,75,3,2,01"), 5),
        (sentence("VNASY,0,1"), 6),
        (sentence("VNWRG,75,3,2,01,0721,0001"), 6),
        (sentence("VNASY,2"), 7),
        (sentence("VNWRG,06,0,3"), 7),
        (sentence("VNWRG,75,3,2,01,0720"), 7),
        (sentence("VNWRG,75,3,0,01,0721"), 7),
        (sentence("VNRRG,seventy"), 7),
        (sentence("VNRRG,99"), 8),
        (sentence("VNWRG,99,0"), 8),
        (sentence("VNWRG,01,VN-100"), 9),
    ],
)
def test_refusals(line: bytes, number: int) -> None:
    port = CommandPort()
    assert port.feed(line) == [sentence(f"VNERR,{number:02X}")]
    assert port.refused == 1


def test_registers_are_read_back() -> None:
    port = CommandPort()
    answers(port, *SET_UP)
    assert answers(port, "VNRRG,76") == [sentence("VNRRG,76,3,8,31,0001,0106,0613").decode()]
    assert answers(port, "VNRRG,06,2") == [sentence("VNRRG,06,0").decode()]
    answers(port, "VNWRG,76,0,8,31,0001,0106,0613")
    assert answers(port, "VNRRG,76") == [sentence("VNRRG,76,0,1,00").decode()]


def test_a_reset_forgets() -> None:
    port = CommandPort()
    answers(port, *SET_UP, "VNWNV")
    assert answers(port, "VNRST") == [sentence("VNRST").decode()]
    assert not port.divisors


def test_commands_in_pieces_between_other_bytes() -> None:
    port = CommandPort()
    data = b"\xfa\x01\x21" + sentence("VNASY,0")
    found = [answer for index in range(len(data)) for answer in port.feed(data[index : index + 1])]
    assert found == [sentence("VNASY,0")]
    assert port.junk == 3


def test_an_endless_line_is_dropped() -> None:
    port = CommandPort()
    assert port.feed(b"$" + 1000 * b"A") == []
    assert port.junk == 1001
    assert port.feed(sentence("VNASY,1")) == [sentence("VNASY,1")]


def test_a_command_of_foreign_letters_is_refused() -> None:
    assert CommandPort().feed(b"$VNWRG,75,0,\xe9*XX\r\n") == [sentence("VNERR,04")]


@pytest.mark.medium
@given(st.lists(st.one_of(st.binary(max_size=40), st.sampled_from([sentence(body) for body in SET_UP])), max_size=12))
def test_anything_is_answered_or_counted(chunks: list[bytes]) -> None:
    port = CommandPort()
    found = [answer for chunk in chunks for answer in port.feed(chunk)]
    assert len(found) == port.commands
    assert all(answer.startswith(b"$VN") and answer.endswith(b"\r\n") for answer in found)
