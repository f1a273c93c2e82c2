"""Indices of Sobol and Morris against functions whose indices are known, elasticities against power laws."""

from __future__ import annotations

import numpy as np
import pytest

from xitl_cli.plugins.campaign.sensitivity import axis_effects, elasticities, unit_sample

ISHIGAMI = {"x1": (0.3139, 0.5576), "x2": (0.4424, 0.4424), "x3": (0.0, 0.2437)}
"""First-order and total indices for a = 7, b = 0.1: Homma and Saltelli 1996, Reliability Engineering 52."""
G_COEFFICIENTS = (0.0, 1.0, 4.5, 9.0, 99.0)


def ishigami(x: np.ndarray) -> np.ndarray:
    angles = np.pi * (2 * x - 1)
    return np.sin(angles[:, 0]) + 7 * np.sin(angles[:, 1]) ** 2 + 0.1 * angles[:, 2] ** 4 * np.sin(angles[:, 0])


def sobol_g(x: np.ndarray) -> np.ndarray:
    a = np.array(G_COEFFICIENTS)
    return np.prod((np.abs(4 * x - 2) + a) / (1 + a), axis=1)


def g_indices() -> list[tuple[float, float]]:
    """In closed form: V_i = 1/(3 (1 + a_i)²), V = Π(1 + V_i) - 1 (Saltelli and Sobol 1995)."""
    parts = np.array([1 / (3 * (1 + a) ** 2) for a in G_COEFFICIENTS])
    whole = np.prod(1 + parts) - 1
    return [(v / whole, v * np.prod(1 + parts) / (1 + v) / whole) for v in parts]


@pytest.mark.medium
def test_ishigami() -> None:
    sample = unit_sample("sobol", 3, 1024, seed=3)
    assert sample.shape == (1024 * 5, 3)
    told = axis_effects("y", "sobol", list(ISHIGAMI), sample, ishigami(sample), 0.95, seed=3)
    assert [effect.axis for effect in told.effects] == ["x1", "x2", "x3"]
    for effect in told.effects:
        main, total = ISHIGAMI[effect.axis]
        assert effect.main_interval is not None
        assert main in effect.main_interval
        assert total in effect.total_interval
        assert effect.total_interval.width < 0.2
    assert (told.used, told.dropped) == (1024, 0)


@pytest.mark.medium
def test_sobols_g_function() -> None:
    names = [f"x{number}" for number in range(5)]
    sample = unit_sample("sobol", 5, 1024, seed=1)
    told = axis_effects("y", "sobol", names, sample, sobol_g(sample), 0.95, seed=1)
    assert [effect.axis for effect in told.effects] == names
    for effect, (main, total) in zip(told.effects, g_indices(), strict=True):
        assert effect.total == pytest.approx(total, abs=0.03)
        assert effect.main == pytest.approx(main, abs=0.06)


@pytest.mark.medium
def test_morris_of_a_plane_is_its_coefficients() -> None:
    sample = unit_sample("morris", 3, 8, seed=5)
    told = axis_effects("y", "morris", ["a", "b", "c"], sample, sample @ np.array([1.0, -5.0, 0.0]), 0.95, seed=5)
    assert [effect.axis for effect in told.effects] == ["b", "a", "c"]
    assert [effect.total for effect in told.effects] == pytest.approx([5.0, 1.0, 0.0])
    assert [effect.main for effect in told.effects] == pytest.approx([-5.0, 1.0, 0.0])
    assert [effect.interaction for effect in told.effects] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


@pytest.mark.medium
def test_a_group_with_a_run_that_told_nothing_is_left_out_and_counted() -> None:
    sample = unit_sample("morris", 2, 8, seed=5)
    values = sample @ np.array([1.0, 2.0])
    values[4] = np.nan
    told = axis_effects("y", "morris", ["a", "b"], sample, values, 0.95, seed=5)
    assert (told.used, told.dropped) == (7, 1)
    assert [effect.total for effect in told.effects] == pytest.approx([2.0, 1.0])
    assert "only 0 of 8" in axis_effects("y", "morris", ["a", "b"], sample, values * np.nan, 0.95, seed=5).why


def test_elasticities_of_a_power_law() -> None:
    """y = x²/z about x = 2, z = 4: 2 and -1, as straight lines over ±1 % see them."""
    nominal = {"x": 2.0, "z": 4.0}
    series = {
        "x": {seed: [(x, x**2 / 4 * (1 + seed)) for x in (1.98, 2.0, 2.02)] for seed in (1, 2, 3)},
        "z": {seed: [(z, 4 / z * (1 + seed)) for z in (3.96, 4.0, 4.04)] for seed in (1, 2, 3)},
    }
    x, z = elasticities(nominal, series, 0.95)
    assert (x.axis, x.elasticity, x.seeds) == ("x", pytest.approx(2.0, abs=1e-3), 3)
    assert (z.axis, z.elasticity) == ("z", pytest.approx(-1.0, abs=1e-3))
    assert x.interval is not None
    assert x.elasticity in x.interval


def test_an_axis_that_is_zero_at_nominal_has_a_slope_and_no_elasticity() -> None:
    (told,) = elasticities({"x": 0.0}, {"x": {1: [(0.0, 1.0), (2.0, 5.0)]}}, 0.95)
    assert (told.elasticity, told.slope, told.interval) == (None, pytest.approx(2.0), None)
