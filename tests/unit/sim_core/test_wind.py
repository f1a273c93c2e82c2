"""Gusts, mean wind and current against their statistics and shapes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import welch
from vessels import FULL

from sim_core.environment.current import StillWater, UniformCurrent, make_current
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, DiscreteGust, GustSpec, WindSpec
from sim_core.environment.wind import (
    HIGHEST_HZ,
    LOWEST_HZ,
    OrnsteinUhlenbeckGust,
    SpectralGust,
    StillAir,
    Wind,
    davenport_density,
    discrete_gust_mps,
    gust_density,
    harris_density,
    npd_density,
)
from sim_core.noise import GaussMarkov
from sim_core.simulation import Simulation, initial


@pytest.mark.parametrize("dt_s", [0.0025, 0.5])
def test_gauss_markov_has_its_deviation_and_correlation_at_any_step(dt_s: float) -> None:
    """20 000 independent processes: the variance is known to sqrt(2 / 20 000) = 1 %, the correlation to 0.7 %."""
    process = GaussMarkov(1.5, 2.0)
    rng = np.random.default_rng(0)
    first = process.initial(20_000, rng)
    value = first
    for _ in range(round(1.0 / dt_s)):
        value = process.step(value, dt_s, rng)
    assert first.std() == pytest.approx(1.5, rel=0.02)
    assert value.std() == pytest.approx(1.5, rel=0.02)
    assert np.corrcoef(first, value)[0, 1] == pytest.approx(math.exp(-0.5), abs=0.02)


@pytest.mark.medium
def test_one_long_record_has_the_same_statistics() -> None:
    """Ergodic: 4000 correlation times give the variance to about sqrt(2 / 4000) = 2 %."""
    gust = OrnsteinUhlenbeckGust(GaussMarkov(2.0, 0.5))
    rng = np.random.default_rng(1)
    state = gust.initial(1, rng)
    record = np.empty(40_000)
    for i in range(len(record)):
        state = gust.step(state, 0.05, rng)
        record[i] = gust.speed_mps(state, 0.0)[0]
    assert record.var() == pytest.approx(4.0, rel=0.08)
    assert np.corrcoef(record[:-10], record[10:])[0, 1] == pytest.approx(math.exp(-1.0), abs=0.05)


@pytest.mark.medium
@pytest.mark.parametrize("name", ["npd", "harris", "davenport"])
def test_spectral_gusts_return_their_spectrum(name: str) -> None:
    """Welch over 200 vessels' records of half an hour, energy in bands of an octave or more."""
    gust = SpectralGust.from_spectrum(name, mean_mps=8.0, height_m=10.0)
    state = gust.initial(200, np.random.default_rng(2))
    record = np.array([gust.speed_mps(state, t) for t in np.arange(0.0, 1800.0, 0.25)])
    frequency_hz, power = welch(record, fs=4.0, nperseg=2048, axis=0)
    realised = power.mean(axis=1)
    density = gust_density(name)
    for low, high in ((0.008, 0.02), (0.02, 0.06), (0.06, 0.2), (0.2, 0.6), (0.6, 1.6)):
        band = (frequency_hz >= low) & (frequency_hz < high)
        step = frequency_hz[1]
        edges = frequency_hz[band][0] - step / 2, frequency_hz[band][-1] + step / 2
        nominal = quad(lambda f: density(np.array([f]), 8.0, 10.0)[0], *edges)[0]
        # A band holds five or more of the 48 harmonics; one of them may fall on either side of its edge.
        assert realised[band].sum() * step == pytest.approx(nominal, rel=0.25)
    nominal = quad(lambda f: density(np.array([f]), 8.0, 10.0)[0], LOWEST_HZ, HIGHEST_HZ, limit=500)[0]
    assert 0.5 * (gust.amplitude_mps**2).sum() == pytest.approx(nominal, rel=1e-3)


def test_spectral_gust_scaled_to_a_deviation() -> None:
    gust = SpectralGust.from_spectrum("npd", 6.0, 10.0, deviation_mps=1.5)
    state = gust.initial(5000, np.random.default_rng(3))
    assert gust.speed_mps(state, 100.0).std() == pytest.approx(1.5, rel=0.04)


@pytest.mark.parametrize("name", ["npd", "harris", "davenport"])
def test_spectral_gusts_go_by_the_mean_at_10_m(name: str) -> None:
    """5 m/s at 0.3 m are 8.2 m/s at 10 m: gusts have the energy of that mean, at 0.3 m."""
    low, high = (
        Wind(WindSpec(mean_mps, gust=GustSpec(name), reference_height_m=height_m))
        for mean_mps, height_m in ((5.0, 0.3), (5.0 * (10.0 / 0.3) ** (1.0 / 7.0), 10.0))
    )
    rng = np.random.default_rng(4)
    gusts = [wind.velocity_ned_mps(wind.initial(4000, rng), 50.0)[:, 0] for wind in (low, high)]
    density, mean_mps = gust_density(name), high.spec.mean_mps
    for found, at_m in zip(gusts, (0.3, 10.0), strict=True):
        band = {"a": LOWEST_HZ, "b": HIGHEST_HZ, "limit": 500}
        energy = quad(lambda f, height_m: density(np.array([f]), mean_mps, height_m)[0], args=(at_m,), **band)[0]
        assert found.var() == pytest.approx(energy, rel=0.1)  # of 4000 draws: 2.2 %


def test_gust_densities_have_their_closed_integrals() -> None:
    """Davenport: 6 k U^2. Harris: 4 k U^2 2^(-1/3) sqrt(pi) Gamma(1/3) / (2 Gamma(5/6)). NPD at f = 0."""
    davenport = quad(lambda x: davenport_density(np.array([np.exp(x)]), 9.0, 10.0)[0] * np.exp(x), -16.0, 16.0)[0]
    assert davenport == pytest.approx(6.0 * 0.003 * 81.0, rel=1e-3)
    harris = quad(lambda x: harris_density(np.array([np.exp(x)]), 9.0, 10.0)[0] * np.exp(x), -20.0, 20.0)[0]
    integral = 2.0 ** (-1 / 3) * math.sqrt(math.pi) * math.gamma(1 / 3) / (2.0 * math.gamma(5 / 6))
    assert harris == pytest.approx(4.0 * 0.003 * 81.0 * integral, rel=1e-3)
    assert npd_density(np.array([0.0]), 20.0, 40.0)[0] == pytest.approx(320.0 * 4.0 * 4.0**0.45)


def test_gust_densities_have_their_lengths() -> None:
    """Davenport and Harris at one wave per 1200 and 1800 m. NPD at 0.01 Hz, x = 1.720 and 2.577, worked by hand."""
    davenport = davenport_density(np.array([9.0 / 1200.0]), 9.0, 10.0)[0]
    assert davenport * 9.0 / 1200.0 == pytest.approx(4.0 * 0.003 * 81.0 / 2.0 ** (4.0 / 3.0))
    harris = harris_density(np.array([9.0 / 1800.0]), 9.0, 10.0)[0]
    assert harris * 9.0 / 1800.0 == pytest.approx(4.0 * 0.003 * 81.0 / 3.0 ** (5.0 / 6.0))
    assert npd_density(np.array([0.01]), 10.0, 10.0)[0] == pytest.approx(16.765, rel=1e-4)
    assert npd_density(np.array([0.01]), 20.0, 40.0)[0] == pytest.approx(84.30, rel=1e-4)


def test_unknown_and_impossible_gusts_are_refused() -> None:
    with pytest.raises(ValueError, match=r"kaimal.*npd, harris, davenport"):
        SpectralGust.from_spectrum("kaimal", 5.0, 10.0)
    with pytest.raises(ValueError, match="positive mean_mps"):
        SpectralGust.from_spectrum("npd", 0.0, 10.0)
    with pytest.raises(ValueError, match="correlation_s = 0"):
        GaussMarkov(1.0, 0.0)
    with pytest.raises(ValueError, match="rise_s"):
        DiscreteGust(0.0, 0.0, 1.0, 1.0, 3.0)


def test_discrete_gust_rises_and_falls_as_one_minus_cosine() -> None:
    gust = DiscreteGust(start_s=10.0, rise_s=2.0, hold_s=3.0, fall_s=4.0, speed_mps=6.0)
    times = (0.0, 10.0, 12.0, 13.5, 15.0, 19.0, 50.0)
    assert [discrete_gust_mps(gust, t) for t in times] == pytest.approx([0, 0, 6, 6, 6, 0, 0])
    assert discrete_gust_mps(gust, 10.5) == pytest.approx(3.0 * (1.0 - math.cos(math.pi / 4)))
    assert discrete_gust_mps(gust, 16.0) == pytest.approx(3.0 * (1.0 + math.cos(math.pi / 4)))


def test_wind_comes_from_its_direction() -> None:
    wind = Wind(WindSpec(5.0, 270.0, discrete_gusts=(DiscreteGust(0.0, 1.0, 100.0, 1.0, 2.0),)))
    state = wind.initial(3, np.random.default_rng(0))
    np.testing.assert_allclose(wind.velocity_ned_mps(state, -1.0), np.tile([0.0, 5.0, 0.0], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(wind.velocity_ned_mps(state, 10.0), np.tile([0.0, 7.0, 0.0], (3, 1)), atol=1e-12)


def test_the_wind_grows_with_height() -> None:
    """(h / r)^p and ln(h / z0) / ln(r / z0); DNV-RP-C205 has the second as 1 + ln(h / r) / ln(r / z0)."""
    heights = np.array([0.3, 2.0, 10.0, 20.0])
    for spec, expected in (
        (WindSpec(8.0), (heights / 10.0) ** (1.0 / 7.0)),
        (WindSpec(8.0, exponent=0.11, reference_height_m=2.0), (heights / 2.0) ** 0.11),
        (WindSpec(8.0, profile="logarithmic"), 1.0 + np.log(heights / 10.0) / np.log(10.0 / 0.0002)),
        (WindSpec(8.0, profile="uniform"), np.ones(4)),
    ):
        wind = Wind(spec)
        np.testing.assert_allclose(wind.share(heights), expected, rtol=1e-12)
        state = wind.initial(2, np.random.default_rng(0))
        low = wind.velocity_ned_mps(state, 0.0, 0.3)
        np.testing.assert_allclose(low, expected[0] * wind.velocity_ned_mps(state, 0.0), rtol=1e-12)
    assert Wind(WindSpec(8.0)).share(0.0) == Wind(WindSpec(8.0)).share(0.05)  # among the waves


def test_a_vessel_feels_the_wind_at_the_height_of_its_areas() -> None:
    """By the reference height alone, and by the height of the areas alone."""
    areas_m = 0.5 * FULL.wind.lateral_area_m2 / FULL.wind.length_m
    for reference_m, height_m in ((10.0, None), (2.0, None), (10.0, 1.5)):
        environment = Environment(wind=Wind(WindSpec(8.0, 180.0, reference_height_m=reference_m)))
        model = replace(FULL, wind=replace(FULL.wind, height_m=height_m))
        simulation = Simulation.from_spec(model, environment, 0.0025)
        state = initial(simulation, np.zeros((1, 2)), np.zeros(1), np.random.default_rng(0))
        expected = 8.0 * ((height_m or areas_m) / reference_m) ** (1.0 / 7.0)
        np.testing.assert_allclose(state.wind_ned_mps, [[expected, 0.0, 0.0]], atol=1e-12)


def test_wind_veers_about_its_mean() -> None:
    wind = Wind(WindSpec(5.0, 0.0, direction_deviation_deg=10.0, direction_correlation_s=50.0))
    rng = np.random.default_rng(0)
    state = wind.step(wind.initial(20_000, rng), 1.0, rng)
    velocity = wind.velocity_ned_mps(state, 0.0)
    veer = np.degrees(np.arctan2(-velocity[:, 1], -velocity[:, 0]))
    assert veer.std() == pytest.approx(10.0, rel=0.03)
    np.testing.assert_allclose(np.hypot(velocity[:, 0], velocity[:, 1]), 5.0)


def test_still_air_and_still_water() -> None:
    rng = np.random.default_rng(0)
    air, water = StillAir(), StillWater()
    assert not air.velocity_ned_mps(air.step(air.initial(2, rng), 1.0, rng), 3.0).any()
    assert not water.velocity_ned_mps(water.step(water.initial(2, rng), 1.0, rng), np.ones((2, 3))).any()


def test_current_fluctuates_about_its_mean_along_its_direction() -> None:
    current = UniformCurrent(CurrentSpec(0.5, 30.0, deviation_mps=0.1, correlation_s=20.0))
    rng = np.random.default_rng(0)
    first = current.initial(20_000, rng)
    state = first
    for _ in range(100):
        state = current.step(state, 0.1, rng)
    velocity = current.velocity_ned_mps(state, np.zeros((20_000, 3)))
    along = velocity @ [math.cos(math.pi / 6), math.sin(math.pi / 6), 0.0]
    assert along.mean() == pytest.approx(0.5, abs=0.004)
    assert along.std() == pytest.approx(0.1, rel=0.03)
    assert np.corrcoef(first, state)[0, 1] == pytest.approx(math.exp(-0.5), abs=0.02)
    np.testing.assert_allclose(np.cross(velocity, [math.cos(math.pi / 6), math.sin(math.pi / 6), 0.0]), 0.0, atol=1e-12)


def test_channel_current_slackens_toward_the_banks() -> None:
    banks = {"channel_centre_ned_m": (20.0, 0.0), "channel_bank_ratio": 0.25, "channel_bank_exponent": 2.0}
    channel = make_current(CurrentSpec(1.0, 90.0, channel_width_m=100.0, **banks))
    places = np.array([[20.0, 7.0, 0.0], [45.0, -90.0, 0.0], [-30.0, 5.0, 0.0], [500.0, 0.0, 0.0]])
    velocity = channel.velocity_ned_mps(channel.initial(4, np.random.default_rng(0)), places)
    np.testing.assert_allclose(velocity[:, 1], [1.0, 1.0 - 0.75 * 0.25, 0.25, 0.25])
    np.testing.assert_allclose(velocity[:, 0], 0.0, atol=1e-15)


def test_impossible_currents_are_refused() -> None:
    with pytest.raises(ValueError, match="speed_mps = -1"):
        UniformCurrent(CurrentSpec(-1.0, 0.0))
    with pytest.raises(ValueError, match="bank_ratio = 2"):
        CurrentSpec(1.0, 0.0, channel_bank_ratio=2.0)
