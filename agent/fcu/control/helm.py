"""The helm (LC, LA): from a desired heading and speed, and what the vessel does, to the commands of the propellers."""

from __future__ import annotations

from agent.fcu.control.allocation import Allocation, AllocationGains, allocate
from agent.fcu.control.controller import Demand, Motors, Order
from agent.fcu.control.loops import (
    SpeedGains,
    SpeedState,
    SteeringGains,
    SteeringState,
    heading_rate_radps,
    propel,
    turn,
)
from agent.fcu.parameters import Parameters
from agent.fcu.samples import Estimate


class Helm:
    """The built-in Controller: heading, turn rate and speed loops with what they remember."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.configure()
        self.restart()

    def configure(self) -> None:
        """Take changed parameters over."""
        self._steering_gains = SteeringGains.of(self._parameters)
        self._speed_gains = SpeedGains.of(self._parameters)

    def restart(self) -> None:
        """Forget integrals."""
        self._steering = SteeringState()
        self._speed: SpeedState | None = None

    def control(self, order: Order, estimate: Estimate, dt_s: float) -> Demand:
        """Demands that bring the vessel to what is asked for."""
        gains = self._steering_gains
        rate_radps = order.turn_rate_radps
        if order.heading_rad is not None:
            rate_radps = heading_rate_radps(gains, order.heading_rad, estimate.yaw_rad)
        if self._speed is None:
            self._speed = SpeedState(desired_mps=order.ground_speed_mps)
        self._steering, steering = turn(
            gains, self._steering, rate_radps, estimate.gyro_frd_radps[2], order.steering_limited, dt_s
        )
        self._speed, thrust = propel(
            self._speed_gains, self._speed, order.speed_mps, order.ground_speed_mps, order.thrust_limited, dt_s
        )
        return Demand(thrust, steering)


class Propellers:
    """Allocation of demands with what it remembers. `efforts` counts them."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.efforts = 0
        self.configure()
        self.restart()

    def configure(self) -> None:
        """Take changed parameters over."""
        self._gains = AllocationGains.of(self._parameters)

    def restart(self) -> None:
        """The last command was neutral."""
        self.last = Allocation()

    def take(self, motors: Motors) -> tuple[float, float]:
        """Commands that were made elsewhere."""
        self.efforts += 1
        self.last = Allocation((motors.port, motors.starboard))
        return self.last.command

    def drive(self, demand: Demand, dt_s: float) -> tuple[float, float]:
        """Commands (port, starboard) in [-1, 1]."""
        self.efforts += 1
        self.last = allocate(self._gains, self.last, demand.thrust, demand.steering, dt_s)
        return self.last.command
