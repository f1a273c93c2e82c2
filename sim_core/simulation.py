"""One step of the world: environment, surroundings of each vessel, vessel.

simulation = Simulation.from_spec(vessel_model, environment, dt_s=0.0025)
state = initial(simulation, north_east_m, yaw_rad, rng)
state = step(simulation, state, command, rng)
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from sim_core.dataclass import dataclass
from sim_core.environment import environment as surroundings_model
from sim_core.environment.environment import Environment, EnvironmentState
from sim_core.environment.waves import FlatWater, HullSurface, HullWaves, StillHull, WaveField
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.motion import Influences, MotionStep, Moved, surroundings
from sim_core.rows import Rows, row_of, with_rows
from sim_core.state_class import state_class
from sim_core.vessel import vessel as vessel_motion
from sim_core.vessel.condition import Condition
from sim_core.vessel.confined_water import felt_depth_m
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.vessel import Surroundings, Vessel, VesselState
from sim_core.world import waterway as waterways
from sim_core.world.contact import Contacts, Outline
from sim_core.world.debris import DebrisState, Launch, bodies_at
from sim_core.world.rays import Bodies
from sim_core.world.waterway import OPEN_WATER, STILL, Afloat, StepTimes, WaterMotion, Waterway

# Current, gusts and the waves' mean force change over seconds and are sampled exactly at any step. 50 Hz is sufficient.
DRIFT_NS = 20_000_000
BOTTOM_SHARE = 0.02
"""Change of depth, as a share, from which forces are computed anew."""
WIND_HEIGHT_M = 10.0
"""Height of the wind that moves floating bodies, as in tables of leeway."""


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """All constants of a run; made by `from_spec`."""

    motion: MotionStep
    """The vessel in the waves, and its step."""
    environment: Environment
    wave_drift_ne_mps: Array
    """Drift of the water due to the waves, over the vessel's draft, (2,)."""
    dt_s: float
    dt_ns: int
    drift_ns: int
    """Update period of current, gusts and the waves' mean force: a whole number of steps."""
    outline: Outline
    waterway: Waterway = OPEN_WATER
    bottoms_m: tuple[float, ...] = ()
    """Depth over the bed below each vessel; empty for the depth of the environment's water."""
    own_motions: tuple[tuple[int, MotionStep], ...] = ()
    """Rows of a fleet's vessels that feel another depth than `motion`, with their steps."""

    @classmethod
    def from_spec(
        cls, model: VesselSpec, environment: Environment, dt_s: float, waterway: Waterway = OPEN_WATER
    ) -> Simulation:
        """Raises ValueError if dt_s is not a whole number of nanoseconds or the vessel does not float upright."""
        dt_ns = round(dt_s * 1e9)
        if dt_ns <= 0 or abs(dt_s * 1e9 - dt_ns) > 1e-3:
            raise ValueError(f"dt_s = {dt_s} must be a positive whole number of nanoseconds, or the clock would drift")
        vessel = Vessel.from_spec(model, environment.water, dt_s, environment.waves)
        hull_waves, wave_drift = _waves_at(vessel, environment.waves)
        drift_ns = max(DRIFT_NS // dt_ns, 1) * dt_ns
        motion, outline = MotionStep(vessel, hull_waves), Outline.from_spec(model)
        return cls(motion, environment, wave_drift, dt_s, dt_ns, drift_ns, outline, waterway)

    @property
    def vessel(self) -> Vessel:
        """The vessel's constants."""
        return self.motion.vessel

    @property
    def hull_waves(self) -> HullWaves | StillHull:
        """The waves at the points of the hull."""
        return self.motion.hull_waves

    @property
    def why_numpy(self) -> str | None:
        """Reason why the steps run in numpy, None if they run compiled."""
        return self.motion.why_numpy

    def depths_m(self, vessels: int) -> tuple[float, ...]:
        """Return the depth of the water that each of N vessels feels."""
        return self.bottoms_m or (self.environment.water.depth_m,) * vessels

    def over_bed(self, state: SimulationState) -> Simulation:
        """Return the simulation over the bed below each vessel; this one if the bed is as deep as before everywhere.

        Depth counts as the same within BOTTOM_SHARE, and everywhere where it has no effect. The tide is part of it.
        """
        bed, vessel, water = self.waterway.bed, self.vessel, self.environment.water
        if bed is None or not vessel.model.confined_water:
            return self
        still_m = water.level_m + self.environment.tide.height_m(state.time_ns * 1e-9)
        below_m = (bed.bed_down_m(state.vessel.motion.pos_ned_m[:, :2]) + still_m).tolist()
        # The vessels whose depth changes
        bottoms_m, changed = list(self.depths_m(len(below_m))), []
        for row, depths_m in enumerate(zip(below_m, bottoms_m, strict=True)):
            depth_m, before_m = (felt_depth_m(vessel.model, vessel.rest, own) for own in depths_m)
            if depth_m != before_m and not abs(depth_m - before_m) < BOTTOM_SHARE * before_m < math.inf:
                bottoms_m[row] = depth_m
                changed.append(row)
        if not changed:
            return self
        # Their steps
        steps = {row: MotionStep(vessel.over_bottom(water, bottoms_m[row]), self.hull_waves) for row in changed}
        if len(below_m) == 1:
            return replace(self, motion=steps[0], bottoms_m=tuple(bottoms_m))
        of_all_m = felt_depth_m(vessel.model, vessel.rest, water.depth_m)
        own = {row: step for row, step in (dict(self.own_motions) | steps).items() if bottoms_m[row] != of_all_m}
        return replace(self, own_motions=tuple(sorted(own.items())), bottoms_m=tuple(bottoms_m))

    def in_environment(self, environment: Environment) -> Simulation:
        """Return the same vessel in another environment of the same water."""
        if environment.waves is self.environment.waves:
            return replace(self, environment=environment)
        vessel = self.vessel.in_waves(environment.waves, environment.water)
        hull_waves, wave_drift = _waves_at(vessel, environment.waves)
        return replace(
            self,
            motion=MotionStep(vessel, hull_waves),
            environment=environment,
            wave_drift_ne_mps=wave_drift,
            bottoms_m=() if self.own_motions else self.bottoms_m,
            own_motions=(),
        )


def _waves_at(vessel: Vessel, waves: WaveField | FlatWater) -> tuple[HullWaves | StillHull, Array]:
    """Return the sampler of a sea at the hull, and the (2,) wave drift of the water over the draft."""
    hulls, seakeeping = vessel.buoyancy, vessel.seakeeping
    felt = seakeeping.felt(waves) if seakeeping is not None and isinstance(waves, WaveField) else None
    return waves.at_hull(hulls.points_frd_m, hulls.point_share, felt), waves.shear_drift_ne_mps(vessel.rest.draft_m)


@state_class
class SimulationState:
    """The world at time_ns, with the surroundings of the vessels in the last step."""

    time_ns: int
    vessel: VesselState
    environment: EnvironmentState
    current_ned_mps: Array
    """Current at the vessels, (N, 3), with the waves' drift and without their orbital motion."""
    wind_ned_mps: Array
    """Wind at the height of the vessels' wind areas, (N, 3)."""
    drift_frd_n: Array
    """Mean force of the waves, (N, 2)."""
    surface: HullSurface
    """The water surface at the hulls."""
    afloat: Afloat = STILL
    """The debris, and the contacts of the vessels in the last step."""

    @property
    def debris(self) -> DebrisState:
        """State of the drifting bodies."""
        return self.afloat.debris

    @property
    def contacts(self) -> Contacts:
        """Contacts of the vessels in the last step."""
        return self.afloat.contacts


def initial(simulation: Simulation, north_east_m: Array, yaw_rad: Array, rng: Generator) -> SimulationState:
    """Place vessels at rest at (N, 2) positions and (N,) headings. Draw the environment from its stationary state."""
    vessel = vessel_motion.at_rest(simulation.vessel, north_east_m, yaw_rad, simulation.environment.tide.height_m(0.0))
    return at_start(simulation, vessel, surroundings_model.initial(simulation.environment, len(north_east_m), rng))


def at_start(simulation: Simulation, vessel: VesselState, environment: EnvironmentState) -> SimulationState:
    """Return the state at time 0."""
    flows = _flows_at(simulation, environment, vessel.motion, 0.0)
    around = _surroundings(simulation, flows, vessel, 0.0)
    return SimulationState(0, vessel, environment, *flows, around.drift_frd_n, around.surface)


def restarted(
    simulation: Simulation, state: SimulationState, rows: Rows, north_east_m: Array, yaw_rad: Array, rng: Generator
) -> SimulationState:
    """Return `state` with the vessels of K rows at rest again, at (K, 2) positions and (K,) headings.

    Their current and wind are drawn anew from the stationary state, and their discrete gusts count from now. All other
    vessels, the sea, the tide and the time do not change.
    """
    time_s = state.time_ns * 1e-9
    vessel = vessel_motion.at_rest(
        simulation.vessel, north_east_m, yaw_rad, simulation.environment.tide.height_m(time_s)
    )
    environment = surroundings_model.initial(simulation.environment, len(rows), rng)
    if state.environment.wind.began_s is not None:
        environment = replace(environment, wind=replace(environment.wind, began_s=np.full(len(rows), time_s)))
    flows = _flows_at(simulation, environment, vessel.motion, time_s)
    around = _surroundings(simulation, flows, vessel, time_s)
    if state.vessel.half_change is not None:
        vessel = vessel_motion.with_half_change(simulation.vessel, vessel, around)
    fresh = SimulationState(state.time_ns, vessel, environment, *flows, around.drift_frd_n, around.surface)
    return with_rows(state, rows, replace(fresh, afloat=state.afloat))


def with_own_gusts(state: SimulationState) -> SimulationState:
    """Return `state` with discrete gusts that count from the restart of each vessel, and now from this instant."""
    wind = state.environment.wind
    wind = replace(wind, began_s=np.full(len(wind.veer_rad), state.time_ns * 1e-9))
    return replace(state, environment=replace(state.environment, wind=wind))


def step(
    simulation: Simulation, state: SimulationState, command: Array, rng: Generator, max_steps: int = 1
) -> SimulationState:
    """Return the state one dt_s later, under (N, C) commands in [-1, 1], (1, C) for all vessels: see VesselSpec.

    max_steps: number of steps to take at once, which gives the same states and is faster. They end early when the
    vessels come near something that they can touch.
    """
    end_ns = state.time_ns + max_steps * simulation.dt_ns
    while state.time_ns < end_ns:
        environment, afloat = _environment_and_bodies(simulation, state, rng)
        if not afloat.idle:
            return advance(simulation, state, environment, command, afloat)
        # Steps until the next change
        until_ns = min(end_ns, state.time_ns - state.time_ns % simulation.drift_ns + simulation.drift_ns)
        state = advance(simulation, state, environment, command, afloat, until_ns)
    return state


def hold(simulation: Simulation, state: SimulationState, rng: Generator) -> SimulationState:
    """Return the state one dt_s later with the vessels frozen, while the world continues.

    The vessels then continue as after `step`. `surface` is renewed only with the waves' mean force.
    """
    environment, afloat = _environment_and_bodies(simulation, state, rng)
    time_ns = state.time_ns + simulation.dt_ns
    if state.time_ns % simulation.drift_ns:
        return replace(state, time_ns=time_ns, environment=environment, afloat=afloat)
    time_s, vessel = state.time_ns * 1e-9, state.vessel
    flows = _flows_at(simulation, environment, vessel.motion, time_s)
    around = _surroundings(simulation, flows, vessel, time_s)
    return SimulationState(time_ns, vessel, environment, *flows, around.drift_frd_n, around.surface, afloat)


def _environment_and_bodies(
    simulation: Simulation, state: SimulationState, rng: Generator
) -> tuple[EnvironmentState, Afloat]:
    """Return the environment after the step that begins now, and the debris and contacts of this step."""
    # Current and gusts, which change over seconds
    environment = state.environment
    long_step = state.time_ns % simulation.drift_ns == 0
    if long_step:
        environment = surroundings_model.step(simulation.environment, environment, simulation.drift_ns * 1e-9, rng)
    # Debris and contacts
    afloat = state.afloat
    if simulation.waterway is not OPEN_WATER and (long_step or not afloat.idle):
        afloat = waterways.step(
            simulation.waterway,
            simulation.outline,
            afloat,
            StepTimes(state.time_ns, simulation.dt_ns, simulation.drift_ns),
            state.vessel.motion,
            water_motion(simulation, environment, state.time_ns),
        )
    return environment, afloat


def elevation_m(simulation: Simulation, state: SimulationState) -> Array:
    """Return the (N,) elevation of tide and waves at the vessels, up positive above the mean level."""
    environment, time_s = simulation.environment, state.time_ns * 1e-9
    waves_m = environment.waves.elevation_m(time_s, state.vessel.motion.pos_ned_m[:, :2])
    return environment.tide.height_m(time_s) + waves_m


def drifting_bodies(state: SimulationState) -> Bodies:
    """Return the drifting bodies at the state's instant, for ray casting."""
    return bodies_at(state.afloat.debris, state.time_ns)


def launch(simulation: Simulation, state: SimulationState, body: Launch) -> SimulationState:
    """Add one drifting body now, regardless of its `at_ns`. Raises ValueError for an impossible length."""
    water = water_motion(simulation, state.environment, state.time_ns)
    debris = waterways.launch_body(state.afloat.debris, body, water)
    return replace(state, afloat=replace(state.afloat, debris=debris))


def with_condition(simulation: Simulation, state: SimulationState, condition: Condition | None) -> SimulationState:
    """Return `state` with its one vessel in this condition from now on; None for no fault."""
    return replace(state, vessel=vessel_motion.with_condition(simulation.vessel, state.vessel, condition))


def water_motion(simulation: Simulation, state: EnvironmentState, time_ns: int) -> WaterMotion:
    """Return the water motion at the bodies, and the wind. All bodies use those of the first vessel, which differ only
    in time between vessels.
    """
    environment, varies, time_s = simulation.environment, state.current[:1], time_ns * 1e-9
    return WaterMotion(
        lambda places: environment.current_ned_mps(varies, time_s, places),
        lambda places: environment.surface_ned_z_m(time_s, places),
        environment.water.density_kgpm3,
        lambda: environment.wind.velocity_ned_mps(state.wind, time_s, WIND_HEIGHT_M)[0, :2],
    )


def advance(
    simulation: Simulation,
    state: SimulationState,
    environment: EnvironmentState,
    command: Array,
    afloat: Afloat,
    until_ns: int = 0,
) -> SimulationState:
    """Return the state one dt_s later, or at `until_ns`, under (N, C) commands.

    environment: the environment state after its step. afloat: debris and contacts of this step. until_ns: at most the
    beginning of the next update of current, gusts and the waves' mean force.
    """
    # Water and air at the vessels, and the mean force of the waves, which are held for a period
    time_ns, dt_ns, tide = state.time_ns, simulation.dt_ns, simulation.environment.tide
    time_s, motion = time_ns * 1e-9, state.vessel.motion
    flows: tuple[Array, Array] = state.current_ned_mps, state.wind_ned_mps
    drift_frd_n: Array | None = state.drift_frd_n
    if time_ns % simulation.drift_ns == 0:
        flows, drift_frd_n = _flows_at(simulation, environment, motion, time_s), None
    # Motion of the vessels
    influences = Influences(time_s, tide.height_m(time_s), *flows, drift_frd_n, command, afloat.wrench_frd)
    after_ns = max(until_ns, time_ns + dt_ns)
    instants_s = [instant_ns * 1e-9 for instant_ns in range(time_ns + dt_ns, after_ns, dt_ns)]
    later = [(instant_s, tide.height_m(instant_s)) for instant_s in instants_s]
    moved = simulation.motion.step(state.vessel, influences, later)
    if simulation.own_motions:
        moved = _moved_apart(simulation, state.vessel, influences, later, moved)
    return SimulationState(after_ns, moved.vessel, environment, *flows, moved.drift_frd_n, moved.surface, afloat)


def _moved_apart(
    simulation: Simulation,
    before: VesselState,
    influences: Influences,
    later: list[tuple[float, float]],
    moved: Moved,
) -> Moved:
    """Return `moved` with the steps of the vessels that feel another depth."""
    before, after = replace(before, packed=None), replace(moved.vessel, packed=None)
    surface, drift_frd_n = moved.surface, moved.drift_frd_n.copy()
    for row, motion in simulation.own_motions:
        own = motion.step(row_of(before, row), row_of(influences, row), later)
        after = with_rows(after, [row], replace(own.vessel, packed=None))
        surface = with_rows(surface, [row], own.surface)
        drift_frd_n[row] = own.drift_frd_n[0]
    return Moved(after, surface, drift_frd_n)


def _surroundings(
    simulation: Simulation, flows: tuple[Array, Array], vessel: VesselState, time_s: float
) -> Surroundings:
    """Return water, air and surface at vessels, with the mean force of the waves."""
    tide_m, stopped = simulation.environment.tide.height_m(time_s), np.zeros((1, simulation.vessel.model.commands))
    influences = Influences(time_s, tide_m, *flows, None, stopped, None)
    return surroundings(simulation.vessel, simulation.hull_waves, vessel.motion, influences)


def _flows_at(
    simulation: Simulation, state: EnvironmentState, motion: Kinematics, time_s: float
) -> tuple[Array, Array]:
    """Return the (N, 3) velocities of the current and of the air at the vessels' areas, which are held for a period."""
    environment = simulation.environment
    current = environment.current_ned_mps(state.current, time_s, motion.pos_ned_m)
    current[:, :2] += simulation.wave_drift_ne_mps
    return current, environment.wind.velocity_ned_mps(state.wind, time_s, simulation.vessel.model.wind.centre_height_m)
