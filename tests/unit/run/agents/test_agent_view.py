"""Sentences longer than one STATUSTEXT, from the agent's own chunks to the host's picture of it."""

from __future__ import annotations

import numpy as np
import pytest

from agent.fcu.mavlink.texts import Texts
from agent.wire import dialect
from agent.wire.codec import Packer, decode
from sim_core.geodesy import LocalFrame
from xitl_cli.run.agents.view import AgentView


@pytest.mark.parametrize("length", [1, 49, 50, 51, 99, 100, 101, 250])
def test_a_sentence_arrives_whole_whatever_its_length(length: int) -> None:
    said: list[tuple[int, str]] = []
    view = AgentView(LocalFrame(-8.8, -63.95, 70.0), lambda *words: said.append(words), lambda *_: None)
    sentence = "".join(np.random.default_rng(length).choice(list("abcdef"), length))
    texts, packer = Texts(), Packer(1, 1)
    for text in (sentence, "and the next"):
        for message in texts.messages(4, text):
            view.take(decode(packer.pack(message)))
    assert said == [(4, sentence), (4, "and the next")]
    assert list(view.texts) == [sentence, "and the next"]


@pytest.mark.parametrize(
    ("pair_ms", "older_ms", "told"), [(0, 0, True), (0, 20, False), (50, 50, True), (50, 51, False), (50, -20, False)]
)
def test_a_position_makes_an_estimate_with_an_attitude_that_is_not_too_old(
    pair_ms: int, older_ms: int, told: bool
) -> None:
    estimates: list[int] = []
    view = AgentView(LocalFrame(-8.8, -63.95, 70.0), lambda *_: None, lambda stamp_us, _: estimates.append(stamp_us))
    view.pair_ms = pair_ms
    assert not view.has_origin
    view.take(dialect.MAVLink_gps_global_origin_message(-88000000, -639500000, 70000))
    assert view.has_origin
    view.take(dialect.MAVLink_attitude_quaternion_message(1000 - older_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    view.take(dialect.MAVLink_local_position_ned_message(1000, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0))
    assert estimates == ([1_000_000] if told else [])
