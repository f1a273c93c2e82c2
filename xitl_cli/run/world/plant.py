"""The plant of a run: the simulated world, its state, and its random generator."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Sequence
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.random import Generator

from sim_core import fleet as fleets
from sim_core import simulation as simulations
from sim_core.environment.environment import Environment, EnvironmentState
from sim_core.fleet import Fleet, FleetState
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState
from sim_core.vessel.condition import Condition
from sim_core.world.contact import Contacts
from sim_core.world.debris import DebrisState, Launch
from sim_core.world.plan import Walls
from sim_core.world.rays import Bodies
from sim_core.world.waterway import Waterway

T = TypeVar("T")


class Plant:
    """One vessel or a fleet in its water.

    simulation, state: of the world; the state is the latest. vessels: in the run's order.
    """

    def __init__(self, simulation: Simulation | Fleet, state: SimulationState | FleetState, rng: Generator) -> None:
        self.simulation = simulation
        self.state = state
        many = isinstance(simulation, Fleet)
        count = len(simulation.names) if isinstance(simulation, Fleet) else 1
        self.vessels = tuple(PlantView(self, number) for number in range(count))
        self._rng = rng
        self._step: Callable[..., Any] = fleets.step if many else simulations.step
        self._launch: Callable[..., Any] = fleets.launch if many else simulations.launch
        self._look_down_ns = 0
        self._commands: Sequence[Any] | None = None
        self._motors: Any = None
        self._rows: Sequence[tuple[int, int]] = simulation.rows if isinstance(simulation, Fleet) else ((0, 0),)
        self._derived_from: SimulationState | FleetState | None = None
        self._derived: dict[tuple[Any, int], Any] = {}
        self._shared: dict[tuple[Any, int], Any] = {}

    @property
    def fleet(self) -> Fleet | None:
        """The simulation of several vessels, None for one vessel."""
        return self.simulation if isinstance(self.simulation, Fleet) else None

    def need_fleet(self) -> Fleet:
        """Return the simulation of several vessels."""
        assert isinstance(self.simulation, Fleet)
        return self.simulation

    @property
    def rows(self) -> Sequence[tuple[int, int]]:
        """For each vessel, the number of its model and its row there."""
        return self._rows

    def advance(self, commands: Sequence[Any], max_steps: int = 1) -> SimulationState | FleetState:
        """Advance one physics step with motor commands (C,) from -1 to 1 by vessel.

        An unchanged list must be the same object. max_steps: number of steps to take at once, which end early when a
        vessel comes near something that it can touch, or is held.
        """
        self._follow_bed()
        simulation, before = self.simulation, self.state
        if commands is not self._commands:
            self._commands = commands
            self._motors = simulation.by_model(commands) if isinstance(simulation, Fleet) else np.array(commands)
        frozen = [vessel for vessel in self.vessels if vessel.held]
        for vessel in frozen:
            vessel.held_steps += 1
        if frozen and isinstance(simulation, Simulation):
            assert isinstance(before, SimulationState)
            self.state = simulations.hold(simulation, before, self._rng)
            return self.state
        self.state = self._step(simulation, before, self._motors, self._rng, 1 if frozen else max_steps)
        if frozen and isinstance(simulation, Fleet):
            assert isinstance(before, FleetState)
            assert isinstance(self.state, FleetState)
            self.state = fleets.held(simulation, self.state, before, [vessel.number for vessel in frozen])
        return self.state

    def _follow_bed(self) -> None:
        """Let each vessel feel the depth below it."""
        simulation, state = self.simulation, self.state
        if state.time_ns < self._look_down_ns:
            return
        if isinstance(simulation, Fleet):
            assert isinstance(state, FleetState)
            self._look_down_ns = state.time_ns + simulation.batches[0].drift_ns
            self.simulation = simulation.over_bed(state)
        else:
            assert isinstance(state, SimulationState)
            self._look_down_ns = state.time_ns + simulation.drift_ns
            self.simulation = simulation.over_bed(state)
        if self.simulation is not simulation:
            self._show_simulation()

    def touching(self) -> Collection[int]:
        """Return the numbers of the vessels with a contact in the latest step."""
        simulation, state = self.simulation, self.state
        if isinstance(state, SimulationState):
            return (0,) if len(state.contacts) else ()
        assert isinstance(simulation, Fleet)
        together = zip(simulation.members, state.batches, strict=True)
        return {
            vessel for members, batch in together if len(batch.contacts) for vessel in members[batch.contacts.vessel]
        }

    def derived(self, number: int, derive: Callable[[Simulation, SimulationState], T]) -> tuple[T, int]:
        """Return `derive` of the latest state, for all vessels of this one's model, and the row of this vessel.

        It is computed once for a state, whichever vessel asks first.
        """
        model, row = self._rows[number]
        return self._derived_of(model, derive), row

    def derived_of_models(self, derive: Callable[[Simulation, SimulationState], T]) -> list[T]:
        """Return `derived` of each model."""
        models = 1 if self.fleet is None else len(self.fleet.batches)
        return [self._derived_of(model, derive) for model in range(models)]

    def _derived_of(self, model: int, derive: Callable[[Simulation, SimulationState], T]) -> T:
        simulation, state = self.simulation, self.state
        if state is not self._derived_from:
            self._derived_from = state
            self._derived.clear()
        derived: T | None = self._derived.get((derive, model))
        if derived is None:
            of_model = simulation.batches[model] if isinstance(simulation, Fleet) else simulation
            together = state if isinstance(state, SimulationState) else state.batches[model]
            derived = self._derived[derive, model] = derive(of_model, together)
        return derived

    def shared(self, number: int, key: Hashable, make: Callable[[], T]) -> tuple[T, int]:
        """Return an object that the vessels of this one's model share under a key, and the row of this vessel."""
        batch, row = self._rows[number]
        if (key, batch) not in self._shared:
            self._shared[key, batch] = make()
        return self._shared[key, batch], row

    def launch(self, body: Launch) -> None:
        """Add one drifting body. Raises ValueError for an impossible length."""
        self.state = self._launch(self.simulation, self.state, body)

    def debris_with(self, launches: Sequence[Launch]) -> DebrisState:
        """The debris as it will be after these launches; the state of the plant stays as it is."""
        state = self.state
        for body in launches:
            state = self._launch(self.simulation, state, body)
        debris: DebrisState = state.debris
        return debris

    def set_condition(self, number: int, condition: Condition | None) -> None:
        """Set the condition of a vessel's actuators and battery from the next step on; None: no fault."""
        if isinstance(self.state, SimulationState):
            assert isinstance(self.simulation, Simulation)
            self.state = simulations.with_condition(self.simulation, self.state, condition)
        else:
            assert isinstance(self.simulation, Fleet)
            self.state = fleets.with_condition(self.simulation, self.state, number, condition)

    def change_environment(
        self, environment: Environment, fluctuate: Callable[[EnvironmentState, int, Generator], EnvironmentState]
    ) -> None:
        """Set another environment of the same water from the next step on.

        fluctuate: returns the new fluctuating state from the current one, for a number of vessels, with the plant's
        generator.
        """
        self.simulation = self.simulation.in_environment(environment)
        state = self.state
        now = state.environment
        fluctuation = fluctuate(now, len(now.wind.veer_rad), self._rng)
        if fluctuation is not now:
            if isinstance(state, FleetState):
                batches = tuple(replace(batch, environment=fluctuation) for batch in state.batches)
                state = replace(state, batches=batches)
            self.state = replace(state, environment=fluctuation)
        self._show_simulation()

    def change_waterway(self, waterway: Waterway) -> None:
        """Set another waterway to collide with from the next step on."""
        simulation = self.simulation
        if isinstance(simulation, Fleet):
            batches = tuple(replace(batch, waterway=waterway) for batch in simulation.batches)
            self.simulation = replace(simulation, batches=batches)
        else:
            self.simulation = replace(simulation, waterway=waterway)
        self._show_simulation()

    def _show_simulation(self) -> None:
        for view in self.vessels:
            view.simulation = _simulation_of(self.simulation, view.number)


class PlantView:
    """The world around one vessel of a plant; arrays have one row.

    number: of the vessel. simulation: constant data, which only the plant's `change_` methods replace. held: the
    vessel's state is frozen while the world continues. held_steps: number of such steps. hulls: returns the sides of
    the other hulls within a range; None without other vessels.
    """

    def __init__(self, plant: Plant, number: int) -> None:
        simulation = plant.simulation
        self.number = number
        self.simulation = _simulation_of(simulation, number)
        self.held = False
        self.held_steps = 0
        self.hulls = self._hulls_within if isinstance(simulation, Fleet) else None
        self._plant = plant

    @property
    def held_s(self) -> float:
        """Time for which the vessel was held."""
        return self.held_steps * self.simulation.dt_s

    @property
    def state(self) -> SimulationState:
        """The latest state, with the contacts of this vessel."""
        simulation, state = self._plant.simulation, self._plant.state
        if isinstance(state, SimulationState):
            return state
        assert isinstance(simulation, Fleet)
        return fleets.state_of(simulation, state, self.number, self.motion())

    @property
    def contacts(self) -> Contacts:
        """Contacts of this vessel in the latest state."""
        simulation, state = self._plant.simulation, self._plant.state
        if isinstance(state, SimulationState):
            return state.contacts
        assert isinstance(simulation, Fleet)
        return fleets.contacts_of(simulation, state, self.number)

    def set_condition(self, condition: Condition | None) -> None:
        """Set the condition of this vessel, as in Plant."""
        self._plant.set_condition(self.number, condition)

    def motion(self) -> Kinematics:
        """Return the motion of the latest state."""
        state = self._plant.state
        if isinstance(state, SimulationState):
            return state.vessel.motion
        motions, row = self._plant.derived(self.number, _motions)
        return motions[row]

    def derived(self, derive: Callable[[Simulation, SimulationState], T]) -> tuple[T, int]:
        """Return what `derive` computes for all vessels of the same model, and this vessel's row, as in Plant."""
        return self._plant.derived(self.number, derive)

    def shared(self, key: Hashable, make: Callable[[], T]) -> tuple[T, int]:
        """Return an object that all vessels of the same model share, and this vessel's row, as in Plant."""
        return self._plant.shared(self.number, key, make)

    @property
    def others(self) -> tuple[str, ...]:
        """Names of all other vessels, in the order of the hulls in `bodies`."""
        simulation = self._plant.simulation
        return fleets.names_of_others(simulation, self.number) if isinstance(simulation, Fleet) else ()

    def tide_m(self) -> float:
        """Return the height of the still water above its mean level now."""
        return self.simulation.environment.tide.height_m(self._plant.state.time_ns * 1e-9)

    def bodies(self) -> Bodies:
        """Return the moving bodies that rays can hit now: drifting bodies, and the hulls of all other vessels."""
        simulation, state = self._plant.simulation, self._plant.state
        if isinstance(state, SimulationState):
            return simulations.drifting_bodies(state)
        assert isinstance(simulation, Fleet)
        return fleets.drifting_bodies(simulation, state, but=self.number)

    def _hulls_within(self, range_m: float) -> Walls:
        simulation, state = self._plant.simulation, self._plant.state
        assert isinstance(simulation, Fleet)
        assert isinstance(state, FleetState)
        return fleets.hull_walls(simulation, state, self.number, range_m)


def _motions(simulation: Simulation, state: SimulationState) -> list[Kinematics]:
    """Return the motion of each vessel: arrays of one row."""
    motion = state.vessel.motion
    return list(map(Kinematics, *(getattr(motion, field.name)[:, None] for field in fields(Kinematics))))


def _simulation_of(simulation: Simulation | Fleet, number: int) -> Simulation:
    return simulation.of(number) if isinstance(simulation, Fleet) else simulation
