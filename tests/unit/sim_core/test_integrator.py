"""The integrator: its order, what it does to contacts, and the steps that it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from vessels import FULL

from sim_core.environment.current import UniformCurrent
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, Water, WaveSpec, WindSpec
from sim_core.environment.waves import realise_waves
from sim_core.environment.wind import Wind
from sim_core.frames import quat_to_matrix
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.spec import AddedMass, Damping
from sim_core.vessel.step_length import is_followed
from sim_core.vessel.vessel import advance


def after_16_s(rate_hz: float, waves: str) -> np.ndarray:
    """Position and attitude after full ahead with a turn, then a turn the other way, in current and wind."""
    water = Water()
    environment = Environment(
        water,
        UniformCurrent(CurrentSpec(0.3, 40.0)),
        realise_waves(WaveSpec(waves, 0.2, 2.5, 60.0), water, np.random.default_rng(1)),
        Wind(WindSpec(5.0, 20.0)),
    )
    simulation = Simulation.from_spec(FULL, environment, 1.0 / rate_hz)
    # The mean force of the waves is held for 20 ms in a run; each of its jumps is met half a step early.
    simulation = replace(simulation, drift_ns=simulation.dt_ns)
    rng = np.random.default_rng(0)
    state = initial(simulation, np.zeros((1, 2)), np.array([0.3]), rng)
    for command in ([[0.8, 0.5]], [[0.3, 0.9]]):
        for _ in range(round(8.0 * rate_hz)):
            state = step(simulation, state, np.array(command), rng)
    return np.concatenate([state.vessel.motion.pos_ned_m[0], state.vessel.motion.quat_ned_frd[0]])


@pytest.mark.medium
@pytest.mark.parametrize("waves", ["none", "jonswap"])
def test_it_converges_at_order_two(waves: str) -> None:
    """Half the step leaves a quarter of the error against a fine reference; at 200 Hz that is below 0.2 mm after 16 s.

    The reference has 1/16 of the error of the finer one: the ratio is (16 - 1/4) / (4 - 1/4) = 4.2.
    """
    reference = after_16_s(800.0, waves)
    coarse, fine = (np.abs(after_16_s(rate_hz, waves) - reference) for rate_hz in (100.0, 200.0))
    assert coarse[:3].max() / fine[:3].max() == pytest.approx(4.2, rel=0.15)
    assert coarse[3:].max() / fine[3:].max() == pytest.approx(4.2, rel=0.15)
    assert fine[:3].max() < 2e-4


def swinging(omega: list[float], damping_ratio: float, steps: int) -> np.ndarray:
    """(steps, N) depths of masses on springs with these omega x step and a damper, let go from 1 m."""
    spring, count = np.array(omega) ** 2, len(omega)
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    zero, down = np.zeros((count, 3)), np.tile([0.0, 0.0, 1.0], (count, 1))
    motion = Kinematics(down, zero, zero, quat, quat_to_matrix(quat), zero, zero)
    before, depths = None, np.empty((steps, count))
    for number in range(steps):
        half = np.zeros((count, 6))
        half[:, 2] = -0.5 * spring * motion.pos_ned_m[:, 2]
        half[:, 2] -= damping_ratio * np.array(omega) * motion.vel_ned_mps[:, 2]
        motion = advance(motion, 3.0 * half - (half if before is None else before), half, 1.0)
        before = half
        depths[number] = motion.pos_ned_m[:, 2]
    return depths


def test_a_swing_keeps_its_energy_up_to_two_radians_a_step() -> None:
    """Leap-frog: neither growth nor decay."""
    depths = np.abs(swinging([0.5, 1.99, 2.01], 0.0, 600))
    early, late = depths[:150].max(axis=0), depths[-150:].max(axis=0)
    assert late[0] == pytest.approx(early[0], rel=0.01)  # half a radian a step misses the crest by up to 3 %, evenly
    assert late[1] < 1.1 * early[1]
    assert late[2] > 1e6 * early[2]


@pytest.mark.parametrize("ratio", [0.05, 0.2, 1.0, 5.0])
def test_the_step_that_is_refused_is_the_one_that_grows(ratio: float) -> None:
    matrix = np.zeros((9, 9))
    matrix[(0, 1, 2), (5, 6, 7)] = 1.0
    matrix[5, 0], matrix[5, 5] = -1.0, -2.0 * ratio
    low, high = 0.01, 2.5
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_followed(matrix, middle) else (low, middle)
    depths = np.abs(swinging([0.95 * low, 1.05 * low], ratio, 400))
    assert depths[-10:, 0].max() < 0.1
    assert depths[-10:, 1].max() > 10.0


def test_a_vessel_too_stiff_for_its_steps_is_refused_with_a_rate_that_follows_it() -> None:
    """100 kN s/m on 329 kg in heave: 304 /s, so that steps of 2.5 ms would do, of 5 ms not."""
    stiff = replace(FULL, damping_linear=replace(FULL.damping_linear, heave=1e5))
    Simulation.from_spec(stiff, Environment(), 0.0025)
    with pytest.raises(ValueError, match=r"heave at 30\d /s: steps of 5 ms .* clock.physics_rate_hz to 400"):
        Simulation.from_spec(stiff, Environment(), 0.005)
    light = replace(FULL, inertia_kgm2=(0.02, 35.0, 35.01), added_mass=AddedMass(), damping_linear=Damping(roll=50.0))
    with pytest.raises(ValueError, match="its roll at"):
        Simulation.from_spec(light, Environment(), 0.0025)
