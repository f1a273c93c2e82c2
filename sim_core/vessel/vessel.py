"""The vessel's motion: forces, acceleration, one step of the rigid body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.environment.waves import FLAT_WATER, FeltWaves, FlatWater, HullSurface, StillHull, WaveField
from sim_core.frames import Array, ComplexArray, euler_to_quat, quat_to_matrix
from sim_core.kinematics import Kinematics
from sim_core.state_class import state_class
from sim_core.vessel.battery import Battery, BatteryState
from sim_core.vessel.buoyancy import Buoyancy, make_buoyancy, wave_shares
from sim_core.vessel.condition import Condition, healthy, with_row
from sim_core.vessel.confined_water import confined_water
from sim_core.vessel.floating import FloatingPose, floating_pose
from sim_core.vessel.hydrodynamics import Hydrodynamics, at_table, centre_of_lateral_resistance
from sim_core.vessel.mean_drift import DriftTable, MeanDrift, NoDrift, closed_form_drift
from sim_core.vessel.panel_tables import panel_tables_of
from sim_core.vessel.propulsion import ExtendedPropulsion, OwnPropulsion, make_propulsion
from sim_core.vessel.seakeeping import (
    DIRECTIONS,
    Seakeeping,
    SmallWaves,
    between,
    linear_response,
    more_points,
    point_sources,
)
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.step_length import check_step_length, small_motions
from sim_core.vessel.wave_forces import FLAT, NoWaveForces, WaveForces
from sim_core.vessel.windage import WindDrag

# Rows: outer(q, (p, q, r)); q' = 1/2 q * (0, p, q, r), Fossen 2021, eq 2.78.
_HALF_RATES = 0.5 * np.array(
    [
        [[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        [[-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -1, 0]],
        [[0, 0, 0, -1], [-1, 0, 0, 0], [0, 1, 0, 0]],
        [[0, 0, 1, 0], [0, -1, 0, 0], [-1, 0, 0, 0]],
    ]
).reshape(12, 4)


@state_class
class VesselState:
    """State of N vessels."""

    motion: Kinematics
    rotor_speed: Array
    """State of the actuators, (N, C) in the order of the commands: fraction of full speed of each propeller, negative
    in reverse, then fraction of full angle of each gear and rudder, then the states of added actuators.
    """
    half_change: Array | None = None
    """Half of the last step's change of the velocities by water, air and propellers, (N, 6): linear NED, then angular
    in body axes. None before the first step.
    """
    condition: Condition | None = None
    """Faults of actuators and battery, None for no fault."""
    battery: BatteryState | None = None
    """None for a model without a battery."""
    packed: PackedState | None = None
    """The same arrays as parts of one, if a compiled step made them."""


@state_class
class PackedState:
    """The state of N vessels in the columns of one array, which a compiled step reads and writes at once."""

    values: Array
    """(N, columns)."""
    address: int
    """Place of `values` in memory."""
    motion: Kinematics
    rotor_speed: Array
    half_change: Array
    battery: BatteryState | None

    def __reduce__(self) -> tuple[type[None], tuple[()]]:
        """Leave it out of copies and pickles, where its address would be wrong."""
        return type(None), ()

    def holds(self, state: VesselState) -> bool:
        """Return whether the parts of a state are those that lie in `values`."""
        return (
            state.motion is self.motion
            and state.rotor_speed is self.rotor_speed
            and state.half_change is self.half_change
            and state.battery is self.battery
        )


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Surroundings of N vessels."""

    water_ned_mps: Array
    """Velocity of the water, waves included, (N, 3)."""
    wind_ned_mps: Array
    """Velocity of the air, (N, 3)."""
    surface: HullSurface
    """The water surface under the hulls."""
    drift_frd_n: Array
    """Mean force of the waves, forward and right, (N, 2)."""


@dataclass(frozen=True, slots=True, eq=False)
class Vessel:
    """A vessel model prepared for one water and one step length."""

    model: VesselSpec
    dt_s: float
    hydrodynamics: Hydrodynamics
    buoyancy: Buoyancy
    propulsion: OwnPropulsion | ExtendedPropulsion
    battery: Battery | None
    windage: WindDrag
    wave_forces: WaveForces | NoWaveForces
    acceleration_per_term: Array  # (terms, 6), in the order of `accelerate`
    rest: FloatingPose
    level_m: float
    seakeeping: Seakeeping | None = None
    """Response to waves; None for a vessel that has been in flat water only."""

    @classmethod
    def from_spec(
        cls, model: VesselSpec, water: Water, dt_s: float, waves: WaveField | FlatWater = FLAT_WATER
    ) -> Vessel:
        """Compute the matrices of all parts.

        Raises SpecificationError if the vessel does not float upright, ValueError if dt_s is too long for it.
        """
        buoyancy = make_buoyancy(model, water)
        rest = floating_pose(model, water, buoyancy)
        panel_tables_of(model, rest.depth_m)  # its errors come before the first wave
        confined = confined_water(model, water.depth_m, rest)
        hydrodynamics = Hydrodynamics.from_spec(model, water.density_kgpm3, rest.draft_m, confined)
        vessel = cls(
            model=model,
            dt_s=dt_s,
            hydrodynamics=hydrodynamics,
            buoyancy=buoyancy,
            propulsion=make_propulsion(model, water, dt_s, at_table(centre_of_lateral_resistance(model, rest.draft_m))),
            battery=Battery.from_spec(model, dt_s),
            windage=WindDrag.from_spec(model, -rest.depth_m),
            wave_forces=FLAT,
            acceleration_per_term=np.zeros((0, 6)),
            rest=rest,
            level_m=water.level_m,
        )._with_forces(FLAT)
        check_step_length(lambda states: _acceleration_off_rest(vessel, states), dt_s)
        return vessel.in_waves(waves, water)

    def over_bottom(self, water: Water, depth_m: float) -> Vessel:
        """Return the same vessel in the same water over a bottom at another depth. Its waves stay those of before."""
        confined = confined_water(self.model, depth_m, self.rest)
        hydrodynamics = Hydrodynamics.from_spec(self.model, water.density_kgpm3, self.rest.draft_m, confined)
        return replace(self, hydrodynamics=hydrodynamics)._with_forces(self.wave_forces)

    def in_waves(self, waves: WaveField | FlatWater, water: Water) -> Vessel:
        """Return the same vessel in another sea of the same water."""
        if not isinstance(waves, WaveField):
            return self._with_forces(FLAT)
        seakeeping = self.seakeeping or _seakeeping(self, water)
        damping, quadratic = self.hydrodynamics.linear_damping, self.model.damping_quadratic
        drift = MeanDrift.from_table(seakeeping.drift, waves, seakeeping.felt(waves), damping, quadratic)
        return replace(self._in_any_waves(drift, seakeeping.sources is not None), seakeeping=seakeeping)

    def _in_any_waves(self, drift: MeanDrift | NoDrift, panel: bool) -> Vessel:
        return self._with_forces(
            WaveForces.from_parts(self.hydrodynamics, self.buoyancy, self.rest.depth_m, drift, panel)
        )

    def _with_forces(self, wave_forces: WaveForces | NoWaveForces) -> Vessel:
        hydrodynamics = self.hydrodynamics
        per_term = [hydrodynamics.wrench, self.buoyancy.wrench, self.propulsion.wrench, self.windage.wrench]
        per_term += [self.model.mass_kg * GRAVITY_MPS2 * hydrodynamics.weight_per_n, wave_forces.wrench]
        acceleration_per_term = np.concatenate(per_term) @ hydrodynamics.inverse_mass
        return replace(self, wave_forces=wave_forces, acceleration_per_term=acceleration_per_term)


def at_rest(vessel: Vessel, north_east_m: Array, yaw_rad: Array, tide_m: float = 0.0) -> VesselState:
    """Return vessels afloat at (N, 2) positions and (N,) headings with their still-water heel and trim, engines
    stopped. tide_m: height of the still water above its mean level.
    """
    vessels = len(north_east_m)
    pos_ned_m = np.empty((vessels, 3))
    pos_ned_m[:, :2] = north_east_m
    pos_ned_m[:, 2] = vessel.rest.depth_m - (vessel.level_m + tide_m)
    euler_rad = np.empty((vessels, 3))
    euler_rad[:, :2] = vessel.rest.heel_rad, vessel.rest.trim_rad
    euler_rad[:, 2] = yaw_rad
    quat = euler_to_quat(euler_rad)
    zero = np.zeros((vessels, 3))
    motion = Kinematics(pos_ned_m, zero, zero, quat, quat_to_matrix(quat), zero, zero)
    battery = None if vessel.battery is None else vessel.battery.initial(vessels)
    return VesselState(motion, np.zeros((vessels, vessel.model.commands)), battery=battery)


def step(
    vessel: Vessel, state: VesselState, command: Array, around: Surroundings, wrench_frd: Array | None = None
) -> VesselState:
    """Advance one step under (N, C) commands in [-1, 1]. wrench_frd: (N, 6) external force and moment, in body axes."""
    # Change of the velocities by water, air and propellers (Adams and Bashforth), and by external forces
    motion, dt_s, condition = state.motion, vessel.dt_s, state.condition
    thrust_share = None if condition is None else condition.thrust_share
    half_change = _change(motion, accelerate(vessel, motion, state.rotor_speed, around, thrust_share), 0.5 * dt_s)
    change = 3.0 * half_change
    change -= half_change if state.half_change is None else state.half_change
    if wrench_frd is not None:
        change += _change(motion, wrench_frd @ vessel.hydrodynamics.inverse_mass, dt_s)
    # Battery, actuators, and the pose
    battery, command = _drive(vessel, state, command)
    rotor_speed = vessel.propulsion.spin(state.rotor_speed, command)
    return VesselState(advance(motion, change, half_change, dt_s), rotor_speed, half_change, condition, battery)


def with_half_change(vessel: Vessel, state: VesselState, around: Surroundings) -> VesselState:
    """Return vessels in their first step as vessels that already had this acceleration before: see `half_change`.

    They can then take their first step in a batch with vessels that are underway.
    """
    acceleration = accelerate(vessel, state.motion, state.rotor_speed, around)
    return replace(state, half_change=_change(state.motion, acceleration, 0.5 * vessel.dt_s))


def _drive(vessel: Vessel, state: VesselState, command: Array) -> tuple[BatteryState | None, Array]:
    """Return the battery one step later, and the actuators' effective (N, C) commands."""
    condition, battery = state.condition, state.battery
    if condition is not None:
        command = condition.actual(np.clip(command, -1.0, 1.0))
    if vessel.battery is None or battery is None:
        return battery, command
    propellers = len(vessel.model.propellers)
    of_battery = None if condition is None else condition.battery
    battery, left = vessel.battery.step(battery, state.rotor_speed[:, :propellers], of_battery)
    if condition is not None:
        command[:, :propellers] *= left  # not the caller's array: `actual` made a new one
    return battery, command


def with_condition(vessel: Vessel, state: VesselState, condition: Condition | None, row: int = 0) -> VesselState:
    """Return the same vessels with `row` in this condition (N = 1) from now on; None for no fault."""
    vessels = len(state.rotor_speed)
    if vessels == 1:
        return replace(state, condition=condition)
    of_all = healthy(vessel.model, vessels) if state.condition is None else state.condition
    return replace(state, condition=with_row(of_all, row, condition or healthy(vessel.model, 1)))


def accelerate(
    vessel: Vessel, motion: Kinematics, rotor_speed: Array, around: Surroundings, thrust_share: Array | None = None
) -> Array:
    """Return the (N, 6) acceleration against NED and angular acceleration, both in body axes.

    thrust_share: (N, P) share of each thrust that a fault leaves.

    Every force is linear in some terms. All terms, concatenated, times one constant matrix give the acceleration.
    """
    # Velocities relative to water and air, and the slope of the surface, in body axes
    surface = around.surface
    ned = np.empty_like(motion.rot_ned_frd)
    np.subtract(motion.vel_ned_mps, around.water_ned_mps, out=ned[:, 0])
    np.subtract(motion.vel_ned_mps, around.wind_ned_mps, out=ned[:, 1])
    ned[:, 2] = surface.gradient_ned
    frd = ned @ motion.rot_ned_frd  # row vectors: v @ R is R^T v
    nu_r = np.concatenate((frd[:, 0], motion.gyro_frd_radps - surface.turn_frd_radps), axis=1)
    down_frd = motion.rot_ned_frd[:, 2]

    # Terms of all forces
    terms = (
        *vessel.hydrodynamics.terms(nu_r),
        *vessel.buoyancy.terms(motion.pos_ned_m, down_frd, -down_frd, surface),
        *vessel.propulsion.terms(rotor_speed, nu_r, frd[:, 1], thrust_share),
        *vessel.windage.terms(frd[:, 1]),
        down_frd,
        *vessel.wave_forces.terms(ned[:, 0, 2:], down_frd, frd[:, 2], surface, around.drift_frd_n),
    )
    acceleration: Array = np.concatenate(terms, axis=1).dot(vessel.acceleration_per_term)
    return acceleration


def _acceleration_off_rest(vessel: Vessel, states: Array) -> Array:
    """Return (K, 6) in body axes in still water and air, for (K, 9) of depth, roll, pitch and velocities off rest."""
    count = len(states)
    rest = at_rest(vessel, np.zeros((count, 2)), np.zeros(count)).motion
    tilt = np.zeros((count, 3))
    tilt[:, :2] = states[:, 1:3]
    rot = rest.rot_ned_frd @ quat_to_matrix(euler_to_quat(tilt))
    pos_ned_m = rest.pos_ned_m + states[:, :1] * np.array([0.0, 0.0, 1.0])
    zero = np.zeros((count, 3))
    velocity = np.vecdot(rot, states[:, None, 3:6])
    motion = Kinematics(pos_ned_m, velocity, zero, rest.quat_ned_frd, rot, states[:, 6:], zero)
    surface = StillHull(len(vessel.buoyancy.points_frd_m)).sample(0.0, pos_ned_m, rot)
    around = Surroundings(zero, zero, surface, np.zeros((count, 2)))
    return accelerate(vessel, motion, np.zeros((count, vessel.model.commands)), around)


def _seakeeping(vessel: Vessel, water: Water) -> Seakeeping:
    """Return the response to waves, by differences of the accelerations about rest."""
    model, rest, hydrodynamics = vessel.model, vessel.rest, vessel.hydrodynamics
    tables = panel_tables_of(model, rest.depth_m)
    # Grid: that of the tables, or from waves of 125 lengths to waves of a 24th of the length
    omega = np.sqrt(np.geomspace(0.05, 150.0, 56) * GRAVITY_MPS2 / model.length_m)
    direction = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    if tables is not None:
        omega, direction = tables.omega_radps, tables.direction_rad
    vertical, horizontal = wave_shares(model, rest.depth_m, omega**2 / GRAVITY_MPS2)
    # The response
    still, in_waves = vessel._with_forces(FLAT), vessel._in_any_waves(NoDrift(), False)
    mass = hydrodynamics.rigid_mass + hydrodynamics.added_mass
    response = linear_response(
        omega,
        direction,
        small_motions(lambda states: _acceleration_off_rest(still, states)),
        [
            _small_waves(in_waves, radps, direction, *shares)
            for radps, *shares in zip(omega.tolist(), vertical.tolist(), horizontal.tolist(), strict=True)
        ],
        mass,
        hydrodynamics.rigid_mass,
        tables,
    )
    # What the strips leave out, and the drift
    sources, source_radps, more = None, omega, np.zeros((0, 3))
    if tables is not None:
        force = tables.mean_drift
        more = more_points(model.midship_frd_x_m, model.length_m, model.width_m)
        points, source_radps = np.concatenate([vessel.buoyancy.points_frd_m, more]), between(omega)
        sources = point_sources(response, source_radps, points) @ mass.T
    else:
        weight_npm3 = water.density_kgpm3 * GRAVITY_MPS2
        force = closed_form_drift(model, rest.depth_m, weight_npm3, omega, direction)
    power_w = 0.5 * np.abs(response.relative) ** 2 @ np.diag(hydrodynamics.linear_damping)[2:5]
    drift = DriftTable(omega, direction, force, power_w)
    return Seakeeping(omega, vertical, horizontal, source_radps, sources, more, drift, response)


def _small_waves(
    vessel: Vessel, omega_radps: float, direction_rad: Array, vertical: float, horizontal: float
) -> SmallWaves:
    """Return what waves that go north do to vessels on headings with the (D,) directions off the bow."""
    amplitude_m, wave_number = 1e-4, omega_radps**2 / GRAVITY_MPS2
    one = np.ones(1)
    waves = WaveField(amplitude_m * one, omega_radps * one, np.array([[wave_number, 0.0]]), 0.0 * one)
    hulls = vessel.buoyancy
    sampler = waves.at_hull(hulls.points_frd_m, hulls.point_share, FeltWaves(vertical * one, horizontal * one))
    # Four phases of the waves at the origin, a quarter of a wave apart
    phase, heading = np.repeat(np.arange(4) * (0.5 * np.pi), len(direction_rad)), np.tile(-direction_rad, 4)
    places = np.column_stack([phase / wave_number, 0.0 * phase])
    motion = at_rest(vessel, places, heading).motion
    surface = sampler.sample(0.0, motion.pos_ned_m, motion.rot_ned_frd)
    still = np.zeros_like(motion.vel_ned_mps)
    around = Surroundings(surface.orbital_ned_mps, still, surface, still[:, :2])
    acceleration = accelerate(vessel, motion, np.zeros((len(phase), vessel.model.commands)), around)
    water = np.column_stack([surface.orbital_ned_mps[:, 2], surface.turn_frd_radps[:, :2]])

    def complex_amplitude(values: Array) -> ComplexArray:  # of Re(A exp(i phase))
        parts = values.reshape(4, len(direction_rad), -1) / (2.0 * amplitude_m)
        amplitude: ComplexArray = parts[0] - parts[2] - 1j * (parts[1] - parts[3])
        return amplitude

    return SmallWaves(complex_amplitude(acceleration), complex_amplitude(water))


def advance(motion: Kinematics, change: Array, half_change: Array, dt_s: float) -> Kinematics:
    """Advance one step with velocities changed by (N, 6), linear NED, then angular in body axes.

    The method is leap-frog, of order 2. The pose uses the velocities at half a step. The velocities at the step's end
    differ from them by half_change, which is the part due to water, air and propellers. For smooth forces, `change` is
    Adams and Bashforth's 3/2 and -1/2 of two steps. Only `change` contains the effect of contacts. It moves the pose at
    once, as a stiff spring requires.

    The result's accelerations belong to this step: its velocity is the old one plus dt_s times them.
    """
    vel_ned_mps = motion.vel_ned_mps + change[:, :3]
    gyro = motion.gyro_frd_radps + change[:, 3:]
    pos_ned_m = motion.pos_ned_m + dt_s * (vel_ned_mps - half_change[:, :3])
    turn = (gyro - half_change[:, 3:]) * dt_s
    old = motion.quat_ned_frd
    quat = old + (old[:, :, None] * turn[:, None, :]).reshape(-1, 12).dot(_HALF_RATES)
    quat /= np.sqrt(np.vecdot(quat, quat))[:, None]
    mean = change * (1.0 / dt_s)
    return Kinematics(pos_ned_m, vel_ned_mps, mean[:, :3], quat, quat_to_matrix(quat), gyro, mean[:, 3:])


def _change(motion: Kinematics, acceleration_frd: Array, time_s: float) -> Array:
    """Return the (N, 6) change of the velocities under (N, 6) accelerations in body axes. Overwrites its input."""
    acceleration_frd[:, :3] = np.vecdot(motion.rot_ned_frd, acceleration_frd[:, None, :3])
    acceleration_frd *= time_s
    return acceleration_frd
