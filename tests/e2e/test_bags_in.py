"""Bags where a log is taken: of a run that was exported, injected, replayed, compared and shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Xitl, summary

from xitl_cli.logs import open_log

INJECTED = """
extends: sitl
driver: {kind: none}
mission: {waypoints_ned_m: []}
sensors:
  recorded: {file: boat.bag}
"""


@pytest.mark.slow
def test_a_bag_is_compared_shown_replayed_and_injected(xitl: Xitl, tmp_path: Path) -> None:
    assert xitl("sim", "--profile", "sitl", "--duration", "40", "--out", "run").returncode in (0, 1)
    done = xitl("logs", "export", "run/run.mcap", "--format", "rosbag1", "--out", "boat.bag")
    assert done.returncode == 0, done.stderr
    for arguments in (
        ("logs", "info", "boat.bag"),
        ("logs", "analyze", "boat.bag"),
        ("logs", "dump", "boat.bag", "/fix", "--until", "2"),
        ("logs", "plot", "boat.bag", "/odometry.pose.pose.position.x", "--out", "plot.html"),
        ("logs", "export", "boat.bag", "--format", "csv", "--out", "tables"),
        ("logs", "compare", "run/run.mcap", "boat.bag"),
    ):
        done = xitl(*arguments)
        assert done.returncode == 0, f"{arguments}: {done.stderr}"
        assert "Traceback" not in done.stderr

    # The autopilot of a vessel that lies still is given what the one under way has measured, and believes it.
    (tmp_path / "injected.yaml").write_text(INJECTED)
    done = xitl("sim", "--profile", "injected.yaml", "--duration", "38", "--out", "injected")
    assert done.returncode in (0, 1), done.stderr
    counts = summary(tmp_path / "injected")["recorded_sensors"]
    assert {name: each["skipped"] for name, each in counts.items()} == dict.fromkeys(
        ("imu", "gnss", "magnetometer", "barometer"), 0
    )
    assert counts["imu"]["sent"] >= 7500
    with open_log(tmp_path / "run/run.mcap") as first, open_log(tmp_path / "injected/run.mcap") as second:
        ahead, again = first["/estimate/odometry"], second["/estimate/odometry"]
        for axis in "xy":
            name = f"pose.pose.position.{axis}"
            there = np.interp(again.stamp_ns, ahead.stamp_ns, ahead[name])
            late = again.stamp_ns > 20 * 10**9  # once it has settled
            # The same samples, rounded as messages of ROS and of the link do: a GNSS fix to 1e-7 degrees, 1 cm.
            assert np.abs(again[name] - there)[late].max() < 0.5
        assert np.ptp(again["pose.pose.position.x"]) > 20.0
        assert np.ptp(second["/truth/odometry"]["pose.pose.position.x"]) < 40.0

    # Its motor commands drive a vessel without an autopilot.
    settings = ("technique=mitl", "autopilot.kind=none", "driver.kind=replay", "driver.file=boat.bag")
    done = xitl("sim", "--profile", "sitl", *(word for each in settings for word in ("--set", each)), "--out", "again")
    assert done.returncode == 0, done.stderr
    with open_log(tmp_path / "again/run.mcap") as log:
        assert np.abs(log["/actuators"]["command"]).max() > 0.3
    assert "completed: the replay was played to its end" in done.stdout
