"""A run that waits for a node in another process is the same bytes twice, and again from its recording without it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import Xitl, differences, payloads, summary
from ros2 import own_domain

pytest.importorskip("cyclonedds")
pytestmark = pytest.mark.slow
DOMAIN = {"ROS_DOMAIN_ID": str(own_domain())}
LOCKSTEP = ("--set", "ros.lockstep={nodes: [helm], step_s: 0.1, timeout_s: 60}", "--set", "ros.pace=null")
RUN = ("sim", "ros-thrusters", "--clock", "lockstep", "--duration", "5", *LOCKSTEP)


@contextmanager
def helm() -> Iterator[None]:
    node = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("cyclone_helm.py")), "100000000"], env=os.environ | DOMAIN
    )
    try:
        yield
    finally:
        node.kill()
        node.wait()


def test_a_run_that_waits_for_a_node_repeats(xitl: Xitl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", DOMAIN["ROS_DOMAIN_ID"])
    for name in ("one", "other"):
        with helm():
            ran = xitl(*RUN, "--set", "ros.way=cyclonedds", "--out", name)
        assert ran.returncode == 0, ran.stderr
    told = summary(tmp_path / "one")
    assert told["ros"]["lockstep"]["standstills"] == 50
    assert told["ros"]["lockstep"]["unanswered"] == {}
    assert told["operator"]["actions"] == {"velocity": 49}  # that of the last standstill comes too late
    assert told["operator"]["superseded"] == 0
    again = xitl(*RUN, "--no-ros", "--replay-events", "one", "--out", "again")
    assert again.returncode == 0, again.stderr
    one, other, replayed = (payloads(tmp_path / name / "run.mcap") for name in ("one", "other", "again"))
    for each in (one, other, replayed):
        each.pop("/log", None)  # what the bridge says of other nodes hangs on the network
    assert one.keys() == other.keys()
    assert differences(one, other) == {}
    assert set(one) - set(replayed) <= {"/link/agent/tx"}  # sensors that nobody but nodes of ROS hears
    assert differences(replayed, one) == {}
