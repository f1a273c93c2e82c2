"""A heading controller that was trained, as a controller of the embedded autopilot.

    xitl sim sitl --set autopilot.controller=examples/learned_heading.py:LearnedHeading

`learn_heading.py` trains it and writes its weights to `learned_heading.json`, beside this file. It needs the standard
library alone, so it also runs on a board. The speed loop is that of the built-in controller.
"""

from __future__ import annotations

import json
import math
from operator import mul
from pathlib import Path

from agent.fcu.control.controller import Demand, Order
from agent.fcu.control.heading_speed import HeadingSpeedController
from agent.fcu.parameters import Parameters
from agent.navigation.measurements import StateEstimate

WEIGHTS = Path(__file__).with_name("learned_heading.json")
INTEGRAL_LIMIT_RADS = 0.5
INTEGRATED_BELOW_RAD = 0.35  # larger errors are turns, which must not be integrated


class LearnedHeading:
    """See Controller in agent/fcu/control/controller.py."""

    def __init__(self, parameters: Parameters) -> None:
        weights = json.loads(WEIGHTS.read_text(encoding="utf-8"))
        self._hidden: list[list[float]] = weights["hidden"]
        self._output: list[float] = weights["output"]
        self._built_in = HeadingSpeedController(parameters)
        self._integral_rads = 0.0

    def configure(self) -> None:
        """The weights are fixed; the speed loop reads its parameters."""
        self._built_in.configure()

    def restart(self) -> None:
        """Forget the integrals."""
        self._built_in.restart()
        self._integral_rads = 0.0

    def control(self, order: Order, estimate: StateEstimate, dt_s: float) -> Demand:
        """Steering from the network for a heading, otherwise from the built-in controller."""
        built_in = self._built_in.control(order, estimate, dt_s)
        if order.heading_rad is None:
            return built_in
        error_rad = math.remainder(order.heading_rad - estimate.yaw_rad, 2.0 * math.pi)
        if abs(error_rad) < INTEGRATED_BELOW_RAD and not order.steering_limited:
            integral_rads = self._integral_rads + error_rad * dt_s
            self._integral_rads = max(-INTEGRAL_LIMIT_RADS, min(INTEGRAL_LIMIT_RADS, integral_rads))
        inputs = (error_rad, estimate.gyro_frd_radps[2], self._integral_rads, order.ground_speed_mps)
        return Demand(built_in.thrust, self.steering(inputs))

    def steering(self, inputs: tuple[float, float, float, float]) -> float:
        """Return the steering in [-1, 1] for heading error, turn rate, integral of the error, and speed."""
        error_rad, rate_radps, integral_rads, speed_mps = inputs
        # An odd function of the first three: port and starboard are alike
        features = (error_rad, rate_radps, integral_rads, error_rad * speed_mps / 3.0, rate_radps * speed_mps / 3.0)
        hidden = [math.tanh(sum(map(mul, row, features))) for row in self._hidden]
        return math.tanh(sum(map(mul, self._output, hidden)))
