"""Real ArduPilot Rover with our vessels, frames and further sensors: paths that a boat owner would accept."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Xitl
from pymavlink import DFReader

from tests.ardupilot import find_ardurover

pytestmark = [pytest.mark.realtime, pytest.mark.ardupilot]
CALM_RMS_M, ROUGH_RMS_M = 1.0, 2.0
THIRD = """
mission: {speed_mps: 1.7, acceptance_radius_m: 1.5}
autopilot: {parameter_files: [rover-json, rover-differential, rover-asv-third]}
clock: {duration_s: 600.0}
"""
OTTER = "autopilot: {parameter_files: [rover-json, rover-differential, rover-otter]}"
RUDDERS = """
autopilot:
  parameter_files: [rover-json, rover-rudder, rover-cybership2]
  parameters: {MOT_SPD_SCA_BASE: 0.3}
  bridge: {outputs: [3, 5, 9, 1, 7]}
mission:
  acceptance_radius_m: 2.0
  waypoints_ned_m: [[12.0, 0.0], [40.0, 20.0], [44.0, 14.0], [16.0, -6.0]]
"""
SENSORS = """
sensors:
  rangefinders: [{rate_hz: 20, position_frd_m: [0.0, 0.0, 0.2], beam_deg: 40.0}]
  wind_vane: {rate_hz: 10, position_frd_m: [0.2, 0.0, -2.0], response_s: 0.3}
autopilot:
  parameter_files: [rover-json, rover-differential, rover-asv-full, rover-echo-sounder, rover-wind-vane]
"""
MESSAGES = """
sensors:
  messages:
    gps_input: {gps_id: 1, rate_hz: 5, latency_s: 0.1, horizontal_noise_m: 0.1, vertical_noise_m: 0.2,
      horizontal_drift_m: 0.1, vertical_drift_m: 0.1, drift_correlation_s: 60.0, velocity_noise_mps: 0.05,
      satellites: 11}
    obstacle_distance: {rate_hz: 10, max_range_m: 60.0}
    odometry: {rate_hz: 20, position_noise_m: 0.02, drift_mprts: 0.02, velocity_noise_mps: 0.02}
autopilot:
  parameters: {GPS2_TYPE: 14, PRX1_TYPE: 2, VISO_TYPE: 1}
"""


def run(xitl: Xitl, folder: Path, extends: str, more: str = "") -> dict[str, Any]:
    (folder / "boat.yaml").write_text(f"extends: [{extends}]\ndescription: under test\n{more}")
    words = ("--profile", "boat.yaml", "--firmware", str(find_ardurover()), "--out", "run", "--json")
    result = xitl("sim", *words, timeout_s=400.0)
    assert result.returncode == 0, result.stderr
    told: dict[str, Any] = json.loads(result.stdout)
    return told


@pytest.mark.parametrize(
    ("extends", "more", "rms_m"),
    [
        ("sitl-ardupilot, environments/calm", "", CALM_RMS_M),
        ("sitl-ardupilot, environments/current-waves", "", ROUGH_RMS_M),
        ("sitl-ardupilot-steered, environments/calm", "", CALM_RMS_M),
        ("sitl-ardupilot-steered", "", ROUGH_RMS_M),
        ("sitl-ardupilot, vehicles/otter", OTTER, ROUGH_RMS_M),
        ("sitl-ardupilot, vehicles/cybership2, environments/calm", RUDDERS, ROUGH_RMS_M),
        ("sitl-ardupilot, vehicles/asv-third", THIRD, ROUGH_RMS_M),
    ],
    ids=["calm", "current and waves", "steered, calm", "steered", "otter", "rudders", "third"],
)
def test_it_keeps_to_its_path(xitl: Xitl, tmp_path: Path, extends: str, more: str, rms_m: float) -> None:
    mission = run(xitl, tmp_path, extends, more)["mission"]
    assert mission["completed"]
    assert mission["cross_track_rms_m"] < rms_m


def test_depth_and_wind_arrive(xitl: Xitl, tmp_path: Path) -> None:
    """Bed at 20.01 m, the centre 0.14 m above the origin, the unit 0.2 m below; wind from 290 degrees with gusts.

    Its 5 m/s at 0.3 m grow by the power law of the profile up to the vane.
    """
    run(xitl, tmp_path, "sitl-ardupilot", SENSORS)
    log = DFReader.DFReader_binary(str(tmp_path / "run/autopilot.bin"))
    depths_m, winds = [], []
    while (message := log.recv_match(type=["RFND", "WIND"])) is not None:
        if message.TimeUS < 60_000_000:
            continue
        if message.get_type() == "RFND":
            assert (message.Orient, message.Stat) == (25, 4)  # down, good
            depths_m.append(message.Dist)
        else:
            winds.append(message.SpdTru * np.exp(1j * math.radians(message.DrTru)))
    log.close()
    assert np.mean(depths_m) == pytest.approx(20.01 + 0.14 - 0.2, abs=0.05)
    assert np.max(np.abs(np.array(depths_m) - np.mean(depths_m))) < 0.4  # waves of 0.2 m significant height
    mean = np.mean(winds)
    assert abs(mean) == pytest.approx(5.0 * (2.14 / 0.3) ** 0.143, abs=1.5)
    assert math.degrees(np.angle(mean * np.exp(-1j * math.radians(290.0)))) == pytest.approx(0.0, abs=15.0)


def test_standard_messages_arrive(xitl: Xitl, tmp_path: Path) -> None:
    """A second receiver, obstacles and odometry through the bridge, as its log has them at the end of the mission."""
    run(xitl, tmp_path, "sitl-ardupilot", MESSAGES)
    log = DFReader.DFReader_binary(str(tmp_path / "run/autopilot.bin"))
    newest: dict[str, Any] = {}
    while (message := log.recv_match(type=["GPS", "PRX", "VISP"])) is not None:
        newest[f"GPS{message.I}" if message.get_type() == "GPS" else message.get_type()] = message
    log.close()
    own, second = newest["GPS0"], newest["GPS1"]
    assert (second.Status, second.NSats) == (3, 11)
    east_scale = math.cos(math.radians(own.Lat))
    apart_m = 111_195.0 * math.hypot(second.Lat - own.Lat, (second.Lng - own.Lng) * east_scale)
    assert apart_m < 3.0
    assert 10.0 < newest["PRX"].CDis < 60.0  # at the last waypoint the log boom is 24 m off
    assert newest["VISP"].Q == 100
