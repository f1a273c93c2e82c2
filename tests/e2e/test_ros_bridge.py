"""A run whose bridge to ROS hangs and is killed goes on and says so, and nothing of it stays."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest
from conftest import command, environment, newest_time_s
from ros2 import own_domain

from tests.patience import PATIENCE_S, wait_until

pytest.importorskip("cyclonedds")
pytestmark = pytest.mark.slow
PACED = ("--set", "ros.pace=4", "--set", "ros.queue_mb=0.5", "--set", "ros.way=cyclonedds")
"""Its mission takes 40 s, of which the test needs some 13."""


def bridge_of(run: int) -> int:
    """The process of a run's bridge, whose command is empty while it begins."""

    def bridges() -> list[int]:
        children = [int(child) for child in Path(f"/proc/{run}/task/{run}/children").read_text().split()]
        return [one for one in children if b"xitl_cli.plugins.ros.process" in Path(f"/proc/{one}/cmdline").read_bytes()]

    (bridge,) = wait_until(bridges, "there is no bridge")
    return bridge


@pytest.mark.nightly
def test_a_bridge_that_hangs_and_is_killed_holds_nothing_up(tmp_path: Path) -> None:
    log = tmp_path / "said.txt"
    with log.open("w") as told:
        run = subprocess.Popen(
            command("sim", "sitl", "--ros", *PACED, "--out", "run"),
            cwd=tmp_path,
            env=environment() | {"ROS_DOMAIN_ID": str(own_domain())},
            stdout=told,
            stderr=subprocess.STDOUT,
        )
    try:
        wait_until(lambda: "HOLD" in log.read_text())
        bridge = bridge_of(run.pid)
        os.kill(bridge, signal.SIGSTOP)
        wait_until(lambda: "has accepted no data for 5 s" in log.read_text())
        hung_s = newest_time_s(log.read_text())
        wait_until(lambda: newest_time_s(log.read_text()) > hung_s + 30.0)  # what waits for it is too much
        os.kill(bridge, signal.SIGKILL)
        wait_until(lambda: "the run continues without it (signal 9)" in log.read_text())
        run.send_signal(signal.SIGINT)
        assert run.wait(PATIENCE_S) == 130
    finally:
        run.kill()
        run.wait()
    assert not Path(f"/proc/{bridge}").exists()
    summary = json.loads((tmp_path / "run/summary.json").read_text())
    assert [text.partition(";")[0] for text in summary["warnings"] if text.startswith("ros:")] == [
        "ros: the bridge has accepted no data for 5 s",
        "ros: the bridge has ended",
    ]
    assert sum(summary["ros"]["dropped"].values()) > 0
    assert summary["ros"]["dropped"].get("/truth/odometry", 0) > 0
