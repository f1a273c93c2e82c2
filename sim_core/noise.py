"""Noise of sensors and of the environment: white noise from its density, and first-order Gauss-Markov processes.

A Gauss-Markov (Ornstein-Uhlenbeck) process of deviation sigma and time constant tau is sampled exactly at any step:

    x(t + dt) = a x(t) + sigma sqrt(1 - a^2) n,   a = exp(-dt / tau),   n ~ N(0, 1)

The standard deviation is then sigma and the autocorrelation exp(-lag / tau) for any dt.
"""

from __future__ import annotations

import math

import numpy as np
from numpy import float64
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array

# The Allan variance of a first-order Gauss-Markov process with deviation s and correlation time Tc is, x = tau/Tc,
#   sigma_A^2 = (2 s^2 / x) (1 - (3 - 4 exp(-x) + exp(-2x)) / (2x))
# (IEEE Std 952-1997, annex C, with the driving density q^2 = 2 s^2 / Tc). It peaks at x = 1.8926, where sigma_A is this
# fraction of s, which is the better known 0.4365 q sqrt(Tc) divided by s = q sqrt(Tc / 2).
GAUSS_MARKOV_ALLAN_PEAK = 0.6173642831


def white_deviation(density_per_rthz: float, rate_hz: float) -> float:
    """Deviation of one sample of white noise. The Allan deviation is `density / sqrt(tau)` at any `rate_hz`."""
    return density_per_rthz * math.sqrt(rate_hz)


def bias_deviation(bias_instability: float) -> float:
    """Deviation of the Gauss-Markov process that has its maximum Allan deviation at `bias_instability`."""
    return bias_instability / GAUSS_MARKOV_ALLAN_PEAK


@dataclass(frozen=True, slots=True)
class SampledGaussMarkov:
    """First-order Gauss-Markov processes, one per column, discretised exactly and stationary from the start.

    `x' = decay x + drive n` with `decay = exp(-dt / Tc)` and `drive = deviation sqrt(1 - decay^2)`. It keeps the
    deviation and correlation time of the continuous process at any dt.
    """

    deviation: Array
    """(1, K), standard deviation of each process."""
    decay: Array
    """(1, K), factor on the previous sample."""
    drive: Array
    """(1, K), factor on the noise."""

    def initial(self, normals: Array) -> Array:
        """Convert (N, K) standard normals to (N, K) values of the stationary process."""
        return self.deviation * normals


def sampled_gauss_markov(deviation: ArrayLike, correlation_s: ArrayLike, rate_hz: float) -> SampledGaussMarkov:
    """Return K processes, sampled at `rate_hz`. Deviations are (K,), correlation times (K,) or one for all."""
    sigma = np.array(deviation, dtype=np.float64, ndmin=2)
    step = np.broadcast_to(-1.0 / (rate_hz * np.asarray(correlation_s, dtype=np.float64)), sigma.shape)
    # expm1 keeps the drive exact for a step of a millionth of the correlation time.
    return SampledGaussMarkov(deviation=sigma, decay=np.exp(step), drive=sigma * np.sqrt(-np.expm1(2.0 * step)))


@dataclass(frozen=True, slots=True)
class GaussMarkov:
    """First-order Gauss-Markov process."""

    deviation: float
    """Stationary standard deviation, in the unit of the quantity."""
    correlation_s: float
    """Time constant tau."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.deviation) and self.deviation >= 0.0):
            raise ValueError(f"deviation = {self.deviation} must be zero or a positive number")
        if not (math.isfinite(self.correlation_s) and self.correlation_s > 0.0):
            raise ValueError(f"correlation_s = {self.correlation_s} must be a positive number of seconds")

    def initial(self, vessels: int, rng: Generator) -> NDArray[float64]:
        """Draw (N,) values from the stationary distribution."""
        return self.deviation * rng.standard_normal(vessels)

    def step(self, value: NDArray[float64], dt_s: float, rng: Generator) -> NDArray[float64]:
        """Return the (N,) values one step later."""
        decay = math.exp(-dt_s / self.correlation_s)
        kick = self.deviation * math.sqrt(1.0 - decay * decay)
        advanced: NDArray[float64] = decay * value + kick * rng.standard_normal(value.shape)
        return advanced
