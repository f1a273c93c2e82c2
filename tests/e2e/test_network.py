"""Host and agent on two machines: network namespaces, joined by a veth pair as by a USB-Ethernet cable."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import command, environment, summary

from tests.patience import PATIENCE_S, let_pass

HOST, BOARD, PORT = "192.168.7.1", "192.168.7.2", 14660
ELSEWHERE_HOST, ELSEWHERE_BOARD = "192.168.50.1", "192.168.50.2"
LINK = f"udp://{BOARD}:{PORT}"
CALM = {
    "environment.current.speed_mps": "0",
    "environment.current.deviation_mps": "0",
    "environment.waves.spectrum": "none",
    "environment.wind.mean_mps": "0",
    "environment.wind.gust.spectrum": "none",
}
ASKS = """\
import socket, sys
from agent.wire import dialect
from agent.wire.link import Link
from agent.wire.transport import open_transport
with open_transport(sys.argv[1], listen=False) as transport:
    link = Link(transport, 255, 190)
    for _ in range(5):
        message = dialect.MAVLink_xitl_run_message(0, b"asks", dialect.XITL_RUN_COMMAND_HELLO, 0, 2)
        link.send(message)
        if list(link.receive(0.3)):
            print("answered")
            break
"""


class Cable:
    """Two namespaces. `usb0` in both is the link; `lan0` in both is another network that the board is in as well."""

    def __init__(self) -> None:
        tag = os.getpid()
        self.host, self.board = f"xitl-host-{tag}", f"xitl-board-{tag}"
        self.started: list[subprocess.Popen[str]] = []

    def plug(self) -> None:
        for space in (self.host, self.board):
            ip("netns", "add", space)
            ip("-n", space, "link", "set", "lo", "up")
        for name, host, board in (("usb0", HOST, BOARD), ("lan0", ELSEWHERE_HOST, ELSEWHERE_BOARD)):
            ip("link", "add", name, "netns", self.host, "type", "veth", "peer", "name", name, "netns", self.board)
            for space, address in ((self.host, host), (self.board, board)):
                ip("-n", space, "address", "add", f"{address}/24", "dev", name)
                ip("-n", space, "link", "set", name, "up")

    def cut(self, is_cut: bool) -> None:
        ip("-n", self.board, "link", "set", "usb0", "down" if is_cut else "up")

    def start(self, space: str, *words: str, cwd: Path) -> subprocess.Popen[str]:
        """Run the words there."""
        process = subprocess.Popen(
            ["ip", "netns", "exec", space, *words],
            cwd=cwd,
            env={**environment(), "PYTHONPATH": os.pathsep.join(sys.path)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.started.append(process)
        return process

    def unplug(self) -> None:
        for process in self.started:
            if process.poll() is None:
                process.kill()
            process.communicate()
        for space in (self.host, self.board):
            ip("netns", "delete", space, check=False)


def ip(*words: str, check: bool = True) -> None:
    done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0 or not check, f"ip {' '.join(words)}: {done.stderr}"


@pytest.fixture
def cable() -> Iterator[Cable]:
    if shutil.which("ip") is None or os.geteuid() != 0:
        pytest.skip("needs root and ip, to make network namespaces (apt install iproute2)")
    probe = f"xitl-probe-{os.getpid()}"
    tried = subprocess.run(["ip", "netns", "add", probe], capture_output=True, text=True, check=False)
    if tried.returncode:
        pytest.skip(f"no network namespaces here: {tried.stderr.strip()}")
    ip("netns", "delete", probe)
    made = Cable()
    try:
        made.plug()
        yield made
    finally:
        made.unplug()


@pytest.fixture
def agent(cable: Cable, tmp_path: Path) -> subprocess.Popen[str]:
    """The packaged agent on the board, at the link's interface alone."""
    subprocess.run(command("agent", "package"), cwd=tmp_path, env=environment(), check=True, capture_output=True)
    words = (sys.executable, "-I", str(tmp_path / "xitl-agent.pyz"), "--link", f"udp://usb0:{PORT}")
    process = cable.start(cable.board, *words, "--log-dir", str(tmp_path / "logs"), cwd=tmp_path)
    assert process.stdout is not None
    assert f"waits at {LINK}" in process.stdout.readline()
    return process


def sim(cable: Cable, tmp_path: Path, *overrides: str) -> subprocess.Popen[str]:
    settings = {"autopilot.link": LINK, **CALM}
    words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    run = ("sim", "--profile", "hitl-beaglebone", *words, *overrides, "--out", "run")
    return cable.start(cable.host, *command(*run), cwd=tmp_path)


def assert_all_accounted_for(told: dict[str, object]) -> None:
    links = told["links"]
    assert isinstance(links, list)
    for link in links:
        assert link["sent"] == link["received"] + link["lost"], link


@pytest.mark.slow
def test_a_mission_over_the_cable(cable: Cable, agent: subprocess.Popen[str], tmp_path: Path) -> None:
    host = sim(cable, tmp_path, "--set", "mission.waypoints_ned_m=[[8.0, 6.0], [24.0, 18.0]]")
    _, errors = host.communicate(timeout=3 * PATIENCE_S)
    assert host.returncode == 0, errors
    told = summary(tmp_path / "run")
    assert told["mission"]["completed"]
    assert told["mission"]["waypoints_reached"] == 2
    assert [link["lost"] for link in told["links"]] == [0, 0]
    assert_all_accounted_for(told)
    agent.send_signal(signal.SIGTERM)
    agent.communicate(timeout=PATIENCE_S)
    assert agent.returncode == 0
    assert list((tmp_path / "logs").glob("*.BIN"))


@pytest.mark.nightly
@pytest.mark.slow
def test_a_cable_that_is_out_for_five_seconds(cable: Cable, agent: subprocess.Popen[str], tmp_path: Path) -> None:
    """The interface goes down in earnest: the host's sends fail, and the run goes on when it is back."""
    host = sim(cable, tmp_path, "--duration", "25")
    let_pass(12.0)
    cable.cut(True)
    let_pass(5.0)
    cable.cut(False)
    _, errors = host.communicate(timeout=3 * PATIENCE_S)
    assert host.returncode == 0, errors  # the duration that was asked for is over
    assert agent.poll() is None
    told = summary(tmp_path / "run")
    assert told["ended"] == "duration reached"
    assert told["duration_s"] == pytest.approx(25.0, abs=0.1)
    sensors = told["links"][0]
    assert sensors["lost"] + sensors["unsent"] > 500  # 100 IMU samples a second alone
    assert_all_accounted_for(told)


@pytest.mark.slow
def test_only_the_link_reaches_the_agent(cable: Cable, agent: subprocess.Popen[str], tmp_path: Path) -> None:
    def answers(url: str) -> bool:
        asked = cable.start(cable.host, sys.executable, "-c", ASKS, url, cwd=tmp_path)
        said, errors = asked.communicate(timeout=PATIENCE_S)
        assert errors == ""
        return "answered" in said

    assert answers(LINK)
    assert not answers(f"udp://{ELSEWHERE_BOARD}:{PORT}")
    # To the link's own address, but in by the other interface: the kernel delivers that, the agent must not take it.
    ip("-n", cable.host, "link", "set", "usb0", "down")
    ip("-n", cable.host, "route", "replace", f"{BOARD}/32", "via", ELSEWHERE_BOARD, "dev", "lan0")
    assert not answers(LINK)
    assert agent.poll() is None
