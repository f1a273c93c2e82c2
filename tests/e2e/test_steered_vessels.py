"""Vessels that are not steered by two propellers sail a short mission with the embedded autopilot, untuned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import xitl

pytestmark = pytest.mark.slow

COURSE = """
extends: [sitl, {environment}, {vehicle}]
description: under test
autopilot: {{parameter_files: []}}
recording: {{scene: false}}
clock: {{physics_rate_hz: 200, duration_s: 130}}
mission:
  speed_mps: 2.0
  waypoints_ned_m: [[20.0, 0.0], [60.0, 30.0], [48.0, 46.0], [8.0, 16.0]]
"""
SCREW = """{position_frd_m: [-1.0, 0.0, 0.1], medium: water, max_thrust_n: 400, max_reverse_thrust_n: 240,
       diameter_m: 0.25, spin_up_s: 0.3, spin_down_s: 0.3}"""
RUDDER = """
vehicle:
  name: rudder boat
  propellers: [SCREW]
  rudders: [{position_frd_m: [-1.2, 0.0, 0.1], area_m2: 0.05, aspect_ratio: 1.5, propeller: 0}]
"""
BOW_THRUSTER = """
vehicle:
  name: bow thruster boat
  propellers:
    - SCREW
    - {position_frd_m: [1.0, 0.0, 0.1], medium: water, angle_deg: 90, max_thrust_n: 120, max_reverse_thrust_n: 120,
       spin_up_s: 0.3, spin_down_s: 0.3}
"""
VESSELS = {
    "rudder": ("vehicles/asv-full", RUDDER.replace("SCREW", SCREW)),
    "vectored": ("vehicles/asv-steered", ""),
    "bow thruster": ("vehicles/asv-full", BOW_THRUSTER.replace("SCREW", SCREW)),
}


@pytest.mark.nightly
@pytest.mark.parametrize("name", VESSELS)
def test_it_sails_a_mission_in_current_and_waves(name: str, tmp_path: Path) -> None:
    """Within a boat's length of the legs, turns at the corners among it, by what it steers with."""
    vehicle, more = VESSELS[name]
    profile = tmp_path / "boat.yaml"
    profile.write_text(COURSE.format(environment="environments/current-waves", vehicle=vehicle) + more)
    run = xitl.simulate(str(profile), out=tmp_path / "run")
    assert run.summary["mission"]["completed"], run.summary["mission"]
    assert run.summary["mission"]["cross_track_rms_m"] < 2.5
    with run.open_log() as log:
        commands = np.array(log["/actuators"]["command"].tolist())
    assert commands.shape[1] == 2
    assert np.ptp(commands[:, 1]) > 0.5
