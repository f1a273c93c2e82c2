"""Commands on the wire: as many as the vessel has, at no more bytes than these take."""

from __future__ import annotations

import pytest

from agent.wire.actuators import COMMANDS_ON_WIRE, EXTENSION_BYTES, actuators_message, commands_of
from agent.wire.codec import Packer, decode

EIGHT_BYTES = 74


@pytest.mark.parametrize("count", [0, 2, 5, 8, 9, COMMANDS_ON_WIRE])
def test_they_arrive_as_they_were_sent(count: int) -> None:
    sent = tuple((number + 1) / 32 for number in range(count))
    frame = Packer(1, 1).pack(actuators_message(sent, True, 11, 12, 2**63, 14, failsafe=True))
    message = decode(frame)
    assert commands_of(message) == sent
    assert message.tick == 14
    assert message.flags == 3
    assert len(frame) == EIGHT_BYTES + (4 * (count - 8) if count > 8 else 0)
    assert len(frame) <= EIGHT_BYTES + EXTENSION_BYTES
