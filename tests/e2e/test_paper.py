"""The paper's experiments from the command line: short runs, and those with a real ardurover."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from conftest import Xitl

from tests.ardupilot import find_ardurover


@pytest.mark.slow
def test_recorded_outputs_drive_the_scale_vessel(xitl: Xitl, tmp_path: Path) -> None:
    out = tmp_path / "paper"
    done = xitl("paper", "4.1", "--duration", "12", "--seed", "3", "--out", str(out), "--report", timeout_s=300)
    assert done.returncode == 0, done.stderr
    told = json.loads((out / "table.json").read_text())
    rows = {row["quantity"]: row for row in told["table"]}
    assert [rows[name]["paper"] for name in ("IAE x", "IAE y", "largest error in x")] == [3.87, 1.4, 1.25]
    covered_s, farthest_m = rows["replayed for"]["ours"], rows["largest error in x"]["ours"]
    assert 11.0 < covered_s <= 12.1
    assert 0.0 < rows["IAE x"]["ours"] <= farthest_m * covered_s
    assert farthest_m < 5.0  # twelve seconds at some 1.3 m/s, parameters 5 % off and 1 m/s of wind
    assert told["real"] is None
    assert "--real LOG" in told["notes"][0]
    for name in ("4.1-path", "4.1-profiles"):
        assert (out / f"{name}.png").stat().st_size > 10_000
        assert (out / f"{name}.svg").stat().st_size > 10_000
    assert (out / "paper.html").read_text().count("data:image/svg+xml") == 2
    again = xitl("paper", "4.1", "--duration", "6", "--real", str(out / "stand-in/autopilot.bin"), "--out",
                 str(tmp_path / "real"), "--json", timeout_s=300)  # fmt: skip
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["real"] == str(out / "stand-in/autopilot.bin")


@pytest.mark.slow
def test_lidar_and_sonar_see_what_they_are_there_for(xitl: Xitl, tmp_path: Path) -> None:
    done = xitl("paper", "4.4", "--duration", "8", "--out", str(tmp_path / "paper"), "--json", timeout_s=600)
    told = json.loads(done.stdout)
    ours = {row["quantity"]: row["ours"] for row in told["table"]}
    assert ours["lidar under the water"] == ours["sunken trunk in the lidar"] == 0
    assert ours["water plane in the lidar"] > 10_000
    assert ours["branch in the lidar"] > 20
    assert ours["sunken trunk in the sonar"] > 10
    assert ours["proximity messages"] > 0
    assert ours["reported range of the branch"] == pytest.approx(9.3, abs=2.0)  # it is so long: not the water before it
    assert done.returncode == 0, done.stderr


@pytest.mark.realtime
@pytest.mark.ardupilot
def test_departure_with_its_own_sensors_and_with_ours(xitl: Xitl) -> None:
    program = find_ardurover()
    done = xitl("paper", "4.2", "--firmware", str(program), "--duration", "80", "--json", timeout_s=900)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert len(told["runs"]) == 6
    assert {one["problem"] for one in told["runs"]} == {""}
    for row in told["rows"]:
        assert 0 < row["own_s"] < 80
        assert 0 < row["ours_s"] < 80
    for one in told["runs"]:
        origin_s, ready_s, armed_s, motion_s = one["times_s"].values()
        assert origin_s < ready_s <= armed_s <= motion_s
