"""Standard errors of a linear model whose residuals are correlated: how often they contain the truth."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("scipy")

from xitl_cli.plugins.identify.recording import Floats
from xitl_cli.plugins.identify.sandwich import Sandwich

WINDOWS, LENGTH, PARAMETERS, TRIALS = 16, 50, 4, 300
ROWS = [slice(number * LENGTH, (number + 1) * LENGTH) for number in range(WINDOWS)]
ADJACENT = np.eye(WINDOWS, k=1) + np.eye(WINDOWS, k=-1)
NO_PRIOR = np.full(PARAMETERS, np.inf)


def ar1(rng: np.random.Generator, correlation: float, rows: int) -> Floats:
    """Return (WINDOWS * LENGTH, rows) of a process of the first order with a standard deviation of 1."""
    value = rng.standard_normal(rows)
    result = np.empty((WINDOWS * LENGTH, rows))
    for step in range(len(result)):
        result[step] = value
        value = correlation * value + np.sqrt(1.0 - correlation**2) * rng.standard_normal(rows)
    return result


def estimates(manoeuvres: bool, correlation: float) -> tuple[Floats, Floats]:
    """Return (TRIALS, PARAMETERS) estimates of 0 and their standard errors, with noise of this correlation.

    manoeuvres: each parameter acts on three windows alone, as a manoeuvre does.
    """
    rng = np.random.default_rng(7)
    signals = ar1(rng, 0.95, TRIALS * PARAMETERS).reshape(-1, TRIALS, PARAMETERS)
    if manoeuvres:
        window = np.arange(WINDOWS * LENGTH)[:, None, None] // LENGTH
        signals *= (window >= 3 * np.arange(PARAMETERS)) & (window < 3 * np.arange(PARAMETERS) + 3)
    found, errors = [], []
    for derivatives, noise in zip(signals.transpose(1, 0, 2), ar1(rng, correlation, TRIALS).T, strict=True):
        estimate = np.linalg.lstsq(derivatives, noise)[0]
        residual = noise - derivatives @ estimate
        sandwich = Sandwich.from_windows(residual, derivatives, ROWS, ADJACENT, NO_PRIOR)
        found.append(estimate)
        errors.append(sandwich.sigma(np.eye(PARAMETERS)))
    return np.array(found), np.array(errors)


@pytest.mark.medium
@pytest.mark.parametrize(("manoeuvres", "correlation"), [(False, 0.9), (True, 0.9), (True, 0.95)])
def test_two_standard_errors_contain_the_truth_in_95_of_100_cases(manoeuvres: bool, correlation: float) -> None:
    """The estimates of one trial are almost independent: the share of 1200 has a standard deviation of 0.6 %."""
    found, errors = estimates(manoeuvres, correlation)
    inside = np.mean(np.abs(found) < 2.0 * errors)
    deviation = np.sqrt(0.954 * 0.046 / found.size)
    assert abs(inside - 0.954) < 4.0 * deviation, inside


@pytest.mark.medium
def test_white_residuals_of_many_windows_have_the_error_of_the_textbook() -> None:
    rng = np.random.default_rng(3)
    rows = [slice(number * 20, (number + 1) * 20) for number in range(200)]
    derivatives = rng.standard_normal((4000, 2)) @ np.array([[1.0, 0.7], [0.0, 0.5]])
    noise = rng.standard_normal(4000)
    residual = noise - derivatives @ np.linalg.lstsq(derivatives, noise)[0]
    sandwich = Sandwich.from_windows(residual, derivatives, rows, np.zeros((200, 200)), np.full(2, np.inf))
    textbook = np.linalg.inv(derivatives.T @ derivatives)
    slopes = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, -1.0]])
    assert sandwich.sigma(slopes) == pytest.approx(
        np.sqrt(np.einsum("fi,ij,fj->f", slopes, textbook, slopes)), rel=0.15
    )
    assert np.diag(sandwich.covariance()) == pytest.approx(np.diag(textbook), rel=0.3)


def test_a_parameter_that_no_residual_shows_keeps_the_error_of_its_prior() -> None:
    derivatives = np.zeros((40, 2))
    derivatives[:, 0] = np.random.default_rng(1).standard_normal(40)
    rows = [slice(10 * number, 10 * number + 10) for number in range(4)]
    sandwich = Sandwich.from_windows(np.ones(40), derivatives, rows, np.zeros((4, 4)), np.array([5.0, 3.0]))
    assert sandwich.sigma(np.eye(2))[1] == pytest.approx(3.0)
