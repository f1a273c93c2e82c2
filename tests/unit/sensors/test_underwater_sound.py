"""Sound in fresh water against other authors' equations."""

from __future__ import annotations

import math

import pytest

from sim_core.sensors.sonar import absorption_dbpm, sound_speed_mps


@pytest.mark.parametrize("temperature_c", [4.0, 12.0, 20.0, 25.0, 30.0])
@pytest.mark.parametrize("frequency_khz", [500.0, 750.0, 1000.0])
def test_absorption_is_that_of_ainslie_and_mccolm(temperature_c: float, frequency_khz: float) -> None:
    """Their simplified equation (1998) claims to be within 10 % of Francois and Garrison's."""
    expected = 0.00049 * frequency_khz**2 * math.exp(-temperature_c / 27.0) * 1e-3
    assert absorption_dbpm(frequency_khz, temperature_c) == pytest.approx(expected, rel=0.1)


def test_absorption_is_continuous_where_its_coefficients_change() -> None:
    assert absorption_dbpm(750.0, 20.0) == pytest.approx(absorption_dbpm(750.0, 20.001), rel=5e-3)


@pytest.mark.parametrize("temperature_c", [0.0, 10.0, 20.0, 27.0, 40.0])
def test_sound_speed_is_that_of_del_grosso_and_mader(temperature_c: float) -> None:
    """Their polynomial (1972); Marczak's, of later and earlier data, is within 0.05 m/s of it."""
    coefficients = (1402.38754, 5.03711129, -0.0580852166, 0.334198834e-3, -0.147800417e-5, 0.314643091e-8)
    expected = sum(value * temperature_c**power for power, value in enumerate(coefficients))
    assert sound_speed_mps(temperature_c) == pytest.approx(expected, abs=0.05)
