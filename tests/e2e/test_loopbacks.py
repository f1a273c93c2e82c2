"""Every way of attaching a board, without one: the mission is sailed over each, in real time, with real parts."""

from __future__ import annotations

import os
import shutil
import subprocess
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from conftest import command, environment, summary

from tests.patience import PATIENCE_S

# A network that ends at this machine: multicast goes nowhere else, and no port here is in the way.
ALONE = 'ip link set lo up multicast on && ip route add 239.0.0.0/8 dev lo && exec "$@"'
SHORT = ("--set", "mission.waypoints_ned_m=[[8.0, 6.0], [24.0, 18.0]]")
MULTICAST = "autopilot.link=can://udp_multicast/239.74.163.2?bitrate=1000000"
LOOPBACKS = {
    "udp": ("hitl-beaglebone-loopback",),
    "serial": ("hitl-serial-loopback",),
    "can": ("hitl-can-loopback",),
    "canfd": ("hitl-canfd-loopback",),
    "can by multicast": ("hitl-can-loopback", "--set", MULTICAST),
    "canfd by multicast": ("hitl-canfd-loopback", "--set", f"{MULTICAST}&data_bitrate=5000000&fd=true"),
}
FEW = ("udp", "serial", "can")
"""The others are nightly."""
AT_ONCE = 3  # together they keep about one processor busy

pytestmark = pytest.mark.realtime  # beside others a reader stands still for a second, and a line loses frames


@pytest.fixture(scope="module")
def runs(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The run directories of the loopbacks that a selected test reads."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip("needs root and ip, to make a network of its own (apt install iproute2)")
    folder = tmp_path_factory.mktemp("loopbacks")
    here = [item for item in request.session.items if item.path == request.path]
    selected = list(dict.fromkeys(item.callspec.params["told"] for item in here if isinstance(item, pytest.Function)))
    names_left = iter(selected)
    while names := list(islice(names_left, AT_ONCE)):
        started = {name: start(folder, name) for name in names}
        for name, process in started.items():
            _, errors = process.communicate(timeout=3 * PATIENCE_S)
            assert process.returncode == 0, f"{name}: {errors}"
    return {name: folder / name for name in selected}


def start(folder: Path, name: str) -> subprocess.Popen[str]:
    profile, *rest = LOOPBACKS[name]
    words = command("sim", "--profile", profile, *SHORT, *rest, "--out", name)
    return subprocess.Popen(
        ["unshare", "--net", "sh", "-c", ALONE, "sh", *words],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture(
    params=[pytest.param(name, marks=[] if name in FEW else pytest.mark.nightly) for name in LOOPBACKS], ids=LOOPBACKS
)
def told(request: pytest.FixtureRequest, runs: dict[str, Path]) -> dict[str, Any]:
    return summary(runs[request.param])


def test_the_mission_is_completed(told: dict[str, Any]) -> None:
    assert told["mission"]["completed"]
    assert told["clock"] == "realtime"
    assert told["mission"]["cross_track_rms_m"] < 4.0  # what the paper's vessel keeps in gusts


def test_every_frame_is_accounted_for(told: dict[str, Any]) -> None:
    for link in told["links"]:
        assert link["sent"] > 500
        assert link["sent"] == link["received"] + link["lost"]
        assert (link["lost"], link["dropped"], link["repeated"], link["refused"]) == (0, 0, 0, 0), link


def test_the_clocks_are_related(told: dict[str, Any]) -> None:
    """One machine, so one clock: the drift that is found between the two processes is the error of the method.

    Over the run it may tilt the line by no more than the exchanges scatter about it, taken as three times their RMS:
    some 20 ppm over UDP, more on a slow line, where frames wait for others.
    """
    clock = next(clock for clock in told["clocks"] if clock["node"] == "LC")
    assert abs(clock["drift_ppm"]) * told["duration_s"] < 3.0 * clock["residual_us"]
    assert clock["steps"] == 0
    assert clock["samples"] > 100
