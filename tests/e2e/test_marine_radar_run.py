"""`sensors.radar` in runs as a user starts them: repeated bit for bit, and the other vessel where it is."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from conftest import Xitl
from mcap.reader import make_reader

from xitl_cli.logs import open_log

pytestmark = pytest.mark.slow

HALF_DIAGONAL_M = math.hypot(6.0, 2.0)
TRACK = "{length_m: 12, beam_m: 4, track_ned_m: [[60, -80], [60, 80]], speed_mps: 4}"
OPEN_WATER = f"""extends: [mitl, sensors/radar]
clock: {{duration_s: 20}}
world: {{log_boom: null, dam: null}}
environment: {{current: {{speed_mps: 0}}, waves: {{spectrum: none}}, wind: {{mean_mps: 0}}}}
sensors:
  radar: {{range_m: 200, heading_noise_deg: 0, multipath: false}}
vessels:
  boat: {{mission: {{start: {{north_m: 0, east_m: 0, heading_deg: 40}}}}}}
  other: {{traffic: {TRACK}}}
"""


def topics(file: Path) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, message.data))
    return found


def test_the_profile_of_the_river_repeats_bit_for_bit(xitl: Xitl, tmp_path: Path) -> None:
    for out in ("a", "b"):
        ran = xitl("sim", "-p", "sitl-radar", "--duration", "6", "--out", out, "--json", timeout_s=300)
        assert ran.returncode == 0, ran.stderr
        summary = json.loads(ran.stdout)
        assert summary["error"] is None
        assert summary["perception"]["radar"]["turns"] == 2
    one, other = topics(tmp_path / "a" / "run.mcap"), topics(tmp_path / "b" / "run.mcap")
    assert [topic for topic in one if one[topic] != other.get(topic)] == []
    assert len(one["/marine_radar/sector"]) == 56  # of 57 complete ones in 6 s: 24 in 2.5 s
    assert len(one["/marine_radar/plots"]) == summary["perception"]["radar"]["plots"] > 10


def test_the_radar_sees_the_other_vessel_where_it_is(xitl: Xitl, tmp_path: Path) -> None:
    """In calm and open water, each turn has a plot at the other vessel's hull, within a sample and half a beam."""
    (tmp_path / "own.yaml").write_text(OPEN_WATER, encoding="utf-8")
    ran = xitl("sim", "own.yaml", "--duration", "20.3", "--out", "run", timeout_s=300)
    assert ran.returncode == 0, ran.stderr
    with open_log(tmp_path / "run/run.mcap", "boat") as log:
        state, plots = log.tables["/truth/state"], log.tables["/marine_radar/plots"]
        stamps, places = state.stamp_ns, state.values("position_ned_m")
        keys = ("turn", "measured_ns", "range_m", "true_bearing_rad", "strength_db")
        rows = list(zip(*(plots.values(key).tolist() for key in keys), strict=True))
    for turn in range(8):
        own = [row for row in rows if row[0] == turn]
        _, measured_ns, range_m, bearing_rad, strength_db = max(own, key=lambda row: row[4])
        place = places[int(np.argmin(np.abs(stamps - measured_ns)))]
        north_m, east_m = 60.0 - place[0], -80.0 + 4e-9 * measured_ns - place[1]
        true_m, true_rad = math.hypot(north_m, east_m), math.atan2(east_m, north_m)
        assert strength_db > 30.0
        assert abs(range_m - true_m) < HALF_DIAGONAL_M + 1.0
        off_rad = abs(math.remainder(bearing_rad - true_rad, math.tau))
        assert off_rad < math.atan2(HALF_DIAGONAL_M, true_m) + math.radians(2.0)
