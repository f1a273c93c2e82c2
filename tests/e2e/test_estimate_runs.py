"""Runs of the mission with other seeds: the estimate beside the accuracy that it states, and what the summary tells."""

from __future__ import annotations

import math

import numpy as np
import pytest

import xitl
from tests.recorded_run import recorded_run

pytestmark = pytest.mark.slow

SEEDS = range(61, 69)
CHEAP = {"recording.scene": False, "clock.physics_rate_hz": 200}
CHI2_16 = (5.142, 34.267)  # quantiles 0.005 and 0.995 of 16 degrees of freedom, from a table


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[xitl.Result]:
    folder = tmp_path_factory.mktemp("estimate")
    return [
        xitl.simulate("sitl", seed=seed, duration_s=45.0, overrides=CHEAP, out=folder / str(seed)) for seed in SEEDS
    ]


def squares(run: xitl.Result) -> list[float]:
    """Normalised squared errors of the horizontal position at 25, 35 and 45 s."""
    with run.open_log() as log:
        estimate, truth = log["/estimate/odometry"], log["/truth/odometry"]
        covariance = np.asarray(estimate["pose.covariance"], dtype=float)
        found = []
        for second in (25.0, 35.0, 44.9):
            row = int(np.searchsorted(estimate.stamp_ns, second * 1e9))
            at = int(np.searchsorted(truth.stamp_ns, estimate.stamp_ns[row]))
            assert abs(int(truth.stamp_ns[at]) - int(estimate.stamp_ns[row])) < 20e6
            east, north = (
                float(estimate[f"pose.pose.position.{axis}"][row] - truth[f"pose.pose.position.{axis}"][at])
                for axis in "xy"
            )
            found.append(east**2 / covariance[row, 0] + north**2 / covariance[row, 7])
        return found


@pytest.mark.nightly
def test_positions_err_as_much_as_the_recorded_covariance_says(runs: list[xitl.Result]) -> None:
    sums = np.sum([squares(run) for run in runs], axis=0)
    assert ((sums > CHI2_16[0]) & (sums < CHI2_16[1])).all(), sums / len(runs)


@pytest.mark.nightly
@pytest.mark.parametrize(("figure", "least", "most"), [("position_nees", 0.5, 4.5), ("heading_nees", 0.1, 2.5)])
def test_the_summary_has_the_mean_of_a_run(runs: list[xitl.Result], figure: str, least: float, most: float) -> None:
    values = [run.summary["estimation"][figure] for run in runs]
    assert all(value > 0.0 for value in values)
    assert least < float(np.mean(values)) < most


def test_the_recorded_variance_of_the_heading_is_that_of_the_log() -> None:
    """XKV1 has it in the parts of the quaternion: together a quarter of it."""
    run = recorded_run("sitl")
    with xitl.open_log(run / "run.mcap") as log:
        estimate = log["/estimate/odometry"]
        recorded = float(np.asarray(estimate["pose.covariance"], dtype=float)[-1, 35])
    with xitl.open_log(run / "autopilot.bin") as log:
        logged = 4.0 * float(log["XKV1"]["V00"][-1] + log["XKV1"]["V03"][-1])
    assert 0.0 < recorded < math.radians(3.0) ** 2
    assert logged == pytest.approx(recorded, rel=0.2)
