"""Somebody's own boat on their own water, from `xitl init` to a completed mission."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import Xitl, summary

from tests.golden import Golden
from xitl_cli.params.values import read_wanted


@pytest.mark.slow
def test_a_boat_in_norway(xitl: Xitl, tmp_path: Path) -> None:
    """Three edits as `xitl init` asks for them: a heavier boat, another water at 60° N, its own current and seas."""
    assert xitl("init", "my-boat").returncode == 0
    boat = tmp_path / "my-boat"
    edits = {
        "vessel.yaml": [
            ("mass_kg: 45", "mass_kg: 70"),
            ("length_m: 1.6, width_m: 1.0", "length_m: 2.0, width_m: 1.1"),
            ("max_thrust_n: 45", "max_thrust_n: 80"),
        ],
        "mission.yaml": [
            ("latitude_deg: 60.3913", "latitude_deg: 59.8"),
            ("longitude_deg: 5.3050", "longitude_deg: 10.55"),
            ("- [0, 5]", "- [0, 5]\n    - [-20, 20]"),
        ],
        "profile.yaml": [
            ("speed_mps: 0.2, direction_deg: 90", "speed_mps: 0.4, direction_deg: 190"),
            ("significant_height_m: 0.15", "significant_height_m: 0.3"),
            ("WP_RADIUS: 2", "WP_RADIUS: 2\n    LOS_LOOKAHEAD: 5"),
        ],
    }
    for file, changes in edits.items():
        text = (boat / file).read_text()
        for before, after in changes:
            assert before in text
            text = text.replace(before, after)
        (boat / file).write_text(text)
    assert xitl("profiles", "check", "my-boat").stdout == "ok  my-boat (runs)\n"
    done = xitl("sim", "--profile", "my-boat", "--set", "clock.physics_rate_hz=200", "--out", "run")
    assert done.returncode == 0, done.stdout + done.stderr
    told = summary(tmp_path / "run")
    (steep,) = told["warnings"]  # 0.3 m of significant height, twice what the boat begins with
    assert "waves are linear" in steep
    mission = told["mission"]
    assert mission["completed"]
    assert mission["waypoints_reached"] == 5
    assert mission["cross_track_rms_m"] < 1.5  # within the radius of the waypoints
    assert told["estimation"]["heading_rms_deg"] < 6.0  # the horizontal field is half of the one at the equator
    assert read_wanted(str(tmp_path / "run/profile.yaml"))["LOS_LOOKAHEAD"] == 5


@pytest.mark.slow
def test_what_stays_of_another_boat_is_in_the_summary(xitl: Xitl, tmp_path: Path, golden: Golden) -> None:
    (tmp_path / "mine.yaml").write_text("extends: sitl\nsite: {latitude_deg: 60, longitude_deg: 10, altitude_m: 0}\n")
    done = xitl("sim", "--profile", "mine.yaml", "--duration", "1", "--out", "run")
    site, compass = summary(tmp_path / "run")["warnings"]
    golden("text", site)
    assert "5.0 mG of hard iron in a horizontal field of 151 mG" in compass
    assert "world.log_boom" in done.stdout + done.stderr
    assert "warning: mine.yaml:2: the site is" in xitl("profiles", "check", "mine.yaml").stdout
