"""The model of the boat over one interval, in variants that differ in one value each, as a batch in the kernel.

Row 0 has the estimated values. Each other row differs in one state or one parameter, so that the differences of the
results are the derivatives of the motion. Drag changes the model itself, so its variant is a batch of one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.environment.waves import StillHull
from sim_core.frames import Array, matrix_to_euler, wrap_pi
from sim_core.kinematics import Kinematics
from sim_core.motion import Influences, MotionStep, surroundings
from sim_core.vessel.battery import BatteryCondition
from sim_core.vessel.condition import Condition
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.vessel import Vessel, VesselState, accelerate, at_rest, with_half_change

MOTION = 6
"""Columns of a motion: velocity north and east, heading, yaw rate, displacement north and east."""
PREDICTED = 2 * MOTION
"""Columns of a prediction: the motion at the end of the interval, and its mean over the interval."""
DRAG_STEP = 0.25
_STATE_STEPS = (0.05, 0.05, 0.02, 0.02)
_THRUST_STEP, _CURRENT_STEP, _WIND_STEP = 0.1, 0.05, 1.0
_STEPS_S = (0.02, 0.01, 0.005, 0.0025)


@dataclass(frozen=True, slots=True, eq=False)
class ModelErrors:
    """Estimated differences between boat and model."""

    thrust_share: Array
    """Share of the modelled thrust of each propeller, (P,)."""
    drag_share: float
    """Share of the modelled drag ahead."""
    current_ne_mps: Array
    """(2,)."""
    wind_ne_mps: Array
    """Velocity of the air, (2,)."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearPrediction:
    """The motion in an interval, and its derivatives."""

    motion: Array
    """(12,), see PREDICTED."""
    by_state: Array
    """(12, 4) by velocity north and east, heading, yaw rate."""
    by_thrust: Array
    """(12, P)."""
    by_drag: Array
    """(12,)."""
    by_current: Array
    """(12, 2)."""
    by_wind: Array
    """(12, 2)."""


class ModelBank:
    """The model of one vehicle in flat water."""

    def __init__(self, vehicle: VesselSpec, water: Water) -> None:
        """Raises ValueError if the vessel does not float, or needs steps below 2.5 ms."""
        self.vessel, self.dt_s = _steppable(vehicle, water)
        still = StillHull(len(self.vessel.buoyancy.points_frd_m))
        self.step = MotionStep(self.vessel, still)
        self._still = still
        fouled = Vessel.from_spec(with_drag(vehicle, 1.0 + DRAG_STEP), water, self.dt_s)
        self._fouled = MotionStep(fouled, still)
        self._propellers = len(vehicle.propellers)
        self._rotor_speed = np.zeros((1, vehicle.commands))

    @property
    def rotor_speed(self) -> Array:
        """State of the actuators at the end of the last interval, (1, C)."""
        return self._rotor_speed

    def predict(self, state: Array, parameters: ModelErrors, commands: Array) -> LinearPrediction:
        """Return the motion after one step for each of the (S, C) commands, from the (4,) state."""
        thrusters = self._propellers
        rows = 1 + len(_STATE_STEPS) + thrusters + 4
        states = np.tile(state, (rows, 1))
        states[1:5] += np.diag(_STATE_STEPS)
        thrust = np.tile(parameters.thrust_share, (rows, 1))
        thrust[5 : 5 + thrusters] += _THRUST_STEP * np.eye(thrusters)
        current = np.tile(parameters.current_ne_mps, (rows, 1))
        current[5 + thrusters : 7 + thrusters] += _CURRENT_STEP * np.eye(2)
        wind = np.tile(parameters.wind_ne_mps, (rows, 1))
        wind[7 + thrusters :] += _WIND_STEP * np.eye(2)
        ends, after = self._run(self.step, states, thrust, current, wind, commands)
        fouled, _ = self._run(self._fouled, states[:1], thrust[:1], current[:1], wind[:1], commands)
        by_drag = _difference(fouled, ends[0])[0] / DRAG_STEP
        self._rotor_speed = after.rotor_speed[:1].copy()
        slopes = _difference(ends[1:], ends[0]).T
        return LinearPrediction(
            motion=ends[0] + (parameters.drag_share - 1.0) * by_drag,
            by_state=slopes[:, :4] / np.array(_STATE_STEPS),
            by_thrust=slopes[:, 4 : 4 + thrusters] / _THRUST_STEP,
            by_drag=by_drag,
            by_current=slopes[:, 4 + thrusters : 6 + thrusters] / _CURRENT_STEP,
            by_wind=slopes[:, 6 + thrusters :] / _WIND_STEP,
        )

    def acceleration_at_full_thrust(self) -> Array:
        """Return the (P, 2) accelerations ahead and in yaw of each propeller at full speed, from rest."""
        count = self._propellers
        speeds = np.zeros((count + 1, self.vessel.model.commands))
        speeds[:count, :count] = np.eye(count)
        motion = at_rest(self.vessel, np.zeros((count + 1, 2)), np.zeros(count + 1)).motion
        none = np.zeros((count + 1, 3))
        around = surroundings(self.vessel, self._still, motion, influences(none, none, speeds))
        acceleration = accelerate(self.vessel, motion, speeds, around)
        of_thrust: Array = (acceleration[:count] - acceleration[count])[:, (0, 5)]
        return of_thrust

    def start(self, states: Array, thrust_share: Array) -> VesselState:
        """Return vessels at the origin with (N, 4) velocity north and east, heading and yaw rate."""
        count = len(states)
        rest = at_rest(self.vessel, np.zeros((count, 2)), states[:, 2])
        velocity, gyro = np.zeros((count, 3)), np.zeros((count, 3))
        velocity[:, :2], gyro[:, 2] = states[:, :2], states[:, 3]
        motion = replace(rest.motion, vel_ned_mps=velocity, gyro_frd_radps=gyro)
        commands = self.vessel.model.commands
        battery = BatteryCondition(np.zeros(count), np.ones(count), np.zeros(count))
        condition = Condition(np.ones((count, commands)), np.full((count, commands), np.nan), thrust_share, battery)
        return VesselState(motion, np.tile(self._rotor_speed, (count, 1)), None, condition, rest.battery)

    def _run(
        self, step: MotionStep, states: Array, thrust: Array, current: Array, wind: Array, commands: Array
    ) -> tuple[Array, VesselState]:
        current, wind = _with_zero_down(current), _with_zero_down(wind)
        before = self.start(states, thrust)
        first = influences(current, wind, commands[:1])
        around = surroundings(step.vessel, self._still, before.motion, first)
        state = with_half_change(step.vessel, before, around)
        velocity, rate, turned, place = (np.zeros((len(states), columns)) for columns in (3, 3, 3, 3))
        for number in range(len(commands)):
            state = step.step(state, influences(current, wind, commands[number : number + 1])).vessel
            velocity += state.motion.vel_ned_mps
            rate += state.motion.gyro_frd_radps
            turned += rate
            place += state.motion.pos_ned_m
        yaw = states[:, 2:3] + self.dt_s / len(commands) * turned[:, 2:]
        sums = (velocity[:, :2], rate[:, 2:], place[:, :2])
        velocity, rate, place = (total / len(commands) for total in sums)
        return np.concatenate((motion_of(state.motion), velocity, yaw, rate, place), axis=1), state


def influences(current_ned_mps: Array, wind_ned_mps: Array, command: Array) -> Influences:
    """Return flat water with (N, 3) currents, and (N, 3) winds."""
    return Influences(0.0, 0.0, current_ned_mps, wind_ned_mps, np.zeros((len(current_ned_mps), 2)), command, None)


def motion_of(motion: Kinematics) -> Array:
    """Return (N, 6), see MOTION."""
    yaw = matrix_to_euler(motion.rot_ned_frd)[:, 2:]
    return np.concatenate(
        (motion.vel_ned_mps[:, :2], yaw, motion.gyro_frd_radps[:, 2:], motion.pos_ned_m[:, :2]), axis=1
    )


def with_drag(vehicle: VesselSpec, share: float) -> VesselSpec:
    """Return the vehicle with a share of its drag ahead: all its dampings of surge by surge."""
    matrix = vehicle.damping_linear_matrix
    if matrix is not None:
        matrix = ((share * matrix[0][0], *matrix[0][1:]), *matrix[1:])
    derivatives = {
        name: value * (share if name.startswith("X_") and set(name[2:]) <= set("u|") else 1.0)
        for name, value in vehicle.derivatives.items()
    }
    linear, quadratic = vehicle.damping_linear, vehicle.damping_quadratic
    return replace(
        vehicle,
        damping_linear=replace(linear, surge=share * linear.surge),
        damping_quadratic=replace(quadratic, surge=share * quadratic.surge),
        damping_linear_matrix=matrix,
        derivatives=derivatives,
    )


def _steppable(vehicle: VesselSpec, water: Water) -> tuple[Vessel, float]:
    for dt_s in _STEPS_S[:-1]:
        try:
            return Vessel.from_spec(vehicle, water, dt_s), dt_s
        except ValueError:
            continue
    return Vessel.from_spec(vehicle, water, _STEPS_S[-1]), _STEPS_S[-1]


def _with_zero_down(horizontal: Array) -> Array:
    vector = np.zeros((len(horizontal), 3))
    vector[:, :2] = horizontal
    return vector


def _difference(ends: Array, reference: Array) -> Array:
    """Return (N, 12) differences from (12,)."""
    difference = ends - reference
    difference[:, (2, MOTION + 2)] = wrap_pi(difference[:, (2, MOTION + 2)])
    return difference
