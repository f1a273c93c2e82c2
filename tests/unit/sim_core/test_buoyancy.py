"""Segment area, draft and stiffness against numerical integration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from vessels import FULL

from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.buoyancy import make_buoyancy, segment_area_m2
from sim_core.vessel.floating import floating_pose

RADIUS_M = 0.2


def integrated_area(submerged_m: float) -> float:
    """Width of the circle integrated over depth, in the angle, where the integrand is smooth."""
    top = np.arccos(1.0 - np.clip(submerged_m / RADIUS_M, 0.0, 2.0))
    return quad(lambda angle: 2.0 * (RADIUS_M * np.sin(angle)) ** 2, 0.0, top)[0]


@pytest.mark.parametrize("submerged_m", [-0.3, 0.0, 1e-4, 0.05, 0.1, 0.2, 0.33, 0.4, 0.7])
def test_segment_area(submerged_m: float) -> None:
    area = segment_area_m2(np.array([submerged_m]), RADIUS_M)[0]
    assert area == pytest.approx(integrated_area(submerged_m), rel=1e-9, abs=1e-15)


def test_dry_and_drowned() -> None:
    dry, drowned = segment_area_m2(np.array([-1.0, 1.0]), RADIUS_M)
    assert dry == 0.0
    assert drowned == pytest.approx(np.pi * RADIUS_M**2)


def test_draft_displaces_the_mass() -> None:
    water = Water(density_kgpm3=997.8)
    expected = brentq(lambda h: 997.8 * 2.3 * 2 * integrated_area(h) - 113.0, 0.0, 0.4)
    assert floating_pose(FULL, water).draft_m == pytest.approx(expected, abs=1e-9)
    assert floating_pose(FULL, water).draft_m == pytest.approx(0.1, abs=0.001)


def test_too_heavy_a_vessel_is_refused() -> None:
    with pytest.raises(ValueError, match=r"mass_kg = 600 sinks: the two hulls carry 576.8 kg"):
        floating_pose(replace(FULL, mass_kg=600.0), Water())


def test_strips_lie_along_both_hulls() -> None:
    axes = make_buoyancy(FULL, Water()).points_frd_m
    assert axes.shape == (12, 3)
    np.testing.assert_allclose(axes.mean(axis=0), [0.0, 0.0, 0.05], atol=1e-15)
    assert set(np.round(axes[:, 1], 12)) == {-0.6, 0.6}
    assert axes[0, 0] == pytest.approx(-2.3 / 2 + 2.3 / 12)


@pytest.mark.parametrize("level_m", [-0.01, 3.0])
def test_a_vessel_at_rest_stays_at_rest(level_m: float) -> None:
    simulation = Simulation.from_spec(FULL, Environment(water=Water(level_m=level_m)), 0.0025)
    rng = np.random.default_rng(0)
    start = initial(simulation, np.zeros((1, 2)), np.array([1.0]), rng)
    state = start
    for _ in range(400):
        state = step(simulation, state, np.zeros((1, 2)), rng)
    np.testing.assert_allclose(state.vessel.motion.pos_ned_m, start.vessel.motion.pos_ned_m, atol=1e-9)
    assert start.vessel.motion.pos_ned_m[0, 2] == pytest.approx(-level_m + 0.1 - 0.25, abs=0.001)
