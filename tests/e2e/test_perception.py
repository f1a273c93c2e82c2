"""`sitl-perception` and `xitl map` as a user runs them, for some seconds of simulation time."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from conftest import Xitl
from mcap.reader import make_reader

for package in ("kiss_icp", "embreex"):
    pytest.importorskip(package, reason="xitl[perception] is not installed")
pytestmark = pytest.mark.slow

SHORT = (
    *("--set", "clock.duration_s=16", "--set", "clock.physics_rate_hz=200", "--set", "sensors.lidar.points_hz=40000"),
    *("--set", "companion.link=tcp://127.0.0.1:0"),
)


def topics(file: Path) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, message.data))
    return found


def test_it_sees_maps_and_repeats_wherever_the_companion_runs(xitl: Xitl, tmp_path: Path) -> None:
    ran = xitl("sim", "-p", "sitl-perception", *SHORT, "--out", "a", "--json", timeout_s=300)
    assert ran.returncode == 1, ran.stderr  # the mission is longer
    summary = json.loads(ran.stdout)
    assert summary["error"] is None
    companion, lidar = summary["companion"], summary["perception"]["lidar"]
    # A frame each 0.1 s, the first from 0.1 s on; the last may still be on its way.
    assert lidar["frames"] == 159
    assert lidar["frames"] - companion["clouds"] <= 1
    assert (companion["chunks_lost"], companion["clouds_dropped"], companion["gone_s"]) == (0, 0, None)
    assert companion["poses"] > 140
    # One per cent of the path, and what it drifts and turns before it gets under way.
    assert summary["odometry"]["ate_rms_m"] < 0.01 * summary["odometry"]["path_m"] + 0.5
    assert summary["collisions"]["count"] == 0

    again = xitl(
        "sim", "-p", "sitl-perception", *SHORT, "--set", "companion.runs=in-process", "--out", "b", timeout_s=300
    )
    assert again.returncode == 1, again.stderr
    one, other = topics(tmp_path / "a" / "run.mcap"), topics(tmp_path / "b" / "run.mcap")
    assert [topic for topic in one if one[topic] != other.get(topic)] == []
    assert {"/lidar/points", "/sonar/ping", "/companion/odometry", "/companion/map", "/companion/status"} <= set(one)
    assert (tmp_path / "a" / "map.ply").read_bytes() == (tmp_path / "b" / "map.ply").read_bytes()

    mapped = xitl("map", "a/run.mcap", "--out", "m", "--json", timeout_s=300)
    assert mapped.returncode == 0, mapped.stderr
    difference = json.loads(mapped.stdout)["difference"]
    assert difference["poses"] == companion["poses"]
    assert difference["max_m"] < 0.1
    assert (tmp_path / "m" / "map.ply").stat().st_size > 0
