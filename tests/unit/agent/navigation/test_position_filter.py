"""Covariances against what they stand for: the errors of twenty runs of the model, and by hand where that is short."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agent.fcu.parameters import Parameters
from agent.navigation.position_filter import (
    AxisCovariance,
    AxisNoise,
    PositionFilter,
    predict_covariance,
    update_covariance,
)
from sim_core.noise import sampled_gauss_markov

SECOND = 1_000_000_000
RUNS, FIX_S = 20, 0.2
CHI2_40 = (24.433, 59.342)  # quantiles 0.025 and 0.975 of 40 degrees of freedom, from a table
ACCURACY = (math.hypot(0.15, 0.5) * math.sqrt(2.0), math.hypot(0.3, 1.0), 0.05 * math.sqrt(3.0))
FULL = AxisCovariance(2.0, 0.3, -0.1, -0.4, 0.5, -0.02, 0.05, 0.01, 0.001, 0.9)
ZERO = (0.0, 0.0, 0.0)


def matrix(c: AxisCovariance) -> np.ndarray:
    p = np.zeros((4, 4))
    p[np.triu_indices(4)] = c
    return p + p.T - np.diag(np.diag(p))


def triangle(p: np.ndarray) -> list[float]:
    return p[np.triu_indices(4)].tolist()


def test_a_prediction_is_f_p_f_transposed_and_noise() -> None:
    dt, keep = 0.7, math.exp(-0.7 / 60.0)
    f = np.array([[1, dt, -dt * dt / 2, 0], [0, 1, -dt, 0], [0, 0, 1, 0], [0, 0, 0, keep]])
    q = np.zeros((4, 4))
    q[:2, :2] = 4e-4 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    q[2, 2], q[3, 3] = 2e-5 * dt, (1.0 - keep * keep) * 0.25
    predicted = predict_covariance(FULL, dt, AxisNoise(4e-4, 2e-5, 60.0), 0.25)
    assert predicted == pytest.approx(triangle(f @ matrix(FULL) @ f.T + q))


@pytest.mark.parametrize(("seen", "row"), [(FULL.of_fix, [1, 0, 0, 1]), (FULL.of_velocity, [0, 1, 0, 0])])
def test_an_update_is_josephs_form(seen, row) -> None:
    h, p = np.array(row, dtype=float), matrix(FULL)
    variance = h @ p @ h + 0.04
    gain = p @ h / variance
    rest = np.eye(4) - np.outer(gain, h)
    updated, found = update_covariance(FULL, seen.column, seen.variance + 0.04)
    assert found == pytest.approx(gain)
    assert updated == pytest.approx(triangle(rest @ p @ rest.T + 0.04 * np.outer(gain, gain)))


class Fleet:
    """Twenty filters; (runs, 2) errors of what each integrates, and the drift of each receiver, north and east.

    Accelerations err by white noise and a random walk, the drift is that of `sim_core.noise`.
    """

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.filters = [PositionFilter(Parameters()) for _ in range(RUNS)]
        self.process = sampled_gauss_markov([0.5, 0.5], 60.0, 1.0 / FIX_S)
        self.drift = self.process.initial(self.rng.standard_normal((RUNS, 2)))
        self.pos = self.drift + 0.15 * self.rng.standard_normal((RUNS, 2))  # set to the first fix
        self.vel = 0.05 * self.rng.standard_normal((RUNS, 2))
        self.bias = np.zeros((RUNS, 2))
        self.now_ns = 0
        for each in self.filters:
            each.restart(ACCURACY)
            each.fuse_gnss(0, ZERO, ZERO, (1e5, 1e5, 1e5))  # a fix that says nothing, for its time

    def advance(self) -> tuple[np.ndarray, np.ndarray]:
        """To the next fix: its NIS of position and of velocity, (runs,)."""
        gauss = self.rng.standard_normal
        self.bias += math.sqrt(0.05**2 / 100.0 * FIX_S) * gauss((RUNS, 2))
        wrong = self.bias + math.sqrt(0.2**2 / 100.0 / FIX_S) * gauss((RUNS, 2))
        self.pos += FIX_S * self.vel + 0.5 * FIX_S**2 * wrong
        self.vel += FIX_S * wrong
        self.drift = self.process.decay * self.drift + self.process.drive * gauss((RUNS, 2))
        self.now_ns += round(FIX_S * SECOND)
        seen_pos = self.drift + 0.15 * gauss((RUNS, 2)) - self.pos
        seen_vel = 0.05 * gauss((RUNS, 2)) - self.vel
        for run, each in enumerate(self.filters):
            step = each.fuse_gnss(self.now_ns, (*seen_pos[run], 0.0), (*seen_vel[run], 0.0), ACCURACY)
            self.pos[run] += step.pos_ned_m[:2]
            self.vel[run] += step.vel_ned_mps[:2]
            self.bias[run] -= step.bias_ned_mps2[:2]
        gate2 = 25.0
        nis = np.array([(each.ratios.position, each.ratios.velocity) for each in self.filters]) * gate2
        return nis[:, 0], nis[:, 1]

    def nees(self) -> tuple[float, float]:
        """Sums over the runs of the normalised squared errors of position and velocity: χ² of 40 degrees."""
        known = [each.variances(self.now_ns) for each in self.filters]
        horizontal, speed = np.array([(v.horizontal_m2, v.speed_m2ps2) for v in known]).T
        return float(((self.pos**2).sum(1) / horizontal).sum()), float(((self.vel**2).sum(1) / speed).sum())


@pytest.mark.medium
def test_errors_are_as_large_as_the_covariance_says() -> None:
    """At a dozen instants, each over twenty independent runs: χ² bounds hold at one instant whatever the errors'
    correlation in time. One in twenty may be outside; with errors that stay for a minute, those are neighbours.
    """
    fleet = Fleet(7)
    sums = []
    for _ in range(12):
        for _ in range(25):
            nis = fleet.advance()
        sums.append((*fleet.nees(), *(float(part.sum()) for part in nis)))
    inside = (np.array(sums) > CHI2_40[0]) & (np.array(sums) < CHI2_40[1])
    assert (inside.mean(axis=0) >= 10 / 12).all(), np.array(sums) / RUNS
    assert np.array(sums).mean(axis=0) / RUNS == pytest.approx(2.0, abs=0.6)


def test_a_hundred_fixes_do_not_average_a_drift_away() -> None:
    """Taken for white, 0.52 m of an axis would be 0.05 m after a hundred fixes."""
    each = PositionFilter(Parameters())
    each.restart(ACCURACY)
    for k in range(100):
        each.fuse_gnss(k * SECOND // 5, ZERO, ZERO, ACCURACY)
    assert 0.4 < math.sqrt(each.variances(20 * SECOND).horizontal_m2) < 0.55


def test_horizontal_accuracy_is_of_two_axes_and_speed_accuracy_of_three() -> None:
    each = PositionFilter(Parameters({"EK3_VELNE_M_NSE": 0.01}))
    each.restart((1.0, 1.0, 0.3))
    assert each.variances(0).horizontal_m2 == pytest.approx(0.5)
    assert each.variances(0).speed_m2ps2 == pytest.approx(0.03)


def settled() -> PositionFilter:
    each = PositionFilter(Parameters())
    each.restart(ACCURACY)
    for k in range(50):
        each.fuse_gnss(k * SECOND // 5, ZERO, ZERO, ACCURACY)
    return each


@pytest.mark.parametrize(("jump_m", "moved_m"), [(0.3, 0.1), (2.0, 0.3)])
def test_a_jump_of_the_receiver_is_drift(jump_m: float, moved_m: float) -> None:
    """Two metres are ten times what one fix is off from the next, and within what the receiver says of itself."""
    each = settled()
    step = each.fuse_gnss(10 * SECOND, (jump_m, 0.0, 0.0), ZERO, ACCURACY)
    assert each.ratios.position <= 1.0
    assert 0.0 < step.pos_ned_m[0] < moved_m
    step = each.fuse_gnss(10 * SECOND + SECOND // 5, (jump_m - step.pos_ned_m[0], 0.0, 0.0), ZERO, ACCURACY)
    assert each.ratios.position < 0.2  # it is known now
    assert abs(step.pos_ned_m[0]) < moved_m


def test_a_jump_beyond_what_the_receiver_says_is_refused() -> None:
    each = settled()
    before = each.variances(10 * SECOND)
    step = each.fuse_gnss(10 * SECOND, (0.0, 5.0, 0.0), ZERO, ACCURACY)
    assert each.ratios.position > 1.0
    assert step.pos_ned_m[1] == 0.0
    assert each.variances(10 * SECOND).horizontal_m2 == pytest.approx(before.horizontal_m2, rel=0.01)
    for k in range(20):
        each.fuse_gnss(10 * SECOND + k * SECOND // 5, (0.0, 5.0, 0.0), ZERO, ACCURACY)
    assert each.ratios.position > 1.0  # nor does it come in by being told often


def test_without_fixes_the_position_is_known_worse_and_worse() -> None:
    each = settled()
    deviations = [math.sqrt(each.variances((10 + later) * SECOND).horizontal_m2) for later in (0, 5, 10, 20)]
    assert deviations == sorted(deviations)
    assert 0.6 < deviations[1] < 1.2  # 0.04 m/s² for 5 s: 0.5 m
    assert 5.0 < deviations[3] < 12.0  # and for 20 s: 8 m


def test_a_tilt_that_comes_up_is_learnt_although_it_makes_velocities_refused() -> None:
    """Three degrees at once, as after a levelling in waves: without the growth nothing is taken for 5 s, then reset."""
    found = settled()
    tilt_mps2, bias_mps2, off_mps, off_m, refused = 0.5, 0.0, 0.0, 0.0, []
    for step in range(1, 101):
        off_m += 0.2 * off_mps
        off_mps += 0.2 * (tilt_mps2 - bias_mps2)
        moved = found.fuse_gnss(9 * SECOND + step * SECOND // 5, (-off_m, 0.0, 0.0), (-off_mps, 0.0, 0.0), ACCURACY)
        off_m, off_mps = off_m + moved.pos_ned_m[0], off_mps + moved.vel_ned_mps[0]
        bias_mps2 += moved.bias_ned_mps2[0]
        refused.append(found.ratios.velocity > 1.0)
    assert any(refused)
    assert "1111" not in "".join(str(int(one)) for one in refused)
    assert abs(off_mps) < 0.05
    assert bias_mps2 == pytest.approx(tilt_mps2, abs=0.05)
