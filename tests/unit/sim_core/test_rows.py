"""Rows of a batch: vessels that restart while others continue."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from numpy.random import default_rng
from vessels import FULL

from sim_core import simulation as simulations
from sim_core.environment.current import make_current
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, DiscreteGust, GustSpec, WaveSpec, WindSpec
from sim_core.environment.waves import realise_waves
from sim_core.environment.wind import make_wind
from sim_core.frames import Array
from sim_core.rows import row_of, with_rows
from sim_core.simulation import Simulation, SimulationState

GUST = DiscreteGust(start_s=0.2, rise_s=0.1, hold_s=0.2, fall_s=0.1, speed_mps=6.0)
COMMAND = np.array([[0.6, 0.2], [0.1, 0.4], [-0.2, 0.3]])


@dataclass(frozen=True)
class Inner:
    values: Array
    text: str = "now"


@dataclass(frozen=True)
class Outer:
    inner: Inner
    matrix: Array
    nothing: Array | None = None
    time_ns: int = 0


def test_only_arrays_of_the_rows_change() -> None:
    now = Outer(Inner(np.zeros(4)), np.zeros((4, 2)), None, 7)
    fresh = Outer(Inner(np.array([1.0, 2.0]), "fresh"), np.array([[1.0, 2.0], [3.0, 4.0]]), np.ones(2), 9)
    mixed = with_rows(now, [3, 1], fresh)
    assert mixed.inner.values.tolist() == [0.0, 2.0, 0.0, 1.0]
    assert mixed.matrix.tolist() == [[0.0, 0.0], [3.0, 4.0], [0.0, 0.0], [1.0, 2.0]]
    assert (mixed.inner.text, mixed.nothing, mixed.time_ns) == ("now", None, 7)
    assert now.matrix.sum() == 0.0


def world(waves: bool = True, gusts: tuple[DiscreteGust, ...] = ()) -> Simulation:
    environment = Environment(
        current=make_current(CurrentSpec(0.5, 90.0, deviation_mps=0.1, correlation_s=20.0)),
        wind=make_wind(WindSpec(5.0, 200.0, gust=GustSpec("ornstein-uhlenbeck", 1.5, 8.0), discrete_gusts=gusts)),
    )
    if waves:
        sea = realise_waves(WaveSpec("jonswap", 0.3, 2.5, 90.0), environment.water, default_rng(3))
        environment = replace(environment, waves=sea)
    return Simulation.from_spec(FULL, environment, 0.0025)


def started(simulation: Simulation) -> SimulationState:
    places = np.array([[0.0, 0.0], [20.0, 5.0], [-30.0, 8.0]])
    return simulations.initial(simulation, places, np.array([0.0, 1.0, -2.0]), default_rng(1))


def advanced(simulation: Simulation, state: SimulationState, steps: int, seed: int = 2) -> SimulationState:
    rng = default_rng(seed)
    for _ in range(steps):
        state = simulations.step(simulation, state, COMMAND, rng)
    return state


def arrays(state: SimulationState) -> list[Array]:
    vessel, environment = state.vessel, state.environment
    motion = [getattr(vessel.motion, field.name) for field in fields(vessel.motion)]
    held = [state.current_ned_mps, state.wind_ned_mps, state.drift_frd_n, environment.current, environment.wind.gust]
    return [*motion, vessel.rotor_speed, *held]


@pytest.mark.medium
@pytest.mark.parametrize("steps", [0, 8, 83])
def test_a_restarted_vessel_lies_at_rest_and_the_others_are_untouched(steps: int) -> None:
    simulation = world()
    before = advanced(simulation, started(simulation), steps)
    after = simulations.restarted(
        simulation, before, np.array([1]), np.array([[4.0, -6.0]]), np.array([0.5]), default_rng(5)
    )
    for old, new in zip(arrays(before), arrays(after), strict=True):
        assert np.array_equal(old[[0, 2]], new[[0, 2]])
    motion = after.vessel.motion
    assert motion.pos_ned_m[1, :2].tolist() == [4.0, -6.0]
    assert np.arctan2(motion.rot_ned_frd[1, 1, 0], motion.rot_ned_frd[1, 0, 0]) == pytest.approx(0.5)
    assert not motion.vel_ned_mps[1].any()
    assert not motion.gyro_frd_radps[1].any()
    assert not after.vessel.rotor_speed[1].any()
    assert after.time_ns == before.time_ns == steps * simulation.dt_ns
    # Nobody notices in the next steps
    for old, new in zip(
        arrays(advanced(simulation, before, 40, seed=9)), arrays(advanced(simulation, after, 40, seed=9)), strict=True
    ):
        assert np.allclose(old[[0, 2]], new[[0, 2]], rtol=0.0, atol=1e-12)


def test_a_restart_moves_as_a_start_in_the_same_water() -> None:
    """Without waves and gusts, an episode is the same whenever it begins."""
    simulation = Simulation.from_spec(
        FULL,
        Environment(current=make_current(CurrentSpec(0.5, 90.0)), wind=make_wind(WindSpec(5.0, 200.0))),
        0.0025,
    )
    fresh = started(simulation)
    again = simulations.restarted(
        simulation,
        advanced(simulation, fresh, 120),
        np.arange(3),
        fresh.vessel.motion.pos_ned_m[:, :2],
        np.array([0.0, 1.0, -2.0]),
        default_rng(4),
    )
    first, second = advanced(simulation, fresh, 400).vessel.motion, advanced(simulation, again, 400).vessel.motion
    assert np.allclose(first.pos_ned_m, second.pos_ned_m, rtol=0.0, atol=1e-9)
    assert np.allclose(first.gyro_frd_radps, second.gyro_frd_radps, rtol=0.0, atol=1e-9)


def test_discrete_gusts_count_from_the_restart_of_each_vessel() -> None:
    simulation = Simulation.from_spec(
        FULL, Environment(wind=make_wind(WindSpec(5.0, 180.0, discrete_gusts=(GUST,)))), 0.0025
    )
    shared = advanced(simulation, started(simulation), 160)
    state = advanced(simulation, simulations.with_own_gusts(started(simulation)), 160)  # 0.4 s: the gust blows
    assert np.array_equal(shared.wind_ned_mps, state.wind_ned_mps)
    assert np.hypot(*state.wind_ned_mps[0, :2]) == pytest.approx(np.hypot(*state.wind_ned_mps[2, :2]))
    blowing = state.wind_ned_mps[0, 0]
    state = simulations.restarted(simulation, state, np.array([1]), np.zeros((1, 2)), np.zeros(1), default_rng(4))
    assert state.wind_ned_mps[1, 0] == pytest.approx(blowing * 5.0 / 11.0)
    assert state.wind_ned_mps[0, 0] == blowing
    state = advanced(simulation, state, 168)  # the held wind is of 0.4 s after the restart
    assert state.wind_ned_mps[1, 0] == pytest.approx(blowing)
    assert state.wind_ned_mps[0, 0] == pytest.approx(blowing * 5.0 / 11.0)


def test_the_row_of_one_vessel_keeps_what_all_share() -> None:
    shared = np.array([[7.0, 8.0]])
    alone = row_of(Outer(Inner(np.arange(4.0)), shared, np.arange(8.0).reshape(4, 2), 7), 2)
    assert alone.inner.values.tolist() == [2.0]
    assert alone.matrix is shared
    assert alone.nothing is not None
    assert alone.nothing.tolist() == [[4.0, 5.0]]
    assert (alone.inner.text, alone.time_ns) == ("now", 7)
