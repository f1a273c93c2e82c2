"""Pings on the wire: through the codec and back, with chunks lost, swapped, repeated and wrong."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from agent.companion.sonar import PingReassembler, SonarPing, ping_messages
from agent.wire.codec import Message, Packer, decode


def ping(number: int = 0, samples: int = 600) -> SonarPing:
    intensity = (np.arange(samples) * 7 + number).astype(np.uint8)
    return SonarPing(number, 5_000_000_000 + number * 1000, 399, (0.5, 0.0, 0.25), 6.65e-5, 1500.0, intensity)


def over_the_wire(one: SonarPing) -> list[Message]:
    packer = Packer(1, 1)
    return [decode(packer.pack(message)) for message in ping_messages(one)]


def same(one: SonarPing, other: SonarPing) -> None:
    assert one.intensity.tolist() == other.intensity.tolist()
    assert one._replace(intensity=other.intensity, sample_period_s=0.0) == other._replace(sample_period_s=0.0)
    assert one.sample_period_s == pytest.approx(other.sample_period_s, rel=1e-6)  # a float on the wire


@pytest.mark.parametrize("samples", [1, 199, 200, 201, 600, 1200])
def test_a_ping_comes_through(samples: int) -> None:
    pings = PingReassembler()
    (taken,) = [found for message in over_the_wire(ping(7, samples)) for found in pings.handle(message)]
    same(taken, ping(7, samples))


def test_order_and_repetition_do_not_matter() -> None:
    pings = PingReassembler()
    first, second, third = over_the_wire(ping())
    assert pings.handle(third) == pings.handle(first) == pings.handle(first) == []
    (taken,) = pings.handle(second)
    same(taken, ping())
    assert pings.handle(third) == []
    assert (pings.pings, pings.late, pings.refused, pings.chunks_lost) == (1, 2, 0, 0)


def test_a_lost_chunk_is_silence_and_counted() -> None:
    pings = PingReassembler()
    first, _, third = over_the_wire(ping(65535))
    pings.handle(first)
    pings.handle(third)
    following = over_the_wire(ping(0))  # numbers go round
    (given_up,) = pings.handle(following[0])
    assert given_up.chunks_lost == pings.chunks_lost == 1
    assert not given_up.intensity[200:400].any()
    assert given_up.intensity[400:].tolist() == ping(65535).intensity[400:].tolist()
    pings.handle(following[1])
    (taken,) = pings.handle(following[2])
    same(taken, ping(0))


def test_a_straggler_of_an_earlier_ping_disturbs_nothing() -> None:
    pings = PingReassembler()
    old, new = over_the_wire(ping(1)), over_the_wire(ping(2))
    pings.handle(old[0])
    pings.handle(new[0])
    assert pings.handle(old[1]) == []
    pings.handle(new[1])
    (taken,) = pings.handle(new[2])
    same(taken, ping(2))
    assert pings.late == 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"samples": 0},
        {"samples": 1201},
        {"first": 600},
        {"first": 3},
        {"count": 0},
        {"count": 199},
        {"count": 255},
        {"angle": 400},
        {"position": [0.0, math.nan, 0.0]},
        {"sample_period": 0.0},
        {"sample_period": math.nan},
        {"sound_speed": math.inf},
    ],
)
def test_what_cannot_be_is_refused(wrong: dict[str, Any]) -> None:
    pings = PingReassembler()
    chunks = over_the_wire(ping())
    for name, value in wrong.items():
        setattr(chunks[1], name, value)
    assert [pings.handle(chunk) for chunk in chunks] == [[], [], []]
    assert (pings.refused, pings.pings) == (1, 0)


def test_a_chunk_of_another_length_of_the_same_ping_is_refused() -> None:
    pings = PingReassembler()
    pings.handle(over_the_wire(ping(3, 600))[0])
    assert pings.handle(over_the_wire(ping(3, 500))[1]) == []
    assert pings.refused == 1
