"""Published vessels: what their own programs gave when they were run, and what their equations give here."""

from __future__ import annotations

import numpy as np
import pytest

from tests.oracles.otter import Otter


@pytest.mark.parametrize(
    ("shafts_radps", "surge_mps", "sway_mps", "yaw_radps", "heading_10_s_deg"),
    [
        ((100, 80), 2.3275, -0.2381, 0.2639, 129.53),
        ((100, -60), 1.1459, -0.1368, 0.3057, 167.71),
        ((50, -50), 0.2313, -0.0164, 0.1488, 81.70),
    ],
)
def test_the_equations_of_the_otter_are_those_of_its_program(
    shafts_radps: tuple[float, float], surge_mps: float, sway_mps: float, yaw_radps: float, heading_10_s_deg: float
) -> None:
    """Figures of otter.py of PythonVehicleSimulator (c717e07), after 60 s by its own Euler steps of 2 ms."""
    states = Otter(shafts_radps, as_run=True).run(30.0, dt_s=0.1)
    np.testing.assert_allclose(states[-1, [0, 1, 5]], [surge_mps, sway_mps, yaw_radps], atol=2e-4)
    assert np.degrees(states[100, 11]) == pytest.approx(heading_10_s_deg, abs=0.1)  # their Euler steps: 0.04 degrees
