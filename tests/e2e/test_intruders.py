"""Others send to the agent of a run: it goes on as if they had not, and says so."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path

import pytest
from conftest import payloads, running, summary

from agent.wire import dialect
from agent.wire.codec import Packer
from tests.free_ports import unread_bytes
from tests.patience import PATIENCE_S, wait_until

RUN = dialect.MAVLink_xitl_run_message
SPOOFED = (
    RUN(0, b"mine", dialect.XITL_RUN_COMMAND_START, dialect.XITL_CLOCK_MODE_REALTIME, 2),
    RUN(0, b"mine", dialect.XITL_RUN_COMMAND_STOP, dialect.XITL_CLOCK_MODE_REALTIME, 2),
    dialect.MAVLink_param_set_message(1, 1, b"WP_SPEED", 0.5, 9),
    dialect.MAVLink_xitl_faults_message(0, 0, 0.0, 1, 0, 0, 1.0, 0.0, 0.0, 0.0, 1),
    dialect.MAVLink_xitl_imu_message(0, (9.0, 9.0, 9.0), (0.0, 0.0, 0.0), 20.0),
)


@pytest.mark.slow
def test_a_run_is_not_taken_over_by_datagrams(tmp_path: Path, free_port: int) -> None:
    link = f"autopilot.link=udp://127.0.0.1:{free_port}"
    packer = Packer(255, 190)
    frames = [packer.pack(message) for message in SPOOFED]
    with (
        running(tmp_path, "--profile", "hitl-loopback", "--set", link, "--duration", "600") as process,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as intruder,
    ):
        for number in range(400):
            noise = os.urandom(number % 1400 + 1)
            for data in (frames[number % len(frames)], noise, b"\xfd" * 1400, frames[0][:7], b"".join(frames)):
                intruder.sendto(data, ("127.0.0.1", free_port))
            intruder.sendto(b"\xfd" * 60_000, ("127.0.0.1", free_port))
            wait_until(lambda: not unread_bytes(free_port))  # a full socket would drop what the host sends, too
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert errors == "", errors
    told = summary(tmp_path / "run")
    assert (told["ended"], told["error"]) == ("interrupted", None)
    sensors, actuators = told["links"]
    assert sensors["refused"] == sensors["dropped"] > 1000
    assert (sensors["lost"], actuators["lost"], actuators["refused"]) == (0, 0, 0)
    assert any(text.startswith(f"the agent refused {sensors['refused']} ") for text in told["warnings"])
    log = b"".join(data for _, data in payloads(tmp_path / "run/run.mcap")["/log"])
    assert b"not this run's host" in log
