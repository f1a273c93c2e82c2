"""The heading filter against headings and compass errors that are known exactly."""

from __future__ import annotations

import math
import random

import pytest

from agent.fcu.parameters import Parameters
from agent.navigation.heading_filter import HeadingFilter

FIELD_GAUSS, STEP_NS = 0.26, 20_000_000
NOISE_GAUSS, LASTING_GAUSS = 0.003, 0.005


def turning(time_s: float) -> float:
    """True heading: straight, a quarter turn in 10 s, straight."""
    return 0.5 * math.pi * min(max((time_s - 40.0) / 10.0, 0.0), 1.0)


class Compass:
    """A heading integrated from a gyro with a bias, and a compass in a field with a lasting error."""

    def __init__(self, seed: int, **parameters: float) -> None:
        draw = random.Random(seed)
        self.draw = draw
        self.forward, self.right = draw.gauss(0.0, LASTING_GAUSS), draw.gauss(0.0, LASTING_GAUSS)
        self.bias = draw.gauss(0.0, 0.01)  # rad/s
        self.filter = HeadingFilter(Parameters(dict(parameters)))
        self.time_ns = 0
        self.rate = 0.0
        self.estimated = self.measured()
        self.filter.restart(0, self.estimated, FIELD_GAUSS)

    def measured(self) -> float:
        """Heading by the field in body axes, declination zero."""
        true = turning(self.time_ns * 1e-9)
        forward = FIELD_GAUSS * math.cos(true) + self.forward + self.draw.gauss(0.0, NOISE_GAUSS)
        right = -FIELD_GAUSS * math.sin(true) + self.right + self.draw.gauss(0.0, NOISE_GAUSS)
        return math.atan2(-right, forward)

    @property
    def error(self) -> float:
        """True less estimated heading."""
        return math.remainder(turning(self.time_ns * 1e-9) - self.estimated, math.tau)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            before = turning(self.time_ns * 1e-9)
            self.time_ns += STEP_NS
            dt = STEP_NS * 1e-9
            self.estimated += turning(self.time_ns * 1e-9) - before + (self.bias + self.rate) * dt
            error = math.remainder(self.measured() - self.estimated, math.tau)
            if self.filter.add(self.time_ns, error):
                self.rate, change = self.filter.correct(self.time_ns, self.estimated, FIELD_GAUSS, 0.0)
                self.bias -= change


@pytest.mark.medium
def test_a_turn_separates_the_field_from_the_heading() -> None:
    straight, turned = [], []
    for seed in range(60):
        compass = Compass(seed)
        compass.run(35.0)
        straight.append(compass.error**2)
        compass.run(35.0)
        turned.append(compass.error**2)
    before, after = (math.degrees(math.sqrt(sum(squares) / len(squares))) for squares in (straight, turned))
    assert before == pytest.approx(math.degrees(LASTING_GAUSS / FIELD_GAUSS), rel=0.3)
    assert after < 0.35 * before


@pytest.mark.medium
@pytest.mark.parametrize("seconds", [20.0, 35.0, 45.0, 52.0, 75.0])
def test_headings_err_as_much_as_the_variance_says(seconds: float) -> None:
    """Mean of 120 draws: the deviation of such a mean is 0.13."""
    total = 0.0
    for seed in range(120):
        compass = Compass(seed)
        compass.run(seconds)
        total += compass.error**2 / compass.filter.variance_rad2(compass.time_ns)
    assert total / 120 == pytest.approx(1.0, abs=0.4)


def test_the_bias_of_the_gyro_is_learned() -> None:
    compass = Compass(1)
    compass.bias = math.radians(0.5)
    compass.run(38.0)
    assert abs(compass.bias) < math.radians(0.02)


@pytest.mark.parametrize("gain_per_s", [0.1, 0.4])
def test_it_settles_to_the_gain_of_the_parameter(gain_per_s: float) -> None:
    """Without a lasting error of the field: a step of the compass is corrected by the gain times the time."""
    heading = HeadingFilter(Parameters({"AHRS_YAW_P": gain_per_s, "EK3_MAGB_M_NSE": 0.0}))
    heading.restart(0, 0.0, FIELD_GAUSS)
    for sample in range(1, 9001):
        if heading.add(sample * STEP_NS, 0.0):
            heading.correct(sample * STEP_NS, 0.0, FIELD_GAUSS, 0.06)
    for sample in range(9001, 9011):
        if heading.add(sample * STEP_NS, 0.01):
            correction = heading.correct(sample * STEP_NS, 0.0, FIELD_GAUSS, 0.06)
    assert correction.rate_radps * 0.2 == pytest.approx(gain_per_s * 0.2 * 0.01, rel=0.15)


def test_the_variance_grows_without_a_compass() -> None:
    compass = Compass(2)
    compass.run(30.0)
    now = compass.filter.variance_rad2(compass.time_ns)
    compass.filter.stop(compass.time_ns + 500_000_000)
    later = [compass.filter.variance_rad2(compass.time_ns + seconds * 1_000_000_000) for seconds in (1, 10, 60)]
    assert now < later[0] < later[1] < later[2]
