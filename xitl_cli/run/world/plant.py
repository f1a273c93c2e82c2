"""The plant of a run: the simulated world, its state, and the random generator that moves it."""

from __future__ import annotations

from dataclasses import replace

from numpy.random import Generator

from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState, kinematics, launch, step
from sim_core.world.debris import Launch


class Plant:
    """state: the latest one. held: the vessel's state is frozen while the world around it goes on.

    held_steps: steps for which it was.
    """

    def __init__(self, simulation: Simulation, state: SimulationState, rng: Generator) -> None:
        self.simulation = simulation
        self.state = state
        self.held = False
        self.held_steps = 0
        self._rng = rng

    @property
    def held_s(self) -> float:
        """The same in seconds."""
        return self.held_steps * self.simulation.dt_s

    def advance(self, motors: Array) -> SimulationState:
        """One physics step with motor commands (N, C) from -1 to 1."""
        before = self.state.vessel
        self.state = step(self.simulation, self.state, motors, self._rng)
        if self.held:
            self.held_steps += 1
            self.state = replace(self.state, vessel=before)
        return self.state

    def motion(self) -> Kinematics:
        """Of the state."""
        return kinematics(self.simulation, self.state)

    def launch(self, body: Launch) -> None:
        """One body more adrift. Raises ValueError for an impossible length."""
        self.state = launch(self.simulation, self.state, body)
