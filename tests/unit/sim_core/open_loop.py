"""A vessel under constant commands in still water, and still air that drags nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim_core.environment.current import UniformCurrent
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, Water, WaveSpec, WindSpec
from sim_core.environment.waves import realise_waves
from sim_core.environment.wind import Wind
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.spec import Propeller, VesselSpec, Windage


@dataclass(frozen=True)
class OpenLoop:
    """Each (steps + 1, N): velocities of the origin in body axes and the heading, counted on through a full turn."""

    surge_mps: np.ndarray
    sway_mps: np.ndarray
    yaw_radps: np.ndarray
    heading_rad: np.ndarray
    dt_s: float

    @property
    def last(self) -> np.ndarray:
        """(N, 3): surge, sway and yaw rate at the end."""
        return np.column_stack([self.surge_mps[-1], self.sway_mps[-1], self.yaw_radps[-1]])

    def heading_deg(self, at_s: float) -> np.ndarray:
        """(N,)."""
        return np.degrees(self.heading_rad[round(at_s / self.dt_s)])


def pushed_sideways(model: VesselSpec, most_n: float) -> VesselSpec:
    """With one propeller more, across at the origin, the last of all."""
    across = Propeller(
        position_frd_m=(0.0, 0.0, 0.0), angle_deg=90.0, medium="water",
        max_thrust_n=most_n, max_reverse_thrust_n=most_n, spin_up_s=0.01, spin_down_s=0.01,
    )  # fmt: skip
    return replace(model, propellers=(*model.propellers, across))


def open_loop(
    model: VesselSpec, command: np.ndarray, seconds: float, density_kgpm3: float, dt_s: float = 0.02
) -> OpenLoop:
    """N vessels from rest, heading north, each under its row of (N, C) commands."""
    rng = np.random.default_rng(0)
    water = Water(density_kgpm3=density_kgpm3, level_m=0.0)
    still = Environment(
        water,
        UniformCurrent(CurrentSpec(0.0, 0.0)),
        realise_waves(WaveSpec("none"), water, rng),
        Wind(WindSpec(0.0, 0.0)),
    )
    simulation = Simulation.from_spec(replace(model, wind=Windage()), still, dt_s)
    vessels = len(command)
    state = initial(simulation, np.zeros((vessels, 2)), np.zeros(vessels), rng)
    told = []
    for _ in range(round(seconds / dt_s) + 1):
        motion = state.vessel.motion
        ahead = np.vecdot(motion.rot_ned_frd[:, :, 0], motion.vel_ned_mps)
        across = np.vecdot(motion.rot_ned_frd[:, :, 1], motion.vel_ned_mps)
        heading = np.arctan2(motion.rot_ned_frd[:, 1, 0], motion.rot_ned_frd[:, 0, 0])
        told.append((ahead, across, motion.gyro_frd_radps[:, 2], heading))
        state = step(simulation, state, command, rng)
    surge, sway, yaw, heading = np.array(told).transpose(1, 0, 2)
    return OpenLoop(surge, sway, yaw, np.unwrap(heading, axis=0), dt_s)
