"""Every shipped vessel under way in the third of the three environments, by the autopilot's own allocation and gains.

The whole missions in all environments are `xitl campaign vehicles`; docs/vehicles.md has their figures.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import Xitl, summary

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("vessel", "seconds"),
    [
        ("otter", 60),
        ("wamv16", 50),
        ("heron", 75),
        pytest.param("blueboat", 75, marks=pytest.mark.nightly),
        pytest.param("cybership2", 90, marks=pytest.mark.nightly),
    ],
)
def test_it_makes_way_in_current_waves_and_gusts(xitl: Xitl, tmp_path: Path, vessel: str, seconds: int) -> None:
    """The first leg: 22 m across a current of 0.5 m/s, which carries the boat off while the autopilot aligns for 25 s.

    The waypoint is reached by the estimate within 3 m, the truth is off by its error; the tank model, which goes 1 m/s
    at most, has not made good the 12 m by then and passes it.
    """
    (tmp_path / "boat.yaml").write_text(f"extends: [sitl, vehicles/{vessel}, environments/current-waves-gusts]\n")
    words = ("--duration", str(seconds), "--set", "clock.physics_rate_hz=200")
    done = xitl("sim", "--profile", "boat.yaml", *words, "--out", "run")
    assert done.returncode == 0, done.stdout + done.stderr
    told = summary(tmp_path / "run")
    assert told["warnings"] == []
    assert told["mission"]["waypoints_reached"] >= 1
    assert told["mission"]["closest_m"][0] < (12.0 if vessel == "cybership2" else 3.0 + 1.5)
    assert told["estimation"]["heading_rms_deg"] < 5.0
