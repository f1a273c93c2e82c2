"""Noise processes against the closed forms of a first-order Gauss-Markov process."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from sim_core.noise import GAUSS_MARKOV_ALLAN_PEAK, bias_deviation, sampled_gauss_markov, white_deviation


def test_the_allan_peak_is_the_maximum_of_the_closed_form():
    def negative_allan_variance(x: float) -> float:  # of unit deviation at tau = x Tc
        return -2.0 / x * (1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x))

    peak = minimize_scalar(negative_allan_variance, bounds=(0.1, 20.0), method="bounded", options={"xatol": 1e-9})
    assert peak.x == pytest.approx(1.8926, abs=1e-4)
    assert np.sqrt(-peak.fun) == pytest.approx(GAUSS_MARKOV_ALLAN_PEAK, rel=1e-9)
    # IEEE Std 952 states it by the driving density: 0.437 q sqrt(Tc), and a unit deviation is q = sqrt(2 / Tc).
    assert GAUSS_MARKOV_ALLAN_PEAK / np.sqrt(2.0) == pytest.approx(0.437, abs=5e-4)
    assert bias_deviation(GAUSS_MARKOV_ALLAN_PEAK) == pytest.approx(1.0)


def test_white_deviation_grows_with_the_root_of_the_rate():
    assert white_deviation(0.01, 100.0) == pytest.approx(0.1)
    assert white_deviation(0.01, 400.0) == pytest.approx(0.2)


@pytest.mark.parametrize("rate_hz", [0.1, 1.0, 400.0])
def test_discretisation_is_exact_at_any_rate(rate_hz):
    process = sampled_gauss_markov([2.0, 0.5], 60.0, rate_hz)
    np.testing.assert_allclose(process.decay, np.exp(-1.0 / (60.0 * rate_hz)), rtol=1e-14)
    stationary = (process.decay * process.deviation) ** 2 + process.drive**2
    np.testing.assert_allclose(stationary, process.deviation**2, rtol=1e-14)
    np.testing.assert_allclose(process.deviation, [[2.0, 0.5]])


def test_each_column_may_have_its_own_correlation_time():
    process = sampled_gauss_markov([1.0, 1.0], [10.0, 1000.0], 1.0)
    np.testing.assert_allclose(process.decay, np.exp([[-0.1, -0.001]]))
