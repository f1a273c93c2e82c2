"""A simulated boat and its twin, over UDP. Slow: both follow the clock."""

from __future__ import annotations

import json
import lzma
import socket
import subprocess
import time
from pathlib import Path

import pytest
from conftest import command, environment

from tests.free_ports import free_port
from xitl_cli.logs import open_log

LOG = Path(__file__).parents[1] / "data" / "captures" / "twin-port-thrust.tlog.xz"
FASTER = 4.0
"""Boat clocks need not follow the wall clock: the twin uses the boot clock of the boat."""


@pytest.mark.slow
def test_a_boat_over_udp_is_followed_and_hears_nothing(tmp_path: Path) -> None:
    port = free_port()
    words = ["twin", "--boat", f"udp://127.0.0.1:{port}", "--vehicle", "otter", "--out", "boat.mcap"]
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as boat,
        subprocess.Popen(
            command(*words, "--seconds", "82", "--json"),
            cwd=tmp_path,
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as twin,
    ):
        boat.bind(("127.0.0.1", 0))
        boat.setblocking(False)
        send_log(boat, port, twin)
        output, errors = twin.communicate(timeout=60)
        with pytest.raises(BlockingIOError):
            boat.recv(1)
    assert twin.returncode == 1, output + errors
    report = json.loads(output)
    assert report["alarms"][0]["kind"] == "thrust port"
    assert report["system_id"] == 1
    with open_log(tmp_path / "boat.mcap") as log:
        assert "/twin/alarm" in log.tables


def send_log(boat: socket.socket, port: int, twin: subprocess.Popen[str]) -> None:
    """Send the frames of the log from the moment at which the twin listens, faster than they were recorded."""
    while not listens(port):
        assert twin.poll() is None, twin.communicate()
        time.sleep(0.05)
    data = lzma.decompress(LOG.read_bytes())
    began_s, first_us, at = time.monotonic(), int.from_bytes(data[:8], "big"), 0
    while at + 10 < len(data) and twin.poll() is None:
        end = at + 20 + data[at + 9]
        due_s = (int.from_bytes(data[at : at + 8], "big") - first_us) * 1e-6 / FASTER
        time.sleep(max(due_s - (time.monotonic() - began_s), 0.0))
        boat.sendto(data[at + 8 : end], ("127.0.0.1", port))
        at = end


def listens(port: int) -> bool:
    """Return whether a program has bound the UDP port of the loopback address."""
    return f"0100007F:{port:04X}" in Path("/proc/net/udp").read_text()
