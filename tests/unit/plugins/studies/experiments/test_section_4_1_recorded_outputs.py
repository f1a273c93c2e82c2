"""Section 4.1: what is replayed of a log, and errors whose integral is known in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.recorded import CALM, MISSION_TLOG
from xitl_cli.errors import UserError
from xitl_cli.experiment.setup import ExperimentSetup
from xitl_cli.experiment.time_series import TimeSeries
from xitl_cli.logs import open_log
from xitl_cli.logs.compare.pairing import time_integral
from xitl_cli.plugins.studies.experiments import section_4_1_recorded_outputs
from xitl_cli.plugins.studies.experiments.section_4_1_recorded_outputs import (
    ARC_S,
    FARTHEST_M,
    ReplayComparison,
    _rows,
    drawn_factors,
    replay_profile,
    stand_in_profile,
    start_pose,
)
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.agents import ReplaySpec
from xitl_cli.replay.motor_schedule import replayed_span_s
from xitl_cli.replay.pulse_log import read_pulse_log


def test_the_integral_of_a_growing_and_of_a_turning_error() -> None:
    time_s = np.linspace(0.0, 20.0, 4001)
    stamps = (time_s * 1e9).astype(np.int64)
    growing, turning = 0.1 * time_s, 1.25 * np.sin(np.pi * time_s / 5.0)
    covered_s, iae_x = time_integral(stamps, np.abs(growing))
    _, iae_y = time_integral(stamps, np.abs(turning))
    assert covered_s == pytest.approx(20.0)
    assert iae_x == pytest.approx(0.5 * 0.1 * 20.0**2, rel=1e-6)
    assert iae_y == pytest.approx(2.0 / np.pi * 1.25 * 20.0, rel=1e-5)  # the mean of |sin| is 2 / pi
    found = ReplayComparison(
        time_s, np.zeros((len(time_s), 2)), np.column_stack([growing, turning]), {"iae_x_ms": iae_x, "iae_y_ms": iae_y},
        TimeSeries(time_s, np.full(len(time_s), 2.0)), None, 0.1, {},
    )  # fmt: skip
    rows = {row.quantity: row for row in _rows(found)}
    assert (rows["IAE x"].paper, rows["IAE x"].ours) == (3.87, 20.0)
    assert rows["IAE x"].difference.startswith("5.2 times the paper's: 1.00 m mean over 20 s")
    assert rows["largest error in y"].ours == FARTHEST_M
    assert rows["largest error in y"].difference == "Within the paper's bound."
    assert rows["largest error in x"].difference.startswith("Beyond the paper's bound")
    assert rows["speeds differ by, RMS"].difference == "5 % of its top speed of 2.00 m/s."


def test_the_stand_in_differs_by_what_is_drawn(tmp_path: Path) -> None:
    setup = ExperimentSetup(tmp_path, seed=3)
    factors = drawn_factors(3)
    assert factors == drawn_factors(3) != drawn_factors(4)
    assert all(0.7 < factor < 1.3 for factor in factors.values())
    path = tmp_path / "stand-in.yaml"
    path.write_text(stand_in_profile("vehicles/asv-third", setup, factors))
    profile, model = load_profile(str(path)), load_profile("vehicles/asv-third").vehicle
    assert profile.vehicle.mass_kg == pytest.approx(model.mass_kg * factors["mass_kg"], rel=1e-3)
    for one, of_model, side in zip(profile.vehicle.propellers, model.propellers, ("port", "starboard"), strict=True):
        assert one.max_thrust_n == pytest.approx(of_model.max_thrust_n * factors[side], rel=1e-3)
    assert profile.vehicle.damping_linear.roll == model.damping_linear.roll
    assert (profile.environment.wind.mean_mps, profile.environment.current.speed_mps) == (1.0, 0.02)


@pytest.mark.parametrize("path", [CALM, MISSION_TLOG])
def test_a_replay_begins_where_the_recording_was_armed(path: Path, tmp_path: Path) -> None:
    pulses = read_pulse_log(path)
    start_s, end_s = replayed_span_s(pulses, ReplaySpec(), load_profile("vehicles/asv-third").vehicle)
    if pulses.armed_s is not None:
        assert abs(start_s - pulses.armed_s) < 0.2
    assert pulses.at_s[0] <= start_s < end_s == pulses.at_s[-1]
    with open_log(path) as log:
        start = start_pose(log, start_s)
    assert (start.latitude_deg, start.longitude_deg) == pytest.approx((-8.8, -63.95), abs=0.01)
    profile = tmp_path / "replay.yaml"
    profile.write_text(replay_profile("vehicles/asv-third", path, start, start_s, end_s))
    loaded = load_profile(str(profile))
    assert (loaded.driver.kind, loaded.autopilot.kind) == ("replay", "none")
    assert loaded.environment.wind.mean_mps == 0.0


def test_a_log_without_places_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(section_4_1_recorded_outputs.signals, "position_geodetic", lambda log: None)
    with open_log(CALM) as log, pytest.raises(UserError, match="tells no position"):
        start_pose(log, 50.0)


@pytest.mark.parametrize("duration_s", [1.0, 5.0, 12.0, 100.0])
def test_a_short_arc_ends_in_time(duration_s: float, tmp_path: Path) -> None:
    setup = ExperimentSetup(tmp_path, duration_s=duration_s)
    path = tmp_path / "stand-in.yaml"
    path.write_text(stand_in_profile("vehicles/asv-third", setup, drawn_factors(1)))
    steps = load_profile(str(path)).driver.script
    assert steps[0].arm
    assert steps[-1].end
    assert steps[-1].at_s - steps[0].at_s == min(duration_s, ARC_S)


def test_a_vessel_that_two_propellers_do_not_steer(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="use --real with a log"):
        stand_in_profile("vehicles/asv-steered", ExperimentSetup(tmp_path), drawn_factors(1))
