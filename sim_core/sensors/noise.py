"""The noise processes the sensors share: white noise from its density and first-order Gauss-Markov."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sim_core.frames import Array

# The Allan variance of a first-order Gauss-Markov process with deviation s and correlation time Tc is, x = tau/Tc,
#   sigma_A^2 = (2 s^2 / x) (1 - (3 - 4 exp(-x) + exp(-2x)) / (2x))
# (IEEE Std 952-1997, annex C, with the driving density q^2 = 2 s^2 / Tc). It peaks at x = 1.8926, where sigma_A is this
# fraction of s, which is the better known 0.4365 q sqrt(Tc) divided by s = q sqrt(Tc / 2).
GAUSS_MARKOV_ALLAN_PEAK = 0.6173642831


def white_deviation(density_per_rthz: float, rate_hz: float) -> float:
    """Deviation of one sample of white noise: an Allan deviation of `density / sqrt(tau)` at any `rate_hz`."""
    return density_per_rthz * math.sqrt(rate_hz)


def bias_deviation(bias_instability: float) -> float:
    """Deviation of the Gauss-Markov process whose Allan deviation has its maximum at `bias_instability`."""
    return bias_instability / GAUSS_MARKOV_ALLAN_PEAK


@dataclass(frozen=True, slots=True)
class GaussMarkov:
    """First-order Gauss-Markov processes, one per column, discretised exactly and stationary from the start.

    deviation, decay, drive: (1, K). `x' = decay x + drive n` with `decay = exp(-dt / Tc)` and
    `drive = deviation sqrt(1 - decay^2)` keeps the deviation and correlation time of the continuous process at any dt.
    """

    deviation: Array
    decay: Array
    drive: Array

    def initial(self, normals: Array) -> Array:
        """(N, K) standard normals -> (N, K) values of the stationary process."""
        return self.deviation * normals


def gauss_markov(deviation: ArrayLike, correlation_s: ArrayLike, rate_hz: float) -> GaussMarkov:
    """K processes from deviations (K,) and correlation times (K,) or one for all, sampled at `rate_hz`."""
    sigma = np.array(deviation, dtype=np.float64, ndmin=2)
    step = np.broadcast_to(-1.0 / (rate_hz * np.asarray(correlation_s, dtype=np.float64)), sigma.shape)
    # expm1 keeps the drive exact when the step is a millionth of the correlation time.
    return GaussMarkov(deviation=sigma, decay=np.exp(step), drive=sigma * np.sqrt(-np.expm1(2.0 * step)))
