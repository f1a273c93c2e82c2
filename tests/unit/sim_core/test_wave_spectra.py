"""Spectra, dispersion and the realised sea: what a record of the surface gives back."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.signal import welch

from sim_core.environment.environment import Environment
from sim_core.environment.spec import GRAVITY_MPS2, CurrentSpec, EnvironmentSpec, Water, WaveSpec
from sim_core.environment.waves import (
    WaveField,
    jonswap,
    pierson_moskowitz,
    realise_waves,
    spreading_quantiles,
    wave_number,
)

HS_M, TP_S = 0.2, 2.5
PEAK = 2.0 * np.pi / TP_S
WATER = Water(depth_m=20.0)


def sea(spectrum: str, seed: int, **settings) -> WaveField:
    return realise_waves(WaveSpec(spectrum, HS_M, TP_S, 90.0, **settings), WATER, np.random.default_rng(seed))


@pytest.mark.parametrize("depth_m", [0.3, 2.0, 20.0])
def test_dispersion_in_finite_depth(depth_m: float) -> None:
    omegas = np.array([0.05, 0.3, 1.0, 2.5, 7.5, 15.0])
    roots = [brentq(lambda k, w=w: GRAVITY_MPS2 * k * np.tanh(k * depth_m) - w * w, 1e-9, 1e3) for w in omegas]
    np.testing.assert_allclose(wave_number(omegas, depth_m), roots, rtol=1e-10)


def test_dispersion_limits() -> None:
    omega = np.array([3.0])
    np.testing.assert_allclose(wave_number(omega, 1000.0), omega**2 / GRAVITY_MPS2, rtol=1e-12)
    np.testing.assert_allclose(wave_number(omega, 1e-4), omega / np.sqrt(GRAVITY_MPS2 * 1e-4), rtol=1e-3)


@pytest.mark.medium
@pytest.mark.parametrize("density", [pierson_moskowitz, jonswap])
def test_spectra_hold_the_energy_of_hs(density) -> None:
    energy = quad(lambda w: density(np.array([w]), HS_M, TP_S)[0], 0.3 * PEAK, 40.0 * PEAK, limit=400, points=[PEAK])[0]
    assert 4.0 * np.sqrt(energy) == pytest.approx(HS_M, rel=1e-3)


def test_spectra_peak_where_they_should() -> None:
    omega = np.linspace(0.5, 2.0, 3001) * PEAK
    for density in (pierson_moskowitz, jonswap):
        assert omega[np.argmax(density(omega, HS_M, TP_S))] == pytest.approx(PEAK, rel=2e-3)
    # At the peak gamma = 3.3 multiplies the shape; DNV's approximate normalisation is 1 - 0.287 ln(gamma).
    ratio = jonswap(np.array([PEAK]), HS_M, TP_S) / pierson_moskowitz(np.array([PEAK]), HS_M, TP_S)
    assert ratio[0] == pytest.approx(3.3 * (1.0 - 0.287 * np.log(3.3)), rel=0.02)
    np.testing.assert_allclose(jonswap(omega, HS_M, TP_S, 1.0), pierson_moskowitz(omega, HS_M, TP_S), rtol=2e-3)


@pytest.mark.parametrize("spectrum", ["pierson-moskowitz", "jonswap"])
def test_a_long_record_returns_hs(spectrum: str) -> None:
    """Three hours at one place; the harmonics have no common period, so cross terms fade as 1 / time."""
    time_s = np.arange(0.0, 10_800.0, 0.25)
    field = sea(spectrum, 4)
    elevation = np.cos(field.phase_rad - time_s[:, None] * field.omega_radps) @ field.amplitude_m
    assert 4.0 * elevation.std() == pytest.approx(HS_M, rel=0.01)
    assert abs(elevation.mean()) < 1e-3


@pytest.mark.medium
@pytest.mark.parametrize(("spectrum", "density"), [("pierson-moskowitz", pierson_moskowitz), ("jonswap", jonswap)])
def test_records_return_the_spectrum(spectrum: str, density) -> None:
    """Welch over 60 seas of ten minutes, against the nominal density in bands; random places in bands average out."""
    time_s = np.arange(0.0, 600.0, 0.25)
    estimates = []
    for seed in range(60):
        field = sea(spectrum, seed)
        elevation = np.cos(field.phase_rad - time_s[:, None] * field.omega_radps) @ field.amplitude_m
        frequency_hz, power = welch(elevation, fs=4.0, nperseg=480)
        estimates.append(power)
    omega, realised = 2.0 * np.pi * frequency_hz, np.mean(estimates, axis=0) / (2.0 * np.pi)
    for low, high in ((0.75, 0.95), (0.95, 1.1), (1.1, 1.4), (1.4, 1.8), (1.8, 2.4)):
        band = (omega >= low * PEAK) & (omega < high * PEAK)
        step = omega[1] - omega[0]
        nominal = quad(
            lambda w: density(np.array([w]), HS_M, TP_S)[0], omega[band][0] - step / 2, omega[band][-1] + step / 2
        )[0]
        # The energy beyond three peak frequencies (1.5 %) is put inside the band; Welch's window smears the peak.
        assert realised[band].sum() * step == pytest.approx(nominal, rel=0.12)


def test_phases_follow_the_seed() -> None:
    one, same, other = sea("jonswap", 1), sea("jonswap", 1), sea("jonswap", 2)
    place = np.array([3.0, 4.0])
    assert one.elevation_m(7.0, place) == same.elevation_m(7.0, place)
    assert abs(one.elevation_m(7.0, place) - other.elevation_m(7.0, place)) > 1e-4
    assert np.abs(np.exp(1j * one.phase_rad).mean()) < 0.5  # spread over the circle, not all alike


def test_derivatives_agree_with_finite_differences() -> None:
    field = sea("pierson-moskowitz", 5, spreading=4.0)
    rng = np.random.default_rng(0)
    h = 1e-4
    for place in rng.uniform(-300.0, 300.0, (5, 2)):
        time_s = rng.uniform(0.0, 500.0)
        slope = [
            (field.elevation_m(time_s, place + step) - field.elevation_m(time_s, place - step)) / (2 * h)
            for step in (np.array([h, 0.0]), np.array([0.0, h]))
        ]
        np.testing.assert_allclose(field.slope(time_s, place), slope, atol=1e-6)
        rise = (field.elevation_m(time_s + h, place) - field.elevation_m(time_s - h, place)) / (2 * h)
        orbital = field.orbital_velocity_ned_mps(time_s, place)
        assert -orbital[2] == pytest.approx(rise, abs=1e-6)
        later, earlier = (field.orbital_velocity_ned_mps(time_s + s, place)[:2] for s in (h, -h))
        # Linearised Euler equation at the surface: the water accelerates down the slope.
        np.testing.assert_allclose((later - earlier) / (2 * h), -GRAVITY_MPS2 * field.slope(time_s, place), atol=1e-5)


def test_orbital_velocity_in_shallow_water_has_the_coth() -> None:
    field = realise_waves(WaveSpec("regular", 0.2, 3.0, 0.0), Water(depth_m=1.0), np.random.default_rng(0))
    k, omega = field.wave_vector_radpm[0, 0], 2.0 * np.pi / 3.0
    crest = field.phase_rad[0] / omega
    orbital = field.orbital_velocity_ned_mps(crest, np.zeros(2))
    assert field.elevation_m(crest, np.zeros(2)) == pytest.approx(0.1)
    np.testing.assert_allclose(orbital, [0.1 * omega / np.tanh(k * 1.0), 0.0, 0.0], atol=1e-12)


def test_regular_wave_travels_toward_its_direction() -> None:
    field = realise_waves(WaveSpec("regular", 0.4, 2.0, 90.0), WATER, np.random.default_rng(3))
    celerity = np.pi / np.hypot(*field.wave_vector_radpm[0])
    here = field.elevation_m(1.0, np.array([0.0, 0.0]))
    assert field.elevation_m(3.5, np.array([9.0, 2.5 * celerity])) == pytest.approx(here)


@pytest.mark.parametrize(("current_deg", "along"), [(90.0, 1.0), (270.0, -1.0), (0.0, 0.0)])
def test_a_fixed_place_meets_waves_doppler_shifted_by_the_current(current_deg: float, along: float) -> None:
    """sigma + k U, by counting crests; the water itself goes on moving by sigma, and the dispersion holds for it."""
    spec = EnvironmentSpec(
        water=Water(depth_m=200.0),
        current=CurrentSpec(0.8, current_deg, deviation_mps=0.1),
        waves=WaveSpec("regular", 0.1, 2.0, 90.0),
    )
    environment = Environment.from_spec(spec, np.random.default_rng(3))
    time_s = np.arange(0.0, 120.0, 0.02)
    height = np.array([-environment.surface_ned_z_m(s, np.zeros(2)) for s in time_s]) + 0.01
    up = np.flatnonzero((height[:-1] < 0.0) & (height[1:] >= 0.0))
    met_radps = 2.0 * np.pi * (len(up) - 1) / (time_s[up[-1]] - time_s[up[0]])
    sigma = 2.0 * np.pi / 2.0
    assert met_radps == pytest.approx(sigma + along * 0.8 * sigma**2 / GRAVITY_MPS2, rel=1e-3)
    places = np.stack([np.zeros(400), np.linspace(0.0, 6.3, 400)], axis=1)
    rise_mps = environment.waves.orbital_velocity_ned_mps(5.0, places)[:, 2]
    assert np.abs(rise_mps).max() == pytest.approx(0.05 * sigma, rel=1e-3)


def test_spreading() -> None:
    """cos^2s(angle/2) has the mean cosine s / (s + 1) (Longuet-Higgins et al. 1963)."""
    for spreading in (1.0, 5.0, 25.0):
        angles = spreading_quantiles(spreading, 2000)
        assert np.cos(angles).mean() == pytest.approx(spreading / (spreading + 1.0), rel=1e-3)
        assert np.sin(angles).mean() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.medium
def test_spread_waves_run_toward_the_mean_direction() -> None:
    flux = np.zeros(2)
    for seed in range(100):
        field = realise_waves(WaveSpec("jonswap", HS_M, TP_S, 40.0, spreading=8.0), WATER, np.random.default_rng(seed))
        unit = field.wave_vector_radpm / np.linalg.norm(field.wave_vector_radpm, axis=1, keepdims=True)
        flux += (field.amplitude_m**2 @ unit) / (field.amplitude_m**2).sum() / 100
    # One sea's direction scatters by about 27 deg / sqrt(10 energetic components), a hundred by a tenth of that.
    assert np.degrees(np.arctan2(flux[1], flux[0])) == pytest.approx(40.0, abs=3.0)
    assert np.hypot(*flux) == pytest.approx(8.0 / 9.0, abs=0.02)


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"spectrum": "bretschneider"}, "bretschneider.*use none, regular, pierson-moskowitz or jonswap"),
        ({"significant_height_m": -0.1}, "significant_height_m = -0.1"),
        ({"components": 3}, "components = 3 is too few"),
        ({"spreading": -1.0}, "spreading = -1.0"),
        ({"gamma": 0.5}, "gamma = 0.5"),
    ],
)
def test_impossible_seas_are_refused(settings: dict, problem: str) -> None:
    good = {"spectrum": "jonswap", "significant_height_m": 0.2, "peak_period_s": 2.5, "direction_deg": 0.0}
    with pytest.raises(ValueError, match=problem):
        WaveSpec(**{**good, **settings})
