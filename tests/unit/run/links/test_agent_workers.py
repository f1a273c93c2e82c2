"""Agents in processes beside the host's: they say what one in process says, end with the host, and are named."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from agent.assembly import assemble
from agent.node import AgentNode
from agent.options import Options
from agent.wire import dialect
from agent.wire.link import Link
from agent.wire.socket_pair import socket_pair
from agent.wire.transport import Transport
from tests.child_processes import child_processes
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.errors import UserError
from xitl_cli.run.links import agent_worker
from xitl_cli.run.links.agent_workers import AgentWorkers
from xitl_cli.run.links.peer import AgentOptions, InProcessAgent, Peer, own_options

TICKS = 100
START = dialect.MAVLink_xitl_run_message(
    0, b"test", dialect.XITL_RUN_COMMAND_START, dialect.XITL_CLOCK_MODE_LOCKSTEP, 1
)


@pytest.fixture
def workers() -> Iterator[AgentWorkers]:
    with closing(AgentWorkers(2)) as made:
        yield made


def tick(link: Link, peer: Peer, number: int) -> None:
    """With the samples of a vessel at rest."""
    for sample in range(4):
        stamp_us = number * 20_000 + sample * 5000
        link.send(dialect.MAVLink_xitl_imu_message(stamp_us, (0.0, 0.0, 0.0), (0.0, 0.0, -9.78), 20.0))
    link.send(dialect.MAVLink_xitl_tick_message(number * 20_000, number))
    peer.hand_over()


def answer(link: Link, peer: Peer, number: int) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        peer.pump()
        for message in link.receive(0.5):
            if isinstance(message, dialect.MAVLink_xitl_actuators_message) and message.tick == number:
                return
        peer.check()
    raise AssertionError("it was not answered")


def linked(peer: Peer) -> tuple[Link, list[bytes]]:
    """With the frames that come."""
    frames: list[bytes] = []
    link = Link(peer.transport, 255, 190, tap=lambda way, frame: frames.append(frame) if way == "rx" else None)
    link.send(START)
    return link, frames


@pytest.mark.medium
def test_each_says_and_logs_what_one_in_process_does(workers: AgentWorkers, tmp_path: Path) -> None:
    """Three in two processes, all given their ticks before the first is heard."""
    folders = [tmp_path / name for name in ("alone", "a", "b", "c")]
    for folder in folders:
        folder.mkdir()
    options = [AgentOptions(system_id=7, log_dir=folder) for folder in folders]
    peers: list[Peer] = [InProcessAgent(options[0])]
    peers += [workers.open(own_options(one), folder.name) for one, folder in zip(options[1:], folders[1:], strict=True)]
    links = [linked(peer) for peer in peers]
    for number in range(1, TICKS):
        for peer, (link, _) in zip(peers, links, strict=True):
            tick(link, peer, number)
        for peer, (link, _) in zip(peers, links, strict=True):
            answer(link, peer, number)
    for peer in peers:
        peer.close()
    ours, *others = (frames for _, frames in links)
    assert len(ours) > TICKS
    assert [frames == ours for frames in others] == [True] * 3
    logs = [next(folder.iterdir()).read_bytes() for folder in folders]
    assert len(logs[0]) > 10_000
    assert [log == logs[0] for log in logs[1:]] == [True] * 3


@pytest.mark.medium
def test_one_that_cannot_be_made_says_why_and_the_next_is(workers: AgentWorkers, tmp_path: Path) -> None:
    options = own_options(AgentOptions(controller=str(tmp_path / "nowhere.py")))
    with pytest.raises(UserError, match=r"nowhere\.py"):
        workers.open(options, "leader")
    workers.open(own_options(AgentOptions()), "follower").close()


def test_one_that_fails_says_why_and_the_others_go_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a worker in this process; its first agent raises at once."""

    def assembled(transport: Transport, options: Options, opened: ExitStack) -> AgentNode:
        node = assemble(transport, options, opened)
        if options.system_id == 1:
            monkeypatch.setattr(node, "poll", lambda: 1 // 0)
        return node

    monkeypatch.setattr(agent_worker, "assemble", assembled)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    worker = agent_worker.AgentWorker(theirs)
    thread = threading.Thread(target=worker.serve)
    thread.start()
    with ours, theirs:
        ours.settimeout(PATIENCE_S)
        ends, said = [], set()
        for number in (1, 2):
            here, there = socket_pair()
            with there:
                options = own_options(AgentOptions(system_id=number))
                socket.send_fds(ours, [pickle.dumps((number, options))], [there.fileno()])
            ends.append(here)
        for _ in range(3):
            said.add(pickle.loads(ours.recv(1 << 16)))
        assert said == {(1, ""), (2, ""), (1, "ZeroDivisionError('integer division or modulo by zero')")}
        steady = Link(ends[1], 255, 190)
        steady.send(START)
        assert steady.receive(PATIENCE_S)
        assert ends[0].receive(PATIENCE_S / 1000) == []
        assert ends[0].lost
        for end in ends:
            assert end.finish(PATIENCE_S)
            end.close()
        ours.shutdown(socket.SHUT_RDWR)
        thread.join()
    worker.close()
    assert "ZeroDivisionError" in capsys.readouterr().err


@pytest.mark.medium
def test_a_process_that_is_killed_names_those_beside() -> None:
    others = child_processes()
    with closing(AgentWorkers(1)) as one:
        agents = [one.open(own_options(AgentOptions()), name) for name in ("leader", "follower")]
        link, _ = linked(agents[0])
        (worker,) = child_processes() - others
        os.kill(worker, signal.SIGKILL)
        with pytest.raises(UserError, match="of this vessel and of follower ended: signal 9"):
            answer(link, agents[0], 1)
        for agent in agents:
            agent.close()


@pytest.mark.medium
def test_they_end_with_a_host_that_is_killed() -> None:
    code = (
        "from xitl_cli.run.links.agent_workers import AgentWorkers\n"
        "from xitl_cli.run.links.peer import AgentOptions, own_options\n"
        "agent = AgentWorkers(1).open(own_options(AgentOptions()), 'a')\n"
        "print(agent._worker._process.pid, flush=True)\n"
        "input()\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as host:
        assert host.stdout is not None
        worker = Path(f"/proc/{int(host.stdout.readline())}")
        assert worker.exists()
        host.kill()
        wait_until(lambda: not worker.exists() or "\nState:\tZ" in (worker / "status").read_text())
