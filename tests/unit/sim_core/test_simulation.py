"""The whole step: batches, seeds, clock, bad input."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from vessels import FULL

from sim_core.environment.current import UniformCurrent
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, GustSpec, Water, WaveSpec, WindSpec
from sim_core.environment.waves import realise_waves
from sim_core.environment.wind import Wind
from sim_core.simulation import Simulation, SimulationState, elevation_m, hold, initial, step
from sim_core.vessel.spec import Damping

WATER = Water(level_m=-0.01)


def rough(seed: int) -> tuple[Simulation, np.random.Generator]:
    rng = np.random.default_rng(seed)
    environment = Environment(
        water=WATER,
        current=UniformCurrent(CurrentSpec(0.5, 90.0, 0.05, 60.0)),
        waves=realise_waves(WaveSpec("jonswap", 0.2, 2.5, 90.0, spreading=10.0), WATER, rng),
        wind=Wind(WindSpec(5.0, 270.0, 10.0, 120.0, GustSpec("ornstein-uhlenbeck", 1.5, 8.0))),
    )
    return Simulation.from_spec(FULL, environment, 0.0025), rng


def sailed(simulation: Simulation, rng: np.random.Generator, steps: int) -> SimulationState:
    state = initial(simulation, np.zeros((1, 2)), np.zeros(1), rng)
    for _ in range(steps):
        state = step(simulation, state, np.array([[0.8, 0.6]]), rng)
    return state


def arrays(state: SimulationState) -> list[np.ndarray]:
    motion = state.vessel.motion
    return [getattr(motion, field.name) for field in fields(motion)] + [
        state.vessel.rotor_speed,
        state.current_ned_mps,
        state.wind_ned_mps,
        state.drift_frd_n,
    ]


@pytest.mark.medium
def test_a_seed_repeats_a_run_bit_for_bit() -> None:
    first, again, other = (sailed(*rough(seed), 400) for seed in (3, 3, 4))
    for a, b in zip(arrays(first), arrays(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(first.vessel.motion.pos_ned_m, other.vessel.motion.pos_ned_m)


@pytest.mark.medium
def test_a_batch_equals_single_runs() -> None:
    """Equal but for rounding: products of other shapes sum in another order, in single precision for the waves."""
    waves = realise_waves(WaveSpec("pierson-moskowitz", 0.3, 2.5, 40.0), WATER, np.random.default_rng(5))
    environment = Environment(WATER, UniformCurrent(CurrentSpec(0.5, 120.0)), waves, Wind(WindSpec(6.0, 200.0)))
    simulation = Simulation.from_spec(FULL, environment, 0.0025)
    rng = np.random.default_rng(0)
    places = rng.uniform(-50.0, 50.0, (8, 2))
    yaws = rng.uniform(-3.0, 3.0, 8)
    commands = rng.uniform(-1.0, 1.0, (8, 2))
    batch = initial(simulation, places, yaws, rng)
    singles = [initial(simulation, places[i : i + 1], yaws[i : i + 1], rng) for i in range(8)]
    for _ in range(800):
        batch = step(simulation, batch, commands, rng)
        singles = [step(simulation, state, commands[i : i + 1], rng) for i, state in enumerate(singles)]
    for i, state in enumerate(singles):
        for together, alone in zip(arrays(batch), arrays(state), strict=True):
            np.testing.assert_allclose(together[i], alone[0], atol=2e-5)


@pytest.mark.medium
def test_a_held_vessel_sails_on_as_after_steps_whose_motion_was_discarded() -> None:
    ways = []
    for frozen in (hold, lambda simulation, state, rng: step(simulation, state, np.array([[0.8, 0.6]]), rng)):
        simulation, rng = rough(6)
        state = initial(simulation, np.zeros((1, 2)), np.zeros(1), rng)
        for _ in range(203):  # ends between two updates of the mean force
            state = replace(frozen(simulation, state, rng), vessel=state.vessel)
        for _ in range(100):
            state = step(simulation, state, np.array([[0.8, 0.6]]), rng)
        ways.append(state)
    held, discarded = ways
    assert held.time_ns == discarded.time_ns
    for a, b in zip(arrays(held), arrays(discarded), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.medium
def test_step_leaves_its_arguments_alone() -> None:
    simulation, rng = rough(1)
    state = sailed(simulation, rng, 5)
    before = [array.copy() for array in arrays(state)]
    step(simulation, state, np.array([[0.8, 0.6]]), rng)
    for then, now in zip(before, arrays(state), strict=True):
        np.testing.assert_array_equal(then, now)


@pytest.mark.medium
def test_clock_counts_whole_nanoseconds() -> None:
    simulation, rng = rough(1)
    assert sailed(simulation, rng, 400).time_ns == 1_000_000_000
    with pytest.raises(ValueError, match="whole number of nanoseconds"):
        Simulation.from_spec(FULL, simulation.environment, 1.0 / 300.0)
    with pytest.raises(ValueError, match="positive"):
        Simulation.from_spec(FULL, simulation.environment, 0.0)


@pytest.mark.medium
def test_shapes_and_unit_quaternions() -> None:
    simulation, rng = rough(2)
    state = initial(simulation, np.zeros((5, 2)), np.zeros(5), rng)
    for _ in range(50):
        state = step(simulation, state, np.array([[1.0, -1.0]]), rng)
    motion = state.vessel.motion
    assert motion.rot_ned_frd.shape == (5, 3, 3)
    assert motion.acc_ned_mps2.shape == motion.gyro_frd_radps.shape == state.wind_ned_mps.shape == (5, 3)
    assert elevation_m(simulation, state).shape == (5,)
    np.testing.assert_allclose(np.linalg.norm(motion.quat_ned_frd, axis=1), 1.0, atol=1e-14)
    assert len({*state.wind_ned_mps[:, 1]}) == 5  # every vessel has its own gusts


@pytest.mark.medium
def test_a_storm_stays_finite_and_capsizes_nobody() -> None:
    """Hulls that dive and leave the water under any command: 64 vessels, 20 s each, waves as high as the hulls."""
    water = Water()
    waves = realise_waves(WaveSpec("jonswap", 0.5, 3.0, 0.0, spreading=2.0), water, np.random.default_rng(0))
    wind = Wind(WindSpec(15.0, 180.0, 20.0, 10.0, GustSpec("ornstein-uhlenbeck", 5.0, 2.0)))
    simulation = Simulation.from_spec(
        FULL, Environment(water, UniformCurrent(CurrentSpec(2.0, 90.0)), waves, wind), 0.0025
    )
    rng = np.random.default_rng(1)
    state = initial(simulation, np.zeros((64, 2)), np.linspace(0.0, 6.0, 64), rng)
    commands = rng.uniform(-1.0, 1.0, (64, 2))
    fastest, upright = 0.0, 1.0
    for _ in range(8000):
        state = step(simulation, state, commands, rng)
        fastest = max(fastest, np.abs(state.vessel.motion.vel_ned_mps).max())
        upright = min(upright, state.vessel.motion.rot_ned_frd[:, 2, 2].min())
    assert np.isfinite(state.vessel.motion.pos_ned_m).all()
    assert fastest < 15.0
    assert upright > 0.5


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda: replace(FULL, mass_kg=-1.0), "VesselSpec.mass_kg = -1.0"),
        (lambda: replace(FULL, inertia_kgm2=(1.0, 1.0, 5.0)), "belongs to no body"),
        (lambda: replace(FULL, propellers=()), "VesselSpec.propellers.*too short"),
        (lambda: replace(FULL.hull, width_m=0.5), "too narrow for two hulls"),
        (lambda: replace(FULL.hull, strips=1), "Hull.strips = 1"),
        (lambda: Damping(sway=-3.0), "Damping.sway = -3.0"),
        (lambda: replace(FULL.propellers[0], position_frd_m=(1.0, 2.0)), "position_frd_m = .*too short"),
        (lambda: replace(FULL.propellers[0], spin_up_s=0.0), "Propeller.spin_up_s = 0.0"),
    ],
)
def test_impossible_vessels_are_refused(change, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        change()
