"""A sliding mode heading controller in place of the built-in heading loop.

    xitl agent --controller examples/sliding_mode_heading.py:SlidingModeHeading

The yaw dynamics of a catamaran are close to first order: T r' + r = K u, with u the steering demand in [-1, 1], r the
turn rate, K the turn rate of full steering and T a time constant. With the heading error e = psi - psi_d the sliding
variable is s = r + lambda e; where it is zero, the error decays by exp(-lambda t) whatever the gains. The demand

    u = (r - T lambda r) / K - (eta / K) tanh(s / phi)

makes s' = -(eta / T) tanh(s / phi): it reaches zero in spite of wind, current and errors of K and T that together are
worth less than eta of turn rate. tanh instead of the sign keeps the propellers from chattering; phi is the width of
that layer. Source: Fossen 2021, section 16.4 (sliding mode control for heading).

Speed is the built-in controller's business: a controller may be built of parts of another one.
"""

from __future__ import annotations

import math

from agent.fcu.control.controller import Demand, Order
from agent.fcu.control.heading_speed import HeadingSpeedController
from agent.fcu.parameters import Parameters
from agent.navigation.measurements import StateEstimate

LAMBDA_PER_S = 0.6  # decay of the heading error while sliding
ETA_RADPS = 0.5  # what disturbances are worth, as a turn rate
PHI_RADPS = 0.25  # width of the layer
TIME_CONSTANT_S = 0.4  # T of the full-size vessel: yaw inertia over yaw damping


class SlidingModeHeading:
    """See Controller in agent/fcu/control/controller.py."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._speed = HeadingSpeedController(parameters)
        self.configure()

    def configure(self) -> None:
        """K from ATC_STR_RAT_FF, which is steering per turn rate: 1 / K."""
        self._speed.configure()
        self._steering_per_rate = self._parameters["ATC_STR_RAT_FF"]
        self._rate_max_radps = math.radians(self._parameters["ATC_STR_RAT_MAX"])

    def restart(self) -> None:
        """The heading controller remembers nothing; the speed controller does."""
        self._speed.restart()

    def control(self, order: Order, estimate: StateEstimate, dt_s: float) -> Demand:
        """Thrust from the built-in controller, steering from the sliding mode, or from the turn rate asked for."""
        built_in = self._speed.control(order, estimate, dt_s)
        if order.heading_rad is None:
            return built_in
        rate_radps = estimate.gyro_frd_radps[2]
        error_rad = math.remainder(estimate.yaw_rad - order.heading_rad, 2.0 * math.pi)
        # A large error is turned off at the turn rate allowed.
        wanted_radps = max(-self._rate_max_radps, min(self._rate_max_radps, -LAMBDA_PER_S * error_rad))
        sliding_radps = rate_radps - wanted_radps
        equivalent_radps = rate_radps
        if abs(wanted_radps) < self._rate_max_radps:
            equivalent_radps -= TIME_CONSTANT_S * LAMBDA_PER_S * rate_radps
        wish_radps = equivalent_radps - ETA_RADPS * math.tanh(sliding_radps / PHI_RADPS)
        steering = self._steering_per_rate * wish_radps
        return Demand(built_in.thrust, max(-1.0, min(1.0, steering)))
