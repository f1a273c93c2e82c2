"""How an open-loop course depends on its start: exact in still water, in proportion over seconds, lost over a minute.

The wave forces are held against linear equations of surge, sway and yaw with the excitation of the panel code.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water, WaveSpec
from sim_core.environment.waves import FLAT_WATER, StillHull, WaveField, realise_waves
from sim_core.frames import Array, matrix_to_euler
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.panel_tables import panel_tables_of, smooth_at_frequencies
from sim_core.vessel.vessel import Surroundings, Vessel, accelerate, at_rest
from xitl_cli.profile import load_profile

KICK_RAD = 1e-4
HEADINGS_RAD = np.radians(np.arange(17.0, 360.0, 45.0))
SPEED_MPS, THROTTLE = 3.0, 0.714
DT_S, SECONDS = 0.005, 40
WATER = Water(level_m=0.0)
SEA = WaveSpec("jonswap", 0.2, 2.5, direction_deg=110.0, spreading=10.0)
HORIZONTAL = [0, 1, 5]


def boat() -> Vessel:
    model = load_profile("sitl").vehicle
    assert model is not None
    return Vessel.from_spec(model, WATER, DT_S)


def sea() -> WaveField:
    waves = realise_waves(SEA, WATER, np.random.default_rng(1))
    assert isinstance(waves, WaveField)
    return waves


def sailed(vessel: Vessel, height_m: float, kick_rad: float, seconds: int = SECONDS) -> Array:
    """(seconds, N) differences in heading of two boats on each heading, one of them turned at the start."""
    waves = realise_waves(replace(SEA, significant_height_m=height_m), WATER, np.random.default_rng(1))
    simulation = Simulation.from_spec(vessel.model, Environment(water=WATER, waves=waves), DT_S)
    rng, boats = np.random.default_rng(0), len(HEADINGS_RAD)
    state = initial(simulation, np.zeros((2 * boats, 2)), np.concatenate([HEADINGS_RAD, HEADINGS_RAD + kick_rad]), rng)
    command, seen = np.full((1, 2), THROTTLE), []
    for _ in range(seconds):
        state = step(simulation, state, command, rng, round(1.0 / DT_S))
        yaw = matrix_to_euler(state.vessel.motion.rot_ned_frd)[:, 2]
        seen.append(np.sin(yaw[boats:] - yaw[:boats]))
    return np.array(seen)


def still_water_derivatives(vessel: Vessel) -> Array:
    """(3, 3) accelerations of surge, sway and yaw per change of their speeds, at SPEED_MPS."""
    still = vessel.in_waves(FLAT_WATER, WATER)
    change = 1e-4 * np.concatenate([np.eye(3), -np.eye(3)])
    motion = at_rest(still, np.zeros((6, 2)), np.zeros(6)).motion
    zero = np.zeros((6, 3))
    velocity, gyro = zero.copy(), zero.copy()
    velocity[:, :2] = change[:, :2] + [SPEED_MPS, 0.0]
    gyro[:, 2] = change[:, 2]
    surface = StillHull(len(still.buoyancy.points_frd_m)).sample(0.0, motion.pos_ned_m, motion.rot_ned_frd)
    moved = replace(motion, vel_ned_mps=velocity, gyro_frd_radps=gyro)
    around = Surroundings(zero, velocity, surface, np.zeros((6, 2)))  # air that moves along: no wind
    acceleration = accelerate(still, moved, np.full((6, 2), THROTTLE), around)[:, HORIZONTAL]
    derivatives: Array = (acceleration[:3] - acceleration[3:]).T / 2e-4
    derivatives[1, 2] -= SPEED_MPS  # of the speed across, in axes that turn
    return derivatives


def of_linear_equations(vessel: Vessel, waves: WaveField) -> Array:
    """The same differences by equations of three motions, with the excitation of the panel code at the boat's place."""
    tables = panel_tables_of(vessel.model, vessel.rest.depth_m)
    assert tables is not None
    force = smooth_at_frequencies(waves.omega_radps, tables.omega_radps, tables.excitation)[:, :, HORIZONTAL]
    count = len(tables.direction_rad)
    harmonics = np.fft.fftfreq(count) * count
    series = np.fft.fft(force * waves.amplitude_m[:, None, None], axis=1) / count
    mass = (vessel.hydrodynamics.rigid_mass + vessel.hydrodynamics.added_mass)[np.ix_(HORIZONTAL, HORIZONTAL)]
    series = series @ np.linalg.inv(mass).T
    course = np.arctan2(waves.wave_vector_radpm[:, 1], waves.wave_vector_radpm[:, 0])
    derivatives, boats = still_water_derivatives(vessel), len(HEADINGS_RAD)
    turned = np.exp(1j * course[:, None] * harmonics)[:, :, None] * series

    def rate(time_s: float, state: Array) -> Array:
        place, yaw, speeds = state[:, :2], state[:, 2], state[:, 3:]
        wave = np.exp(1j * waves.phase_at(time_s, place))
        head = np.exp(-1j * yaw[:, None] * harmonics)
        by_waves = np.einsum("nm,nmi->ni", head, np.einsum("nw,wmi->nmi", wave, turned)).real
        ahead, across = SPEED_MPS + speeds[:, 0], speeds[:, 1]
        way = np.column_stack(
            [ahead * np.cos(yaw) - across * np.sin(yaw), ahead * np.sin(yaw) + across * np.cos(yaw), speeds[:, 2]]
        )
        return np.concatenate([way, speeds @ derivatives.T + by_waves], axis=1)

    state = np.zeros((2 * boats, 6))
    state[:, 2] = np.concatenate([HEADINGS_RAD, HEADINGS_RAD + KICK_RAD])
    dt_s, seen = 0.025, []
    for number in range(round(SECONDS / dt_s)):
        middle = state + 0.5 * dt_s * rate(number * dt_s, state)
        state = state + dt_s * rate((number + 0.5) * dt_s, middle)
        if (number + 1) % round(1.0 / dt_s) == 0:
            seen.append(state[boats:, 2] - state[:boats, 2])
    return np.array(seen)


@pytest.mark.medium
def test_a_turn_at_the_start_stays_as_it_is_in_still_water() -> None:
    kept = sailed(boat(), 0.0, KICK_RAD)
    assert kept[-1] == pytest.approx(np.full(len(HEADINGS_RAD), KICK_RAD), rel=1e-3)


@pytest.mark.medium
def test_over_seconds_a_change_of_the_start_changes_a_course_in_waves_in_proportion() -> None:
    vessel = boat()
    small, large = (sailed(vessel, 0.2, kick_rad, 5) for kick_rad in (KICK_RAD, 10.0 * KICK_RAD))
    assert np.abs(large - 10.0 * small).max() < 0.02 * np.abs(large).max()


@pytest.mark.medium
def test_over_a_minute_waves_carry_open_loop_courses_apart_as_the_excitation_of_the_panel_code_does() -> None:
    vessel = boat()
    apart, linear = (
        np.log(np.abs(each)[-10:].max(axis=0) / KICK_RAD)
        for each in (sailed(vessel, 0.2, KICK_RAD), of_linear_equations(vessel, sea()))
    )
    assert linear.max() > 4.0  # fifty times as far apart
    assert apart.mean() < linear.mean() + 0.5
    assert set(np.argsort(apart)[-2:]) == set(np.argsort(linear)[-2:])  # on the same headings
