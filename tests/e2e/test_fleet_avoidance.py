"""A vessel with a companion keeps clear of another vessel that crosses, by nothing but its lidar."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import xitl as toolkit

pytest.importorskip("embreex", reason="xitl[perception] is not installed")
pytestmark = [pytest.mark.slow, pytest.mark.nightly]

# Both would be at the same place after some 25 s under way. A barge of 20 m is longer than anything that drifts.
PROFILE = """
extends: [bases/base-sitl, sites/santo-antonio, vehicles/asv-full, environments/current-waves]
environment: {current: {speed_mps: 0.0}}
vessels:
  own:
    extends: sensors/perception
    sensors: {sonar: null, lidar: {yaw_deg: 0}}
    companion: {runs: process, link: "tcp://127.0.0.1:0", parameters: {ODO_ENABLE: 0, MAP_ENABLE: 0}}
    mission: {speed_mps: 2.0, start: {north_m: 90, east_m: -100, heading_deg: 0}, waypoints_ned_m: [[190, -100]]}
  barge: {traffic: {track_ned_m: [[150, -60], [150, -180]], speed_mps: 1.0, length_m: 20, beam_m: 6}}
clock: {physics_rate_hz: 200, duration_s: 120.0}
"""


def test_a_barge_that_crosses_is_tracked_and_kept_clear_of(tmp_path: Path) -> None:
    (tmp_path / "crossed.yaml").write_text(PROFILE)
    result = toolkit.simulate(tmp_path / "crossed.yaml", out=tmp_path / "run")
    assert result.completed, result.verdict
    own = result.summary["vessels"]["own"]
    assert own["collisions"]["count"] == 0
    assert own["companion"]["detours"] + own["companion"]["stops"] >= 1
    (pair,) = result.summary["encounters"]["pairs"]
    assert pair["distance_m"] > 1.8  # a path with less is blocked: 0.6 of AVD_MARGIN

    with toolkit.open_log(result.recording) as log:
        barge, tracks = log.tables["/barge/truth/state"], log.tables["/own/companion/obstacles"]
        truth_s, truth_m = barge.stamp_ns * 1e-9, barge.values("position_ned_m")
        own_state = log.tables["/own/truth/state"]
        own_s, own_north_m = own_state.stamp_ns * 1e-9, own_state.values("position_ned_m")[:, 0]
        told_s = tracks.stamp_ns * 1e-9
        place_m, vel_mps, hits = (tracks.values(name) for name in ("position_ned_m", "velocity_ned_mps", "hits"))
    true_m = np.column_stack([np.interp(told_s, truth_s, truth_m[:, axis]) for axis in range(2)])
    # Its velocity is known by then; once the vessel is abeam of it, both sides have been seen, and one end alone later.
    of_the_barge = (hits >= 20) & (np.interp(told_s, own_s, own_north_m) < 150.0 - 3.0)
    assert np.count_nonzero(of_the_barge) > 20
    # Its near side is seen, 3 m from its middle, within a metre of the autopilot's own error and a cell. Along it one
    # end or the other is out of sight: off by no more than half of it.
    off_m = place_m[of_the_barge, :2] - true_m[of_the_barge]
    assert np.median(off_m[:, 0]) == pytest.approx(-3.0, abs=1.5)
    assert np.median(np.abs(off_m[:, 1])) < 10.0
    off_mps = np.hypot(vel_mps[of_the_barge, 0], vel_mps[of_the_barge, 1] + 1.0)
    assert np.median(off_mps) < 0.35
