"""Vessels of any models in one body of water, with a common sea, wind and current, and collisions between hulls.

fleet = Fleet.from_spec(models, environment, dt_s, waterway, names=("leader", "follower"))
state = initial(fleet, north_east_m, yaw_rad, rng)
state = step(fleet, state, fleet.by_model(commands), rng)
alone = state_of(fleet, state, 1)  # a state of simulation fleet.of(1)

Vessels of equal models are the rows of one `Simulation` and take their steps together. Random fluctuations are drawn
once for all vessels. Waves, and a current across a channel, depend on each vessel's position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.random import Generator

from sim_core import simulation as simulations
from sim_core.dataclass import dataclass
from sim_core.environment import environment as surroundings_model
from sim_core.environment.environment import Environment, EnvironmentState
from sim_core.environment.waves import HullSurface
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState
from sim_core.state_class import state_class
from sim_core.vessel import vessel as vessel_motion
from sim_core.vessel.battery import BatteryState
from sim_core.vessel.condition import Condition
from sim_core.vessel.sections import hull_shape
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.vessel import VesselState
from sim_core.world import waterway as waterways
from sim_core.world.contact import NO_CONTACTS, Contacts, joined_contacts, wrench_frd
from sim_core.world.debris import DebrisState, Launch
from sim_core.world.geometry import PLASTIC, Mesh, merged
from sim_core.world.hull_contact import (
    NOBODY_CLOSE,
    CloseHulls,
    Hulls,
    compute_hull_contacts,
    find_close_hulls,
    find_close_pairs,
)
from sim_core.world.plan import Capsules, Numbers, Walls, convex_hull
from sim_core.world.rays import Bodies
from sim_core.world.traffic import ScriptedVessel, scripted_motion
from sim_core.world.waterway import OPEN_WATER, Afloat, StepTimes, Waterway


@dataclass(frozen=True, slots=True, eq=False)
class SeenHull:
    """Visible shape of a vessel in body axes: triangles for rays, and E upright sides for range sensors."""

    mesh: Mesh
    """Mesh of all hulls of the vessel."""
    from_frd_m: Array
    """First ends of the sides, halfway between top and bottom, (E, 3)."""
    span_frd_m: Array
    """Vectors to the second ends, (E, 3)."""
    half_height_m: Array
    """Half the height of the sides, (E,)."""

    @classmethod
    def of_model(cls, model: VesselSpec) -> SeenHull:
        """Return the shape of a vessel's demi-hulls. Raises the same errors as `hull_shape`."""
        shapes = [hull_shape(hull) for hull in model.demi_hulls]
        return cls.of_meshes([Mesh(shape.vertices_m, shape.faces, PLASTIC) for shape in shapes])

    @classmethod
    def of_meshes(cls, meshes: list[Mesh]) -> SeenHull:
        """Return the shape of meshes, with the convex outline of each as sides."""
        corners, following, half = [], [], []
        for mesh in meshes:
            plan = convex_hull(mesh.vertices_m[:, :2])
            top_m, bottom_m = float(mesh.vertices_m[:, 2].min()), float(mesh.vertices_m[:, 2].max())
            corners.append(np.column_stack([plan, np.full(len(plan), 0.5 * (top_m + bottom_m))]))
            following.append(np.roll(corners[-1], -1, axis=0))
            half.append(np.full(len(plan), 0.5 * (bottom_m - top_m)))
        start = np.concatenate(corners)
        return cls(merged(meshes), start, np.concatenate(following) - start, np.concatenate(half))

    def walls(self, pos_ned_m: Array, rot_ned_frd: Array) -> Walls:
        """Return its upright sides at its present pose."""
        start = self.from_frd_m @ rot_ned_frd.T + pos_ned_m
        span = self.span_frd_m @ rot_ned_frd.T
        middle_m = start[:, 2] + 0.5 * span[:, 2]
        return Walls(start[:, :2], span[:, :2], middle_m - self.half_height_m, middle_m + self.half_height_m)


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """All constants of a run; made by `from_spec`."""

    batches: tuple[Simulation, ...]
    """One simulation per model, all with the same environment and waterway."""
    members: tuple[Numbers, ...]
    """For each batch, the numbers of its vessels in the order of its rows."""
    rows: tuple[tuple[int, int], ...]
    """For each vessel, its batch and its row in the batch."""
    names: tuple[str, ...]
    """Names of the vessels."""
    traffic: tuple[ScriptedVessel, ...]
    """The scripted vessels."""
    hulls: Hulls
    """Hulls of all vessels, batch by batch, then of the scripted vessels."""
    shapes: tuple[SeenHull, ...]
    """Visible shapes, in the order of `hulls`."""

    @classmethod
    def from_spec(
        cls,
        models: Sequence[VesselSpec],
        environment: Environment,
        dt_s: float,
        waterway: Waterway = OPEN_WATER,
        names: Sequence[str] = (),
        traffic: Sequence[ScriptedVessel] = (),
    ) -> Fleet:
        """Build a fleet from one model per vessel. Without names, the vessels' numbers are their names.

        Raises ValueError for no vessels, for a wrong number of names or equal names, and for the reasons of
        `Simulation.from_spec`.
        """
        names = tuple(names) or tuple(str(number) for number in range(len(models)))
        all_names = [*names, *(vessel.name for vessel in traffic)]
        if not models:
            raise ValueError("a fleet has no vessels; give at least one model")
        if len(names) != len(models) or len(set(all_names)) != len(all_names):
            raise ValueError(f"{len(models)} vessels are named {', '.join(all_names)}; give each a different name")
        if waterway is OPEN_WATER:  # other vessels can be hit even in open water
            waterway = Waterway(Capsules.joined(()))
        # Vessels of equal models share a batch.
        kinds: list[VesselSpec] = []
        batch = []
        for model in models:
            if model not in kinds:
                kinds.append(model)
            batch.append(kinds.index(model))
        members = tuple(np.flatnonzero(np.array(batch) == number) for number in range(len(kinds)))
        rows = [
            (number, int(np.count_nonzero(np.array(batch[:vessel]) == number))) for vessel, number in enumerate(batch)
        ]
        batches = tuple(Simulation.from_spec(kind, environment, dt_s, waterway) for kind in kinds)
        sequence = np.concatenate(members).tolist()
        seen = [SeenHull.of_model(kind) for kind in kinds]
        return cls(
            batches=batches,
            members=members,
            rows=tuple(rows),
            names=names,
            traffic=tuple(traffic),
            hulls=Hulls.from_outlines(
                [*(batches[batch[vessel]].outline for vessel in sequence), *(vessel.outline for vessel in traffic)],
                [*(names[vessel] for vessel in sequence), *(vessel.name for vessel in traffic)],
            ),
            shapes=(
                *(seen[batch[vessel]] for vessel in sequence),
                *(SeenHull.of_meshes([vessel.mesh]) for vessel in traffic),
            ),
        )

    def in_environment(self, environment: Environment) -> Fleet:
        """Return the same vessels in another environment of the same water."""
        return replace(self, batches=tuple(simulation.in_environment(environment) for simulation in self.batches))

    def over_bed(self, state: FleetState) -> Fleet:
        """Return the fleet over the bed below each vessel; this one if the bed is as deep as before everywhere."""
        pairs = zip(self.batches, state.batches, strict=True)
        batches = tuple(simulation.over_bed(batch) for simulation, batch in pairs)
        same = all(new is old for new, old in zip(batches, self.batches, strict=True))
        return self if same else replace(self, batches=batches)

    @property
    def why_numpy(self) -> str | None:
        """Reason why the steps of some vessels run in numpy, None if all run compiled."""
        return next((batch.why_numpy for batch in self.batches if batch.why_numpy), None)

    @property
    def environment(self) -> Environment:
        """Environment of all vessels."""
        return self.batches[0].environment

    @property
    def waterway(self) -> Waterway:
        """Waterway of all vessels."""
        return self.batches[0].waterway

    @property
    def dt_s(self) -> float:
        """Length of a step in s."""
        return self.batches[0].dt_s

    @property
    def dt_ns(self) -> int:
        """Length of a step in ns."""
        return self.batches[0].dt_ns

    def of(self, number: int) -> Simulation:
        """Return the simulation of a vessel's batch. It accepts the vessel's `state_of`."""
        return self.batches[self.rows[number][0]]

    def place_of(self, number: int) -> int:
        """Return the index of a vessel in `hulls` and `shapes`."""
        batch, row = self.rows[number]
        return sum(len(members) for members in self.members[:batch]) + row

    def by_model(self, commands: Sequence[Sequence[float]]) -> list[Array]:
        """Convert commands (C,) per vessel to the form of `step`: an array (N, C) per batch."""
        return [
            np.array([commands[vessel] for vessel in members.tolist()], dtype=np.float64) for members in self.members
        ]


@state_class
class FleetState:
    """The world at time_ns."""

    time_ns: int
    batches: tuple[SimulationState, ...]
    """States of the fleet's batches, with the contacts of their vessels."""
    environment: EnvironmentState
    """One draw for all vessels; the environment states in `batches` have one row too."""
    close: CloseHulls = NOBODY_CLOSE
    """Pairs of hulls that may touch."""

    @property
    def debris(self) -> DebrisState:
        """State of the drifting bodies."""
        return self.batches[0].afloat.debris


def initial(fleet: Fleet, north_east_m: Array, yaw_rad: Array, rng: Generator) -> FleetState:
    """Place vessels at rest at (M, 2) positions and (M,) headings, in order. Draw the environment once for all."""
    environment = surroundings_model.initial(fleet.environment, 1, rng)
    tide_m, batches = fleet.environment.tide.height_m(0.0), []
    for simulation, members in zip(fleet.batches, fleet.members, strict=True):
        vessel = vessel_motion.at_rest(simulation.vessel, north_east_m[members], yaw_rad[members], tide_m)
        batches.append(simulations.at_start(simulation, vessel, environment))
    return FleetState(0, tuple(batches), environment)


def step(fleet: Fleet, state: FleetState, commands: Sequence[Array], rng: Generator, max_steps: int = 1) -> FleetState:
    """Return the state one dt_s later, under (N, C) commands in [-1, 1] per batch, as `Fleet.by_model` makes them.

    max_steps: as in `simulation.step`.
    """
    lead, dt_ns = fleet.batches[0], fleet.dt_ns
    end_ns = state.time_ns + max_steps * dt_ns
    while state.time_ns < end_ns:
        # The environment, once for all vessels
        time_ns, environment = state.time_ns, state.environment
        if time_ns % lead.drift_ns == 0:
            environment = surroundings_model.step(fleet.environment, environment, lead.drift_ns * 1e-9, rng)
        # Contacts with structures, debris and other hulls
        close, afloat = _compute_contacts(fleet, state, environment)
        touching = len(close) > 0 or not all(part.idle for part in afloat)
        # Motion of the vessels until the next change
        until_ns = min(end_ns, time_ns - time_ns % lead.drift_ns + lead.drift_ns)
        if touching:
            until_ns = time_ns + dt_ns
        batches = [
            simulations.advance(simulation, batch, environment, command, water, until_ns)
            for simulation, batch, command, water in zip(fleet.batches, state.batches, commands, afloat, strict=True)
        ]
        state = FleetState(until_ns, tuple(batches), environment, close)
        if touching:
            break
    return state


def state_of(fleet: Fleet, state: FleetState, number: int, motion: Kinematics | None = None) -> SimulationState:
    """Return the world of one vessel: arrays of one row, with only this vessel's contacts.

    motion: the vessel's motion, if the caller has it already.
    """
    batch, row = fleet.rows[number]
    together, rows = state.batches[batch], slice(row, row + 1)
    if len(fleet.members[batch]) == 1:
        return together
    vessel, afloat = together.vessel, together.afloat
    half_change, battery = vessel.half_change, vessel.battery
    if battery is not None:
        battery = BatteryState(battery.used_as[rows], battery.voltage_v[rows], battery.current_a[rows])
    if len(afloat.contacts):
        wrench = None if afloat.wrench_frd is None else afloat.wrench_frd[rows]
        afloat = replace(afloat, contacts=contacts_of(fleet, state, number), wrench_frd=wrench)
    surface = together.surface
    return SimulationState(
        together.time_ns,
        VesselState(
            _row(vessel.motion, rows) if motion is None else motion,
            vessel.rotor_speed[rows],
            None if half_change is None else half_change[rows],
            battery=battery,
        ),
        together.environment,
        _own(together.current_ned_mps, rows),
        _own(together.wind_ned_mps, rows),
        together.drift_frd_n[rows],
        HullSurface(surface.point_elevation_m[rows], surface.over_hull[rows], surface.tide_m),
        afloat,
    )


def contacts_of(fleet: Fleet, state: FleetState, number: int) -> Contacts:
    """Return the contacts of one vessel."""
    batch, row = fleet.rows[number]
    contacts = state.batches[batch].contacts
    if not len(contacts) or len(fleet.members[batch]) == 1:
        return contacts
    own = np.flatnonzero(contacts.vessel == row)
    return contacts.rows(own, np.zeros(len(own), np.intp)) if len(own) else NO_CONTACTS


def kinematics_of(fleet: Fleet, state: FleetState, number: int) -> Kinematics:
    """Return the true motion of one vessel: arrays of one row."""
    batch, row = fleet.rows[number]
    motion = state.batches[batch].vessel.motion
    return motion if len(fleet.members[batch]) == 1 else _row(motion, slice(row, row + 1))


def launch(fleet: Fleet, state: FleetState, body: Launch) -> FleetState:
    """Add one drifting body now, regardless of its `at_ns`. Raises ValueError for an impossible length."""
    lead = fleet.batches[0]
    water = simulations.water_motion(lead, state.environment, state.time_ns)
    debris = waterways.launch_body(state.debris, body, water)
    batches = tuple(replace(batch, afloat=replace(batch.afloat, debris=debris)) for batch in state.batches)
    return replace(state, batches=batches)


def held(fleet: Fleet, state: FleetState, before: FleetState, numbers: Sequence[int]) -> FleetState:
    """Return `state` with the vessels of these numbers unchanged since `before`."""
    batches = list(state.batches)
    for batch in {fleet.rows[number][0] for number in numbers}:
        rows = [fleet.rows[number][1] for number in numbers if fleet.rows[number][0] == batch]
        now, then = batches[batch].vessel, before.batches[batch].vessel
        if len(rows) < len(fleet.members[batch]):
            then = _with_rows(now, then, rows)
        batches[batch] = replace(batches[batch], vessel=then)
    return replace(state, batches=tuple(batches))


def with_condition(fleet: Fleet, state: FleetState, number: int, condition: Condition | None) -> FleetState:
    """Return `state` with one vessel in this condition (N = 1) from now on; None for no fault."""
    batch, row = fleet.rows[number]
    batches = list(state.batches)
    vessel = vessel_motion.with_condition(fleet.batches[batch].vessel, batches[batch].vessel, condition, row)
    batches[batch] = replace(batches[batch], vessel=vessel)
    return replace(state, batches=tuple(batches))


def joined_motion(fleet: Fleet, state: FleetState) -> Kinematics:
    """Return the motion of all vessels, batch by batch, then of the scripted vessels: the order of `Fleet.hulls`."""
    motions = [batch.vessel.motion for batch in state.batches]
    if fleet.traffic:
        time_s = state.time_ns * 1e-9
        motions.append(scripted_motion(fleet.traffic, time_s, fleet.environment.tide.height_m(time_s)))
    if len(motions) == 1:
        return motions[0]
    return Kinematics(*(np.concatenate([getattr(motion, name) for motion in motions]) for name in _MOTION))


_MOTION = tuple(field.name for field in fields(Kinematics))


def drifting_bodies(fleet: Fleet, state: FleetState, but: int | None = None) -> Bodies:
    """Return drifting bodies and the hulls of all vessels, scripted ones too, without vessel `but`, for ray casting."""
    motion = joined_motion(fleet, state)
    others = _others(fleet, but)
    hulls = Bodies(
        tuple(fleet.shapes[number].mesh for number in others.tolist()),
        motion.pos_ned_m[others],
        motion.vel_ned_mps[others],
        motion.rot_ned_frd[others],
    )
    debris = simulations.drifting_bodies(state.batches[0])
    return hulls if not debris.meshes else debris.joined(hulls)


def hull_walls(fleet: Fleet, state: FleetState, but: int, within_m: float) -> Walls:
    """Return the hull sides of all vessels within a range of vessel `but`, without its own hull, for range sensors."""
    motion = joined_motion(fleet, state)
    others = _others(fleet, but)
    between = motion.pos_ned_m[others, :2] - motion.pos_ned_m[fleet.place_of(but), :2]
    near = np.vecdot(between, between) < (within_m + fleet.hulls.reach_m[others]) ** 2
    return Walls.of_parts(
        [
            fleet.shapes[number].walls(motion.pos_ned_m[number], motion.rot_ned_frd[number])
            for number in others[near].tolist()
        ]
    )


def names_of_others(fleet: Fleet, but: int) -> tuple[str, ...]:
    """Return the names of all vessels without vessel `but`, in the order of the hulls in `drifting_bodies`."""
    return tuple(fleet.hulls.names[number] for number in _others(fleet, but).tolist())


def _others(fleet: Fleet, but: int | None) -> Numbers:
    """Return the indices in `Fleet.hulls` of all vessels but one."""
    hulls = np.arange(len(fleet.shapes))
    return hulls if but is None else np.delete(hulls, fleet.place_of(but))


def _compute_contacts(
    fleet: Fleet, state: FleetState, environment: EnvironmentState
) -> tuple[CloseHulls, list[Afloat]]:
    """Return the close hulls, and the contacts of each batch."""
    lead, close = fleet.batches[0], state.close
    search = state.time_ns % lead.drift_ns == 0
    afloat = [batch.afloat for batch in state.batches]
    if not (search or len(close)) and all(part.idle for part in afloat):
        return close, afloat
    # Contacts with structures and debris
    motions = [batch.vessel.motion for batch in state.batches]
    afloat = waterways.step_together(
        fleet.waterway,
        [simulation.outline for simulation in fleet.batches],
        afloat,
        StepTimes(state.time_ns, lead.dt_ns, lead.drift_ns),
        motions,
        simulations.water_motion(lead, environment, state.time_ns),
    )
    if not (search or len(close)):
        return close, afloat
    # Contacts between hulls
    motion = joined_motion(fleet, state)
    if search:
        close = find_close_hulls(fleet.hulls, find_close_pairs(fleet.hulls, motion.pos_ned_m[:, :2]), motion)
        if not len(close):
            return close, afloat
    contacts = compute_hull_contacts(fleet.hulls, close, motion, lead.dt_s)
    if not len(contacts):
        return close, afloat
    # Add them to the contacts of each batch
    wrench = wrench_frd(motion, contacts.vessel, contacts.place_ned_m, contacts.force_ned_n)
    first = 0
    for batch, members in enumerate(fleet.members):
        rows = slice(first, first + len(members))
        numbers = np.flatnonzero((contacts.vessel >= rows.start) & (contacts.vessel < rows.stop))
        if len(numbers):
            own, others = contacts.rows(numbers, contacts.vessel[numbers] - first), afloat[batch]
            afloat[batch] = replace(
                others,
                contacts=joined_contacts([others.contacts, own]) if len(others.contacts) else own,
                wrench_frd=wrench[rows] if others.wrench_frd is None else others.wrench_frd + wrench[rows],
            )
        first = rows.stop
    return close, afloat


def _row(motion: Kinematics, rows: slice) -> Kinematics:
    return Kinematics(
        motion.pos_ned_m[rows],
        motion.vel_ned_mps[rows],
        motion.acc_ned_mps2[rows],
        motion.quat_ned_frd[rows],
        motion.rot_ned_frd[rows],
        motion.gyro_frd_radps[rows],
        motion.angular_acc_frd_radps2[rows],
    )


def _own(values: Array, rows: slice) -> Array:
    """Select rows of an array with one row per vessel; return an array with one row for all unchanged."""
    return values if len(values) == 1 else values[rows]


def _with_rows(now: VesselState, then: VesselState, rows: Sequence[int]) -> VesselState:
    """Return `now` with these rows from `then`. The latest changes of velocity come from `now`: they restart."""

    def mix(new: Array, old: Array) -> Array:
        mixed = new.copy()
        mixed[rows] = old[rows]
        return mixed

    motion = Kinematics(*(mix(getattr(now.motion, name), getattr(then.motion, name)) for name in _MOTION))
    battery = now.battery
    if battery is not None and then.battery is not None:
        battery = BatteryState(
            mix(battery.used_as, then.battery.used_as),
            mix(battery.voltage_v, then.battery.voltage_v),
            mix(battery.current_a, then.battery.current_a),
        )
    return VesselState(motion, mix(now.rotor_speed, then.rotor_speed), now.half_change, now.condition, battery)
