"""The command port of the simulated VectorNav: set-up, refusals, damage."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.bridges.vectornav import INERTIAL, RECEIVER, SOLUTION, CommandPort, sentence

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


@given(st.lists(st.one_of(st.binary(max_size=40), st.sampled_from([sentence(body) for body in SET_UP])), max_size=12))
def test_anything_is_answered_or_counted(chunks: list[bytes]) -> None:
    port = CommandPort()
    found = [answer for chunk in chunks for answer in port.feed(chunk)]
    assert len(found) == port.commands
    assert all(answer.startswith(b"$VN") and answer.endswith(b"\r\n") for answer in found)
