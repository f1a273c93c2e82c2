"""One quantity of both logs over their common time: how far apart, and how much later."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.compare.common_time import Pairing, integral, match
from xitl_cli.logs.compare.lag import best_lag
from xitl_cli.logs.signals import Series

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Profile:
    """stamp_ns: (N,) A's own samples within the common time, on A's time. a, b: (N,) there, B on straight lines between
    its samples. errors: (N,) b less a, of angles the short way round.

    iae: integral of |b - a| over time (unit times s), by the trapezoidal rule, gaps left out; covered_s: over how long.
    rms, mean, most: of the errors (most: of |errors|, at most_ns). correlation, lag_s: the highest correlation when B
    is shifted, and how much later B is (within 10 s); None where one of them does not change or nothing is alike.
    """

    name: str
    unit: str
    sources: tuple[str, str]
    stamp_ns: NDArray[np.int64]
    a: Array
    b: Array
    errors: Array
    iae: float
    rms: float
    mean: float
    most: float
    most_ns: int
    covered_s: float
    correlation: float | None
    lag_s: float | None

    @property
    def constant(self) -> bool:
        """Whether neither ever changes."""
        return not np.ptp(self.a) and not np.ptp(self.b)


def profile(name: str, a: Series, b: Series, pairing: Pairing) -> Profile | None:
    """None without a common time of at least two samples."""
    matched = match(a, b, pairing)
    if matched is None:
        return None
    stamps, in_a, in_b = matched
    errors = (in_b - in_a + 180.0) % 360.0 - 180.0 if a.turns else in_b - in_a
    worst = int(np.argmax(np.abs(errors)))
    covered_s, iae = integral(stamps, np.abs(errors))
    correlation, lag_s = best_lag(stamps, in_a, in_b, turns=a.turns)
    return Profile(
        name,
        a.unit,
        (a.source, b.source),
        stamps,
        in_a,
        in_b,
        errors,
        iae,
        float(np.sqrt(np.mean(errors**2))),
        float(np.mean(errors)),
        float(abs(errors[worst])),
        int(stamps[worst]),
        covered_s,
        correlation,
        lag_s,
    )
