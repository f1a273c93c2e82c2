"""First-order Gauss-Markov (Ornstein-Uhlenbeck) process, sampled exactly at any step.

    x(t + dt) = a x(t) + sigma sqrt(1 - a^2) n,   a = exp(-dt / tau),   n ~ N(0, 1)

so that the standard deviation is sigma and the autocorrelation exp(-lag / tau) whatever dt is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from numpy import float64
from numpy.random import Generator
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class GaussMarkov:
    """deviation: stationary standard deviation, in the unit of the quantity; correlation_s: time constant tau."""

    deviation: float
    correlation_s: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.deviation) and self.deviation >= 0.0):
            raise ValueError(f"deviation = {self.deviation} must be zero or a positive number")
        if not (math.isfinite(self.correlation_s) and self.correlation_s > 0.0):
            raise ValueError(f"correlation_s = {self.correlation_s} must be a positive number of seconds")

    def initial(self, vessels: int, rng: Generator) -> NDArray[float64]:
        """(N,) drawn from the stationary distribution."""
        return self.deviation * rng.standard_normal(vessels)

    def step(self, value: NDArray[float64], dt_s: float, rng: Generator) -> NDArray[float64]:
        """(N,) one step later."""
        decay = math.exp(-dt_s / self.correlation_s)
        kick = self.deviation * math.sqrt(1.0 - decay * decay)
        advanced: NDArray[float64] = decay * value + kick * rng.standard_normal(value.shape)
        return advanced
