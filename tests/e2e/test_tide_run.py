"""A run in a tide: level, stream, hull and recording, with a tide of a minute's period."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from conftest import Xitl, payloads
from mcap.reader import make_reader

import xitl as api

PROFILE = """
extends: [mitl, environments/calm]
technique: mitl
world: {log_boom: null, dam: null}
recording: {scene: true}
driver: {kind: script, script: [{at_s: 0, motors: [0, 0]}]}
environment:
  water:
    tide: {constituents: [{name: quick, amplitude_m: 1.0, phase_deg: 90, speed_degph: 21600}]}
  current:
    tide: {flood_deg: 90, follows: level, peak_mps: 0.5}
"""


@pytest.mark.slow
def test_level_stream_and_hull_follow_the_tide(xitl: Xitl, tmp_path: Path) -> None:
    (tmp_path / "quick.yaml").write_text(PROFILE)
    for out in ("run", "again"):
        done = xitl("sim", "quick.yaml", "--duration", "20", "--out", out)
        assert done.returncode == 0, done.stderr
    assert payloads(tmp_path / "run/run.mcap") == payloads(tmp_path / "again/run.mcap")
    with api.open_log(tmp_path / "run/run.mcap") as log:
        around, truth, tide = log["/environment"], log["/truth/state"], log["/environment/tide"]
        time_s = around.stamp_ns * 1e-9
        height_m = np.sin(math.tau * time_s / 60.0)
        np.testing.assert_allclose(around["surface_elevation_m"], height_m, atol=1e-6)
        east_mps = around["current_ned_mps"][:, 1]
        np.testing.assert_allclose(east_mps, 0.5 * height_m, atol=0.02)  # held for 20 ms
        down_m = np.interp(time_s, truth.stamp_ns * 1e-9, truth["position_ned_m"][:, 2])
        assert np.ptp(down_m + height_m) < 0.05
        assert np.ptp(down_m) > 0.8
        np.testing.assert_allclose(tide["height_m"], np.sin(math.tau * tide.stamp_ns * 1e-9 / 60.0), atol=1e-9)
        np.testing.assert_allclose(tide["stream_mps"], 0.5 * tide["height_m"], atol=1e-9)
        assert len(tide.stamp_ns) == 21
    with (tmp_path / "run/run.mcap").open("rb") as file:
        scenes = sum(1 for _ in make_reader(file).iter_messages(topics=["/scene"]))
    assert scenes > 15  # the water is drawn anew at each level
