"""The fast pass over all strips against the plain sum of cosines; vessels riding waves."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from vessels import BARE, FULL

from sim_core.environment.environment import Environment
from sim_core.environment.spec import GRAVITY_MPS2, Water, WaveSpec
from sim_core.environment.waves import FlatWater, HullSurface, ladder, realise_waves
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.buoyancy import make_buoyancy
from sim_core.vessel.spec import Damping

POINTS = make_buoyancy(FULL, Water()).points_frd_m
HS_M = 0.25
FIELD = realise_waves(WaveSpec("jonswap", HS_M, 2.2, 35.0, spreading=6.0), Water(depth_m=5.0), np.random.default_rng(8))
TIME_S = 1234.5
RNG = np.random.default_rng(9)
POS = RNG.uniform(-2000.0, 2000.0, (40, 3))
ROT = Rotation.from_euler("ZYX", RNG.uniform(-1.0, 1.0, (40, 3)) * [3.1, 0.3, 0.3]).as_matrix()
SURFACE = FIELD.at_hull(POINTS).sample(TIME_S, POS, ROT)
PLACES = (POS[:, None, :] + POINTS @ ROT.transpose(0, 2, 1))[:, :, :2]

# Rounding: 2^-52 of a phase of up to 1e4 rad at these places and times, on amplitudes that add to about 3 Hs.
TOLERANCE = 1e-11 * HS_M


def test_equal_steps_between_points_need_the_cosines_of_one_step() -> None:
    rungs, steps_m = ladder(POINTS)
    assert len(rungs[0].points) + len(steps_m) == 3  # one end of each of the two hulls, and the step along a hull
    assert sorted(point for rung in rungs for point in rung.points) == list(range(12))
    for before, rung in pairwise(rungs):
        places_m = POINTS[[before.points[base] for base in rung.bases]] + steps_m[rung.steps]
        np.testing.assert_allclose(POINTS[rung.points], places_m, atol=1e-12)


def test_points_without_equal_steps_each_need_their_cosines() -> None:
    rungs, steps_m = ladder(np.random.default_rng(1).uniform(-1.0, 1.0, (12, 3)))
    assert [rung.points for rung in rungs] == [list(range(12))]
    assert not len(steps_m)


def test_elevation_at_the_strips_is_the_sum_of_cosines() -> None:
    np.testing.assert_allclose(SURFACE.point_elevation_m, FIELD.elevation_m(TIME_S, PLACES), atol=TOLERANCE)


def test_slope_is_the_plane_through_the_strips() -> None:
    elevation = FIELD.elevation_m(TIME_S, PLACES)
    matrix = np.column_stack([np.ones(12), POINTS[:, :2]])
    slopes = np.linalg.lstsq(matrix, elevation.T, rcond=None)[0][1:].T
    np.testing.assert_allclose(SURFACE.slope_frd[:, :2], slopes, atol=3 * TOLERANCE)
    assert not SURFACE.slope_frd[:, 2].any()


def test_slope_of_a_long_wave_is_its_gradient_in_the_body() -> None:
    field = realise_waves(WaveSpec("regular", 0.5, 8.0, 70.0), Water(depth_m=50.0), RNG)
    heading = Rotation.from_euler("Z", RNG.uniform(-3.0, 3.0, (40, 1))).as_matrix()
    surface = field.at_hull(POINTS).sample(3.0, POS, heading)
    gradient = field.slope(3.0, POS[:, :2])
    in_body = np.einsum("ni,nij->nj", gradient, heading[:, :2, :2])
    # 100 m long: over a hull of 2.3 m the gradient bends by (k L)^2 / 24 = 0.1 %.
    np.testing.assert_allclose(surface.slope_frd[:, :2], in_body, atol=0.002 * np.abs(gradient).max() + 1e-6)


def test_velocity_gradient_and_rise_are_means_over_the_hull() -> None:
    orbital = FIELD.orbital_velocity_ned_mps(TIME_S, PLACES).mean(axis=1)
    np.testing.assert_allclose(SURFACE.orbital_ned_mps, orbital, atol=10 * TOLERANCE)
    gradient = FIELD.slope(TIME_S, PLACES).mean(axis=1)
    np.testing.assert_allclose(SURFACE.gradient_ned[:, :2], gradient, atol=10 * TOLERANCE)
    h = 1e-3
    above, here, below = (FIELD.elevation_m(TIME_S + s, PLACES).mean(axis=1) for s in (h, 0.0, -h))
    np.testing.assert_allclose(SURFACE.rise_mps2[:, 0], (above - 2 * here + below) / h**2, atol=1e-4)


def test_the_surface_turns_as_the_plane_through_the_strips() -> None:
    """Where the fitted plane rises forward it pitches up; where it rises to the right it rolls to the left."""
    matrix = np.column_stack([np.ones(12), POINTS[:, :2]])
    h = 1e-3
    slopes = [
        np.linalg.lstsq(matrix, FIELD.elevation_m(TIME_S + s, PLACES).T, rcond=None)[0][1:].T for s in (h, 0.0, -h)
    ]
    rate, acceleration = (slopes[0] - slopes[2]) / (2 * h), (slopes[0] - 2 * slopes[1] + slopes[2]) / h**2
    sign = np.array([-1.0, 1.0])
    np.testing.assert_allclose(SURFACE.turn_frd_radps[:, :2], sign * rate[:, ::-1], atol=1e-4)
    np.testing.assert_allclose(SURFACE.turn_radps2, sign * acceleration[:, ::-1], atol=1e-3)
    assert not SURFACE.turn_frd_radps[:, 2].any()


def test_a_batch_larger_than_a_block_is_sampled_alike() -> None:
    many = FIELD.at_hull(POINTS).sample(TIME_S, np.tile(POS, (8, 1)), np.tile(ROT, (8, 1, 1)))
    for name in ("point_elevation_m", "over_hull"):
        np.testing.assert_allclose(getattr(many, name)[280:], getattr(SURFACE, name), atol=20 * TOLERANCE)


def test_a_current_carries_the_pattern() -> None:
    """What a place sees is what it saw where the water came from; a fixed place meets omega + k . U."""
    current = np.array([0.4, -0.7])
    carried = replace(FIELD, current_ne_mps=current)
    np.testing.assert_allclose(
        carried.elevation_m(TIME_S, PLACES + TIME_S * current), FIELD.elevation_m(TIME_S, PLACES), atol=1e-9
    )
    surface = carried.at_hull(POINTS).sample(TIME_S, POS + TIME_S * np.append(current, 0.0), ROT)
    for field in fields(HullSurface):
        np.testing.assert_allclose(getattr(surface, field.name), getattr(SURFACE, field.name), atol=20 * TOLERANCE)
    np.testing.assert_allclose(
        carried.apparent_omega_radps - FIELD.omega_radps, FIELD.wave_vector_radpm @ current, rtol=1e-12
    )


def test_stokes_drift_is_half_the_shear_and_half_the_way_to_and_fro() -> None:
    """omega k a^2 at the surface of deep water (Stokes 1847): 0.137 m/s for 0.5 m in 4 s, less over a draft."""
    field = realise_waves(WaveSpec("regular", 0.5, 4.0, 90.0), Water(depth_m=200.0), RNG)
    omega = 2.0 * np.pi / 4.0
    stokes = omega * (omega**2 / GRAVITY_MPS2) * 0.25**2
    np.testing.assert_allclose(field.shear_drift_ne_mps(0.0), [0.0, 0.5 * stokes], atol=1e-9)
    wave_number = omega**2 / GRAVITY_MPS2
    over_draft = quad(lambda z: np.exp(2.0 * wave_number * z), -0.8, 0.0)[0] / 0.8
    np.testing.assert_allclose(field.shear_drift_ne_mps(0.8), [0.0, 0.5 * stokes * over_draft], rtol=1e-6, atol=1e-9)


def test_flat_water_is_flat() -> None:
    surface = FlatWater().at_hull(POINTS).sample(TIME_S, POS, ROT)
    assert surface.point_elevation_m.shape == (40, 12)
    assert not surface.point_elevation_m.any()
    assert not surface.over_hull.any()
    assert not FlatWater().elevation_m(1.0, PLACES).any()


@pytest.mark.medium
@pytest.mark.parametrize("heading_rad", [0.0, 0.7, np.pi / 2])
def test_in_a_long_wave_the_vessel_moves_with_the_water(heading_rad: float) -> None:
    """A frictionless hull without wind is a particle of the water, (k L)^2 and (omega / omega_heave)^2 apart."""
    water = Water(depth_m=200.0)
    field = realise_waves(WaveSpec("regular", 0.3, 12.0, 0.0), water, np.random.default_rng(1))
    model = replace(FULL, wind=BARE.wind, damping_linear=Damping(30, 250, 500, 50, 50, 150))
    simulation = Simulation.from_spec(model, Environment(water=water, waves=field), 0.01)
    rng = np.random.default_rng(0)
    state = initial(simulation, np.zeros((1, 2)), np.array([heading_rad]), rng)
    start_z = state.vessel.motion.pos_ned_m[0, 2]
    height, orbital, motion = [], [], []
    for i in range(9600):
        state = step(simulation, state, np.zeros((1, 2)), rng)
        if i >= 8400:  # the last wave of eight, when the start has faded
            at = state.vessel.motion
            height.append(start_z - at.pos_ned_m[0, 2] - field.elevation_m(state.time_ns * 1e-9, at.pos_ned_m[0, :2]))
            orbital.append(field.orbital_velocity_ned_mps(state.time_ns * 1e-9, at.pos_ned_m[0, :2])[0])
            motion.append(at.vel_ned_mps[0, 0])
    assert np.abs(height).max() < 0.01 * 0.15
    np.testing.assert_allclose(motion, orbital, atol=0.06 * np.max(orbital))
