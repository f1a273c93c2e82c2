"""Waves at a wall, against standing waves in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water, WaveSpec, WaveWall
from sim_core.environment.waves import WaveField, realise_waves
from sim_core.frames import Array
from sim_core.simulation import Simulation, initial, step
from xitl_cli.profile import load_profile

WATER = Water(level_m=0.0, depth_m=50.0)
HEADING_DEG = 36.87
WALL = WaveWall(through_ne_m=(30.0, -20.0), heading_deg=HEADING_DEG, reflection=1.0)
ALONG = np.array([math.cos(math.radians(HEADING_DEG)), math.sin(math.radians(HEADING_DEG))])
INTO = np.array([-ALONG[1], ALONG[0]])
TIMES_S = np.arange(0.0, 100.0, 0.0473)  # falls on all phases of the waves


def sea(spec: WaveSpec, current_ne_mps: tuple[float, float] = (0.0, 0.0)) -> WaveField:
    made = realise_waves(spec, WATER, np.random.default_rng(3), current_ne_mps)
    assert isinstance(made, WaveField)
    return made


def before_the_wall(off_m: float, along_m: float = 0.0) -> Array:
    place: Array = np.array(WALL.through_ne_m) + along_m * ALONG - off_m * INTO
    return place


def height_m(waves: WaveField, place: Array) -> float:
    return float(np.ptp([waves.elevation_m(float(time_s), place) for time_s in TIMES_S]))


def towards_the_wall(reflection: float) -> WaveSpec:
    return WaveSpec("regular", 0.2, 2.0, direction_deg=HEADING_DEG + 90.0, wall=replace(WALL, reflection=reflection))


def test_a_wall_that_reflects_all_lets_no_water_through() -> None:
    spec = WaveSpec("jonswap", 0.3, 2.5, direction_deg=HEADING_DEG + 70.0, spreading=20.0, wall=WALL)
    waves = sea(spec, (0.4, 0.1))
    for along_m in (-70.0, 0.0, 45.0):
        place = before_the_wall(0.0, along_m)
        meets = waves.wave_vector_radpm @ INTO != 0.0
        assert meets.all()
        for time_s in (0.0, 3.3, 400.0):
            through = waves.orbital_velocity_ned_mps(time_s, place)[:2] @ INTO
            assert through == pytest.approx(leaving(spec, time_s, place), abs=1e-9)


def leaving(spec: WaveSpec, time_s: float, place: Array) -> float:
    """Speed through the wall of the components that come from it, which have no image."""
    waves = sea(replace(spec, wall=None), (0.4, 0.1))
    away = waves.wave_vector_radpm @ INTO <= 0.0
    alone = WaveField(
        waves.amplitude_m[away],
        waves.omega_radps[away],
        waves.wave_vector_radpm[away],
        waves.phase_rad[away],
        waves.current_ne_mps,
    )
    return float(alone.orbital_velocity_ned_mps(time_s, place)[:2] @ INTO)


@pytest.mark.parametrize("reflection", [1.0, 0.5])
def test_a_standing_wave_has_its_nodes_a_quarter_of_a_wave_off(reflection: float) -> None:
    waves = sea(towards_the_wall(reflection))
    wavelength_m = 2.0 * math.pi / float(np.hypot(*waves.wave_vector_radpm[0]))
    for quarters, expected in (
        (0, 1.0 + reflection),
        (1, 1.0 - reflection),
        (2, 1.0 + reflection),
        (3, 1.0 - reflection),
    ):
        seen = height_m(waves, before_the_wall(0.25 * quarters * wavelength_m, along_m=13.0))
        assert seen == pytest.approx(0.2 * expected, abs=2e-4)


def test_images_keep_the_frequency_in_a_current() -> None:
    spec = towards_the_wall(0.9)
    waves = sea(spec, (0.5, -0.3))
    place = before_the_wall(0.0, along_m=7.0)
    for carried in (waves, waves.carried_on(np.array([-0.2, 0.6]), 55.0)):
        apparent = carried.apparent_omega_radps
        assert apparent[1] == pytest.approx(apparent[0], rel=1e-12)
    assert carried.elevation_m(55.0, place) == pytest.approx(waves.elevation_m(55.0, place), abs=1e-12)


def test_waves_that_leave_the_wall_are_as_without_it() -> None:
    spec = WaveSpec("jonswap", 0.3, 2.5, direction_deg=HEADING_DEG - 90.0)
    alone, behind = sea(spec), sea(replace(spec, wall=WALL))
    for name in ("amplitude_m", "omega_radps", "wave_vector_radpm", "phase_rad"):
        assert getattr(alone, name).tobytes() == getattr(behind, name).tobytes()


@pytest.mark.medium
def test_a_boat_heaves_at_the_wall_and_hardly_at_the_first_node() -> None:
    model = load_profile("sitl").vehicle
    assert model is not None
    spec = replace(towards_the_wall(1.0), significant_height_m=0.02, peak_period_s=4.0)
    waves = sea(spec)
    quarter_m = 0.5 * math.pi / float(np.hypot(*waves.wave_vector_radpm[0]))
    simulation = Simulation.from_spec(model, Environment(water=WATER, waves=waves), 0.01)
    rng = np.random.default_rng(0)
    places = np.stack([before_the_wall(0.0), before_the_wall(quarter_m)])
    state = initial(simulation, places, np.full(2, math.radians(HEADING_DEG)), rng)
    depths_m = []
    for _ in range(400):
        state = step(simulation, state, np.zeros((1, 2)), rng, 5)
        depths_m.append(state.vessel.motion.pos_ned_m[:, 2])
    at_wall_m, at_node_m = np.ptp(depths_m[100:], axis=0)
    assert at_wall_m == pytest.approx(0.04, rel=0.06)
    assert at_node_m < 0.1 * at_wall_m
