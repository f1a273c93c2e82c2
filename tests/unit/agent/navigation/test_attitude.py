"""Corrections of the integrated attitude."""

from __future__ import annotations

import math

import pytest

from agent.navigation.attitude import AttitudeCorrection
from agent.navigation.inertial import InertialState


def tilt_rate_radps(north_rad: float, east_rad: float) -> tuple[float, ...]:
    """The correcting rate for one tilt error of a level vessel that points north, with a gain of 0.1 per second."""
    level = InertialState(0, 1.0, 0.0, 0.0, 0.0, *[0.0] * (len(InertialState._fields) - 5))
    correction = AttitudeCorrection(0.1)
    correction.settle(0.0)
    correction.tilt(level, north_rad, east_rad, 0.01)
    return correction.rate_offset_frd_radps


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_tilt_error_beyond_the_limit_corrects_no_faster(sign: float) -> None:
    """A shock of 1 g looks like a tilt of 45 degrees; it must not turn the attitude by that much."""
    shock = tilt_rate_radps(sign * math.pi / 4, sign * 10.0)
    assert shock == tilt_rate_radps(sign * 0.3, sign * 0.3)
    assert shock != tilt_rate_radps(sign * 0.29, sign * 0.29)
    assert tilt_rate_radps(0.1, 0.0)[0] == pytest.approx(tilt_rate_radps(0.2, 0.0)[0] / 2)
