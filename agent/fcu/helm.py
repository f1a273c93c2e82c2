"""The helm (LC, LA): from a desired heading and speed, and what the vessel does, to the commands of the propellers."""

from __future__ import annotations

from agent.fcu.allocation import Allocation, AllocationGains, allocate
from agent.fcu.control import SpeedGains, SpeedState, SteeringGains, SteeringState, propel, steer
from agent.fcu.parameters import Parameters


class Helm:
    """Heading and speed loops with what they remember, and the allocation of their demands."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.configure()
        self.restart()

    def configure(self) -> None:
        """Take changed parameters over."""
        self._steering_gains = SteeringGains.of(self._parameters)
        self._speed_gains = SpeedGains.of(self._parameters)
        self._allocation_gains = AllocationGains.of(self._parameters)

    def restart(self) -> None:
        """Forget integrals and the last command."""
        self._steering = SteeringState()
        self._speed: SpeedState | None = None
        self._allocation = Allocation()
        self.speed_error_mps = 0.0

    def toward(
        self,
        heading_rad: float,
        speed_mps: float,
        yaw_rad: float,
        turn_rate_radps: float,
        ground_speed_mps: float,
        dt_s: float,
    ) -> tuple[float, float]:
        """Demands (thrust, steering) in [-1, 1] that bring the vessel to a heading and a speed over ground."""
        if self._speed is None:
            self._speed = SpeedState(desired_mps=ground_speed_mps)
        last = self._allocation
        self._steering, steering = steer(
            self._steering_gains, self._steering, heading_rad, yaw_rad, turn_rate_radps, last.steering_limited, dt_s
        )
        self._speed, thrust = propel(
            self._speed_gains, self._speed, speed_mps, ground_speed_mps, last.thrust_limited, dt_s
        )
        self.speed_error_mps = speed_mps - ground_speed_mps
        return thrust, steering

    def drive(self, thrust: float, steering: float, dt_s: float) -> tuple[float, float]:
        """Commands (port, starboard) in [-1, 1] for two demands."""
        self._allocation = allocate(self._allocation_gains, self._allocation, thrust, steering, dt_s)
        return self._allocation.command
