"""What is said when an agent cannot be reached: where, and what to look at."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.wire import dialect
from agent.wire.codec import Packer
from agent.wire.memory import memory_pair
from agent.wire.signing import Signing
from sim_core.geodesy import LocalFrame
from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.run.links.connection import AgentConnection
from xitl_cli.run.links.inbox import AgentInbox
from xitl_cli.run.links.peer import AgentOptions, BoardAgent, InProcessAgent

KEY = bytes(range(32))


@pytest.mark.parametrize(
    ("url", "there"),
    [("udp://127.0.0.1:14660", "udp://127.0.0.1:14660"), ("udp://localhost:14660", "udp://usb0:14660")],
)
def test_an_agent_is_to_wait_at_the_address_of_the_link_alone(url: str, there: str) -> None:
    board = BoardAgent(url, AgentOptions())
    said = str(board.unreachable(6.0))
    board.close()
    assert said.startswith(f"{url}: no agent answered within 6 s; check that ")
    assert f"`xitl agent --link {there}`" in said
    assert "link key" in said


def test_a_companion_is_to_be_started_as_one(golden: Golden) -> None:
    board = BoardAgent("udp://127.0.0.1:14661", AgentOptions(companion=True))
    said = str(board.unreachable(6.0))
    board.close()
    golden("message", said, "6 s")
    assert "`xitl agent --role companion --link udp://127.0.0.1:14661`" in said


def test_an_agent_of_another_vessel_is_told_in_one_sentence(golden: Golden) -> None:
    profile = load_profile("sitl", ["autopilot.system_id=7"]).runnable()
    inbox = AgentInbox("agent", LocalFrame(-8.8, -63.95, 70.0), 2, True, lambda stamp_ns, estimate: None)
    peer = InProcessAgent(AgentOptions(3))
    with pytest.raises(UserError) as refused:
        AgentConnection("agent", profile, inbox).reach(peer)
    golden("error", refused.value)
    peer.close()


class Foreign(InProcessAgent):
    """An agent whose every frame has another checksum, as that of a message with other fields has."""

    def __init__(self) -> None:
        self.transport, self.theirs = memory_pair("agent")

    def pump(self) -> None:
        if self.theirs.receive():
            frame = Packer(1, 1).pack(dialect.MAVLink_xitl_tick_message(0, 0))
            self.theirs.send(frame[:-2] + bytes(byte ^ 0xFF for byte in frame[-2:]))

    def close(self) -> None:
        self.theirs.close()
        self.transport.close()


def test_an_agent_of_another_release_is_told_from_one_that_is_not_there(golden: Golden) -> None:
    """This host never gets to see which version it is."""
    profile = load_profile("hitl-beaglebone", ["autopilot.connect_timeout_s=0.2"]).runnable()
    inbox = AgentInbox("agent", LocalFrame(-8.8, -63.95, 70.0), 2, False, lambda stamp_ns, estimate: None)
    peer = Foreign()
    with pytest.raises(UserError) as refused:
        AgentConnection("agent", profile, inbox).reach(peer)
    golden("error", refused.value)
    peer.close()


def test_an_agent_that_does_not_sign_is_told_from_one_that_is_not_there(tmp_path: Path, golden: Golden) -> None:
    key = tmp_path / "key"
    key.write_text(KEY.hex())
    key.chmod(0o600)
    given = [f"autopilot.link_key_file={key}", "autopilot.connect_timeout_s=0.2"]
    profile = load_profile("hitl-beaglebone", given).runnable()
    inbox = AgentInbox("agent", LocalFrame(-8.8, -63.95, 70.0), 2, False, lambda stamp_ns, estimate: None)
    connection = AgentConnection("agent", profile, inbox, Signing(KEY))
    peer = InProcessAgent(AgentOptions())
    with pytest.raises(UserError) as refusal:
        connection.reach(peer)
    peer.close()
    golden("error", refusal.value, key=key)
