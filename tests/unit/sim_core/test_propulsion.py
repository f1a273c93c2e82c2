"""Lag and thrust of the propellers, force of the wind."""

from __future__ import annotations

import math

import numpy as np
import pytest
from vessels import FULL

from sim_core.environment.spec import Water
from sim_core.vessel.propulsion import Propulsion
from sim_core.vessel.windage import AIR_DENSITY_KGPM3, WindDrag

DT_S = 0.0025
PROPULSION = Propulsion.from_spec(FULL, Water(), DT_S)


def thrust_wrench(speed: list[float]) -> np.ndarray:
    return (
        np.concatenate(PROPULSION.terms(np.array([speed]), np.zeros((1, 6)), np.zeros((1, 3))), axis=1)
        @ PROPULSION.wrench
    )[0]


def spun(speed: float, command: float, duration_s: float) -> float:
    speeds = np.full((1, 2), speed)
    for _ in range(round(duration_s / DT_S)):
        speeds = PROPULSION.spin(speeds, np.full((1, 2), command))
    return float(speeds[0, 0])


def test_speeding_up_takes_its_time_constant() -> None:
    assert spun(0.0, 1.0, 0.25) == pytest.approx(1.0 - math.exp(-1.0), rel=1e-9)
    assert spun(0.0, -1.0, 0.25) == pytest.approx(-1.0 + math.exp(-1.0), rel=1e-9)


def test_slowing_down_takes_its_own() -> None:
    assert spun(1.0, 0.0, 0.4) == pytest.approx(math.exp(-1.0), rel=1e-9)
    assert spun(1.0, 0.5, 0.4) == pytest.approx(0.5 + 0.5 * math.exp(-1.0), rel=1e-9)


def test_commands_are_clamped() -> None:
    assert spun(0.0, 7.0, 5.0) == pytest.approx(1.0)


def test_thrust_goes_with_the_square_and_has_its_own_reverse() -> None:
    assert thrust_wrench([1.0, 1.0])[0] == pytest.approx(500.0)
    assert thrust_wrench([0.5, 0.5])[0] == pytest.approx(125.0)
    assert thrust_wrench([-1.0, -1.0])[0] == pytest.approx(-300.0)
    assert thrust_wrench([-0.5, 0.0])[0] == pytest.approx(-37.5)


def test_port_ahead_and_starboard_astern_turns_to_starboard() -> None:
    wrench = thrust_wrench([1.0, -1.0])
    assert wrench[5] == pytest.approx(0.5 * 250.0 + 0.5 * 150.0)


def test_thrust_above_the_centre_pitches_the_bow_down() -> None:
    assert thrust_wrench([1.0, 1.0])[4] == pytest.approx(-0.55 * 500.0)


@pytest.mark.parametrize("velocity", [(3.0, 0.0), (-2.0, 4.0), (0.0, -5.0), (1.0, 1.0)])
def test_wind_force_has_fossens_coefficients_and_acts_at_its_height(velocity: tuple[float, float]) -> None:
    """Eq 10.16-10.18 with the angle of attack gamma = -atan2(v_rw, u_rw); K = -z Y, M = z X."""
    drag = WindDrag.from_spec(FULL, 0.15)
    u, v = velocity
    force = (np.concatenate(drag.terms(np.array([[u, v, 9.0]])), axis=1) @ drag.wrench)[0]
    gamma = -math.atan2(v, u)
    pressure = 0.5 * AIR_DENSITY_KGPM3 * (u * u + v * v)
    down_m = 0.15 - 0.5 * 1.3 / 2.3  # of the areas' centre, half their mean height above the water
    expected = [
        -0.7 * math.cos(gamma) * pressure * 0.9,
        0.9 * math.sin(gamma) * pressure * 1.3,
        0,
        -down_m * 0.9 * math.sin(gamma) * pressure * 1.3,
        -down_m * 0.7 * math.cos(gamma) * pressure * 0.9,
        0.1 * math.sin(2.0 * gamma) * pressure * 1.3 * 2.3,
    ]
    np.testing.assert_allclose(force, expected, atol=1e-12)
