"""Sentences longer than one STATUSTEXT, from the agent's own chunks to the host's picture of it."""

from __future__ import annotations

import numpy as np
import pytest

from agent.fcu.mavlink.texts import Texts
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
