"""Control (LC): heading through turn rate to a steering demand, speed over ground to a thrust demand.

Structure and parameter names are those of ArduRover. A proportional heading loop commands a turn rate PID with
feed-forward. A speed PI has a feed-forward from CRUISE_SPEED and CRUISE_THROTTLE. Demands are parts of full steering
and full thrust.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.fcu.control.controller import Demand, Order
from agent.fcu.control.guidance import wrap_angle
from agent.fcu.parameters import Parameters
from agent.navigation.measurements import StateEstimate


class SteeringGains(NamedTuple):
    """Parameters of the heading and turn rate loops, in radians."""

    angle_p: float
    rate_max_radps: float
    acceleration_max_radps2: float
    p: float
    i: float
    d: float
    feed_forward: float
    integral_max: float
    derivative_hz: float

    @classmethod
    def from_parameters(cls, p: Parameters) -> SteeringGains:
        """Read the gains from the parameters."""
        return cls(
            angle_p=p["ATC_STR_ANG_P"],
            rate_max_radps=math.radians(p["ATC_STR_RAT_MAX"]),
            acceleration_max_radps2=math.radians(p["ATC_STR_ACC_MAX"]),
            p=p["ATC_STR_RAT_P"],
            i=p["ATC_STR_RAT_I"],
            d=p["ATC_STR_RAT_D"],
            feed_forward=p["ATC_STR_RAT_FF"],
            integral_max=p["ATC_STR_RAT_IMAX"],
            derivative_hz=p["ATC_STR_RAT_FLTD"],
        )


class SpeedGains(NamedTuple):
    """Parameters of the speed loop."""

    p: float
    i: float
    integral_max: float
    acceleration_max_mps2: float
    deceleration_max_mps2: float
    cruise_speed_mps: float
    cruise_thrust: float

    @classmethod
    def from_parameters(cls, p: Parameters) -> SpeedGains:
        """Read the gains from the parameters."""
        return cls(
            p=p["ATC_SPEED_P"],
            i=p["ATC_SPEED_I"],
            integral_max=p["ATC_SPEED_IMAX"],
            acceleration_max_mps2=p["ATC_ACCEL_MAX"],
            deceleration_max_mps2=p["ATC_DECEL_MAX"],
            cruise_speed_mps=p["CRUISE_SPEED"],
            cruise_thrust=p["CRUISE_THROTTLE"] / 100.0,
        )


class SteeringState(NamedTuple):
    """State of the turn rate loop."""

    desired_rate_radps: float = 0.0
    integral: float = 0.0
    last_rate_radps: float = 0.0
    derivative_radps2: float = 0.0


class SpeedState(NamedTuple):
    """State of the speed loop. The desired speed starts at the measured one."""

    desired_mps: float
    integral: float = 0.0


def heading_rate_radps(gains: SteeringGains, heading_rad: float, yaw_rad: float) -> float:
    """Return the turn rate for a heading error, before the limits of `turn_rate_control`."""
    return gains.angle_p * wrap_angle(heading_rad - yaw_rad)


def turn_rate_control(
    gains: SteeringGains, state: SteeringState, wanted_radps: float, rate_radps: float, limited: bool, dt_s: float
) -> tuple[SteeringState, float]:
    """Return the steering demand in [-1, 1], positive to starboard, for a turn rate.

    limited: whether the last demand could not be achieved. The integral then only decreases.
    """
    desired = _clamped(wanted_radps, gains.rate_max_radps)
    if gains.acceleration_max_radps2 > 0.0:
        change = _clamped(desired - state.desired_rate_radps, gains.acceleration_max_radps2 * dt_s)
        desired = state.desired_rate_radps + change
    error = desired - rate_radps
    smoothing = dt_s / (dt_s + 1.0 / (2.0 * math.pi * gains.derivative_hz))
    raw_derivative = (rate_radps - state.last_rate_radps) / dt_s
    derivative = state.derivative_radps2 + smoothing * (raw_derivative - state.derivative_radps2)
    direct = gains.feed_forward * desired + gains.p * error - gains.d * derivative
    integral = _integrated(state.integral, gains.i * error * dt_s, gains.integral_max, limited)
    return SteeringState(desired, integral, rate_radps, derivative), _clamped(direct + integral, 1.0)


def speed_control(
    gains: SpeedGains, state: SpeedState, target_mps: float, speed_mps: float, limited: bool, dt_s: float
) -> tuple[SpeedState, float]:
    """Return the thrust demand in [-1, 1] for `target_mps` over ground.

    limited: as for `turn_rate_control`.

    The feed-forward grows with the square of the speed, like a hull's drag. ArduRover's is linear. Both are equal at
    CRUISE_SPEED.
    """
    desired = min(target_mps, state.desired_mps + gains.acceleration_max_mps2 * dt_s)
    desired = max(desired, state.desired_mps - gains.deceleration_max_mps2 * dt_s)
    ratio = desired / gains.cruise_speed_mps
    error = desired - speed_mps
    ramping = desired != target_mps  # the error then is due to the vessel's inertia, which must not be integrated
    integral = state.integral
    if not ramping:
        integral = _integrated(integral, gains.i * error * dt_s, gains.integral_max, limited)
    demand = gains.cruise_thrust * ratio * abs(ratio) + gains.p * error + integral
    return SpeedState(desired, integral), _clamped(demand, 1.0)


def ground_speed_mps(yaw_rad: float, vel_north_mps: float, vel_east_mps: float) -> float:
    """Speed over ground, negative astern.

    With way on it is the length of the velocity, so that a crabbing vessel makes good the commanded speed. Near
    standstill it blends into the forward speed, because thrust cannot oppose a drift to the side.
    """
    forward = vel_north_mps * math.cos(yaw_rad) + vel_east_mps * math.sin(yaw_rad)
    length = math.hypot(vel_north_mps, vel_east_mps)
    sideways2 = length * length - forward * forward
    return forward + sideways2 / (length + max(forward, 0.5)) if length > 0.0 else 0.0


def _integrated(integral: float, change: float, limit: float, limited: bool) -> float:
    if limited and integral * change >= 0.0:
        return _clamped(integral, limit)
    return _clamped(integral + change, limit)


def _clamped(value: float, limit: float) -> float:
    return limit if value > limit else -limit if value < -limit else value


class HeadingSpeedController:
    """Built-in Controller: heading, turn rate and speed loops with their state."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.configure()
        self.restart()

    def configure(self) -> None:
        """Apply changed parameters."""
        self._steering_gains = SteeringGains.from_parameters(self._parameters)
        self._speed_gains = SpeedGains.from_parameters(self._parameters)

    def restart(self) -> None:
        """Reset the integrals."""
        self._steering = SteeringState()
        self._speed: SpeedState | None = None

    def control(self, order: Order, estimate: StateEstimate, dt_s: float) -> Demand:
        """Return the demands for the order."""
        gains = self._steering_gains
        rate_radps = order.turn_rate_radps
        if order.heading_rad is not None:
            rate_radps = heading_rate_radps(gains, order.heading_rad, estimate.yaw_rad)
        if self._speed is None:
            self._speed = SpeedState(desired_mps=order.ground_speed_mps)
        self._steering, steering = turn_rate_control(
            gains, self._steering, rate_radps, estimate.gyro_frd_radps[2], order.steering_limited, dt_s
        )
        self._speed, thrust = speed_control(
            self._speed_gains, self._speed, order.speed_mps, order.ground_speed_mps, order.thrust_limited, dt_s
        )
        return Demand(thrust, steering)
