"""Mean drift in waves: never against them, by the size that Maruo's formula and Stokes' drift give it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import i1, k1
from vessels import BARE, FULL, froude_scaled

from sim_core.environment.environment import Environment
from sim_core.environment.spec import GRAVITY_MPS2, Water, WaveSpec
from sim_core.environment.waves import HullSurface, WaveField, realise_waves
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.mean_drift import MeanDrift, barrier_reflection, wall_m
from sim_core.vessel.spec import Damping, DemiHull, HullSection, VesselSpec

DENSITY = 997.8
WATER = Water(density_kgpm3=DENSITY, level_m=0.0, depth_m=200.0)
HEADINGS_DEG = (0.0, 45.0, 90.0, 135.0, 180.0)
CALM_AIR = replace(FULL, wind=BARE.wind)


def regular(period_s: float, height_m: float) -> WaveField:
    waves = realise_waves(WaveSpec("regular", height_m, period_s), WATER, np.random.default_rng(0))
    assert isinstance(waves, WaveField)
    return waves


def wave_number(period_s: float) -> float:
    return (2.0 * np.pi / period_s) ** 2 / GRAVITY_MPS2


def drift_mps(model: VesselSpec, waves: WaveField, headings_deg: tuple[float, ...], seconds: float) -> np.ndarray:
    """(N, 2) mean velocity of free vessels over the later two thirds of a run."""
    simulation = Simulation.from_spec(model, Environment(water=WATER, waves=waves), 0.01)
    rng = np.random.default_rng(0)
    state = initial(simulation, np.zeros((len(headings_deg), 2)), np.radians(headings_deg), rng)
    steps = round(seconds / 0.01)
    for number in range(steps):
        if number == steps // 3:
            start = state.vessel.motion.pos_ned_m[:, :2]
        state = step(simulation, state, np.zeros((1, 2)), rng)
    velocity: np.ndarray = (state.vessel.motion.pos_ned_m[:, :2] - start) / ((steps - steps // 3) * 0.01)
    return velocity


def test_reflection_is_that_of_a_barrier() -> None:
    k = np.geomspace(0.01, 60.0, 30)
    ursell = np.pi**2 * i1(0.1 * k) ** 2 / (np.pi**2 * i1(0.1 * k) ** 2 + k1(0.1 * k) ** 2)
    np.testing.assert_allclose(barrier_reflection(k, 0.1), ursell, rtol=1e-9)


def test_a_waterline_is_worth_its_projected_walls() -> None:
    """A wall across the waves counts whole, by the square of the sine otherwise; a round one 2/3 of its width."""
    box = DemiHull(length_m=3.0, keel_frd_m=(0.0, 0.0, 0.2), section=HullSection(width_m=0.4, depth_m=0.5))
    turn = np.radians([0.0, 90.0, 180.0, 30.0])
    walls = [[0.4, 0.0], [0.0, 3.0], [-0.4, 0.0], [0.4 * 0.75, 3.0 * 0.25]]
    np.testing.assert_allclose(wall_m(box, 0.4, turn), walls, atol=1e-12)
    angle = np.linspace(-np.pi / 2.0, np.pi / 2.0, 50)
    taper = tuple(zip((0.5 * np.sin(angle)).tolist(), np.cos(angle).tolist(), strict=True))
    taper = ((-0.5, 0.0), *taper[1:-1], (0.5, 0.0))
    disc = DemiHull(
        length_m=2.0, keel_frd_m=(0.0, 0.0, 0.2), section=HullSection(width_m=2.0, depth_m=0.5), taper=taper
    )
    np.testing.assert_allclose(np.hypot(*wall_m(disc, 2.0, turn).T), 4.0 / 3.0, rtol=0.003)


@pytest.mark.parametrize(("heading_deg", "component"), [(180.0, 0), (90.0, 1)])
def test_a_hull_held_fast_throws_short_waves_back_as_maruo_has_it(heading_deg: float, component: int) -> None:
    """rho g a_R^2 / 2 a metre of wall, in the mean over a wave; without damping nothing else."""
    period_s, height_m = 0.8, 0.03
    waves = regular(period_s, height_m)
    model = replace(CALM_AIR, damping_linear=Damping(), damping_quadratic=Damping())
    simulation = Simulation.from_spec(model, Environment(water=WATER, waves=waves), 0.0025)
    drift = simulation.vessel.wave_forces.drift
    assert isinstance(drift, MeanDrift)
    motion = initial(simulation, np.zeros((1, 2)), np.radians([heading_deg]), np.random.default_rng(0)).vessel.motion
    force = np.mean([fixed_force(simulation, motion, time_s) for time_s in np.arange(40) * period_s / 40], axis=0)
    k, draft_m = wave_number(period_s), simulation.vessel.rest.draft_m
    width_m = 2.0 * np.sqrt(draft_m * (0.4 - draft_m))
    share = barrier_reflection(np.array([k]), draft_m)[0]
    wall = (share * 2.0 * width_m, (1.0 - (1.0 - share) ** 2) * 2.3)[component]
    maruo = 0.5 * DENSITY * GRAVITY_MPS2 * (0.5 * height_m) ** 2 * wall
    along = force @ [np.cos(np.radians(heading_deg)), -np.sin(np.radians(heading_deg))]
    assert along == pytest.approx(maruo, rel=0.02)
    assert abs(force[1 - component]) < 1e-6 * maruo


@pytest.mark.medium
@pytest.mark.parametrize("speed_mps", [-1.5, -0.5, 0.4, 2.0])
def test_under_way_the_force_goes_by_the_frequency_of_encounter(speed_mps: float) -> None:
    """Radiated P k / (sigma - k V), no more than at rest; thrown back times 1 - 2 k V / sigma, and not against."""
    period_s = 0.9
    environment = Environment(water=WATER, waves=regular(period_s, 0.03))
    simulation = Simulation.from_spec(FULL, environment, 0.0025)
    smooth = replace(FULL, damping_linear=Damping(), damping_quadratic=Damping())
    drifts = [Simulation.from_spec(model, environment, 0.0025).vessel.wave_forces.drift for model in (FULL, smooth)]
    rest = initial(simulation, np.zeros((1, 2)), np.zeros(1), np.random.default_rng(0)).vessel.motion
    slowness = wave_number(period_s) * period_s / (2.0 * np.pi)

    def ahead_n(along_mps: float, heave_mps: float, elevation_m: float) -> float:
        drift = drifts[not heave_mps]  # the smooth vessel takes no power
        motion = replace(rest, vel_ned_mps=np.array([[along_mps, 0.0, heave_mps]]))
        surface = HullSurface(np.full((1, 12), elevation_m), np.zeros((1, 15)))
        return float(drift.force_frd_n(motion, np.zeros((1, 3)), surface)[0, 0])

    power_w = FULL.damping_linear.heave * 0.1**2 + FULL.damping_quadratic.heave * 0.1**3
    radiated = power_w * slowness / max(1.0 - slowness * speed_mps, 1.0)
    assert ahead_n(speed_mps, 0.1, 0.0) == pytest.approx(radiated, rel=1e-9)
    thrown = ahead_n(0.0, 0.0, 0.02) * max(1.0 - 2.0 * slowness * speed_mps, 0.0)
    assert ahead_n(speed_mps, 0.0, 0.02) == pytest.approx(thrown, rel=1e-9, abs=1e-12)


def fixed_force(simulation: Simulation, motion: Kinematics, time_s: float) -> np.ndarray:
    surface = simulation.hull_waves.sample(time_s, motion.pos_ned_m, motion.rot_ned_frd)
    still = motion.vel_ned_mps
    force: np.ndarray = simulation.vessel.wave_forces.drift.force_frd_n(motion, still, surface)[0]
    return force


@pytest.mark.medium
@pytest.mark.parametrize(
    ("scale", "period_s"), [(1.0, 0.6), (1.0, 0.9), (1.0, 1.3), (1.0, 2.0), (1.0, 4.0), (1 / 3, 0.6), (1 / 3, 1.0)]
)
def test_a_free_vessel_drifts_with_regular_waves(scale: float, period_s: float) -> None:
    """On all headings and up to H / lambda = 0.05, at no less than a quarter of Stokes' drift over the draft.

    It goes ahead more easily than aside, so off the waves' direction as well, up to the 45 degrees of its own heading.
    """
    length_m = 2.0 * np.pi / wave_number(period_s)
    for steepness in (0.02, 0.05):
        waves = regular(period_s, steepness * length_m)
        drift = drift_mps(froude_scaled(CALM_AIR, scale), waves, HEADINGS_DEG, 30.0)
        shear = waves.shear_drift_ne_mps(0.1 * scale)[0]
        assert (drift[:, 0] > 0.5 * shear).all(), (steepness, drift[:, 0], shear)
        assert (np.abs(drift[:, 1]) < drift[:, 0]).all()


@pytest.mark.medium
def test_the_drift_is_the_speed_at_which_drag_balances_the_waves() -> None:
    """Head and beam seas of T = 0.9 s, H = 4 cm, where a vessel once went 0.11 m/s against the waves.

    The force of the reflected waves over linear drag, with the drift of the water. Within a factor of 1.5: left out are
    the 5 % that a hull under way reflects less, and 0.05 N that products of first-order forces leave.
    """
    period_s, amplitude_m = 0.9, 0.02
    model = replace(CALM_AIR, damping_quadratic=Damping())
    waves = regular(period_s, 2.0 * amplitude_m)
    k, draft_m = wave_number(period_s), 0.1
    width_m = 2.0 * np.sqrt(draft_m * (0.4 - draft_m))
    share = barrier_reflection(np.array([k]), draft_m)[0]
    walls_m = share * 2.0 * width_m, (1.0 - (1.0 - share) ** 2) * 2.3
    for heading_deg, wall_m_, drag in ((180.0, walls_m[0], 15.0), (90.0, walls_m[1], 250.0)):
        force = 0.5 * DENSITY * GRAVITY_MPS2 * amplitude_m**2 * wall_m_
        expected = force / drag + waves.shear_drift_ne_mps(draft_m)[0]
        got = drift_mps(model, waves, (heading_deg,), 120.0)[0, 0]
        assert expected / 1.5 < got < expected * 1.5, (heading_deg, got, expected)


@pytest.mark.slow
def test_a_free_vessel_drifts_with_spread_seas() -> None:
    """Twenty seas that were not looked at, five headings each: along the mean direction all the time."""
    along = []
    for seed in range(2000, 2020):
        spec = WaveSpec("jonswap", 0.12, 1.6, 0.0, spreading=6.0)
        waves = realise_waves(spec, WATER, np.random.default_rng(seed))
        assert isinstance(waves, WaveField)
        along.append(drift_mps(CALM_AIR, waves, HEADINGS_DEG, 40.0)[:, 0])
    assert np.min(along) > 0.0
    assert np.median(along) == pytest.approx(np.mean(along), rel=0.3)
