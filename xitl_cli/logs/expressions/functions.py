"""The functions of the language: their arguments, their effect on arrays and on units.

Angles of sin, cos and tan are radians. wrap180, wrap360 and wrap_pi bring angles and differences of angles into ±180, 0
to 360 and ±π. Functions in `TIMED` work along time and get the seconds of their samples first:

    unwrap(x)            an angle without its jumps: of 2π for radians, else of 360
    diff(x)              from sample to sample; the first is unknown
    derivative(x)        per second, by the second-order differences of uneven steps
    integral(x)          over time from the first sample, by the trapezoidal rule; unknown values add nothing
    smooth(x, seconds)   mean of known values within half of that time before and after
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.expressions.units import Unit, power_unit, product_unit, same_unit

Floats = NDArray[np.float64]
UnitRule = Callable[[Sequence[Unit]], Unit]


@dataclass(frozen=True, slots=True)
class Function:
    """One function."""

    apply: Callable[..., Any]
    """From arrays to an array."""
    unit: UnitRule
    least: int = 1
    """Least number of arguments."""
    most: int | None = 1
    """Largest number of arguments."""
    angles: str = ""
    """Unit that angles should have."""


def _wrapped(x: Any, turn: float, low: float) -> Any:
    return np.mod(np.asarray(x, dtype=np.float64) - low, turn) + low


def _least(*values: Any) -> Any:
    return np.minimum.reduce(np.broadcast_arrays(*values))


def _most(*values: Any) -> Any:
    return np.maximum.reduce(np.broadcast_arrays(*values))


def _same(units: Sequence[Unit]) -> Unit:
    return same_unit(units)


def _none(units: Sequence[Unit]) -> Unit:
    return None


def _always(unit: str) -> UnitRule:
    return lambda units: unit


ELEMENTWISE: Mapping[str, Function] = {
    "abs": Function(np.abs, _same),
    "sign": Function(np.sign, _none),
    "floor": Function(np.floor, _same),
    "ceil": Function(np.ceil, _same),
    "sqrt": Function(np.sqrt, lambda units: power_unit(units[0], 0.5)),
    "exp": Function(np.exp, _none),
    "log": Function(np.log, _none),
    "log10": Function(np.log10, _none),
    "hypot": Function(lambda *sides: np.sqrt(sum(np.square(side, dtype=np.float64) for side in sides)), _same, 2, 3),
    "sin": Function(np.sin, _none, angles="rad"),
    "cos": Function(np.cos, _none, angles="rad"),
    "tan": Function(np.tan, _none, angles="rad"),
    "asin": Function(np.arcsin, _always("rad")),
    "acos": Function(np.arccos, _always("rad")),
    "atan": Function(np.arctan, _always("rad")),
    "atan2": Function(np.arctan2, _always("rad"), 2, 2),
    "radians": Function(np.radians, lambda units: _converted(units[0], "deg", "rad"), angles="deg"),
    "degrees": Function(np.degrees, lambda units: _converted(units[0], "rad", "deg"), angles="rad"),
    "wrap180": Function(lambda x: _wrapped(x, 360.0, -180.0), _same, angles="deg"),
    "wrap360": Function(lambda x: _wrapped(x, 360.0, 0.0), _same, angles="deg"),
    "wrap_pi": Function(lambda x: _wrapped(x, 2.0 * np.pi, -np.pi), _same, angles="rad"),
    "min": Function(_least, _same, 2, None),
    "max": Function(_most, _same, 2, None),
    "clip": Function(lambda x, low, high: np.minimum(np.maximum(x, low), high), _same, 3, 3),
}


def _converted(unit: Unit, old: str, new: str) -> Unit:
    """Unit after a conversion, also within a rate: deg/s becomes rad/s."""
    factor = product_unit(new, old, -1)
    return new if unit is None or unit == "" else product_unit(unit, factor)


def unwrapped(x: Floats, turn: float) -> Floats:
    """(N,) without jumps of more than half a turn. Unknown values are bridged from the last known value."""
    found = np.array(x, dtype=np.float64)
    known = np.isfinite(found)
    found[known] = np.unwrap(found[known], period=turn)
    return found


def _diff(seconds: Floats, x: Floats) -> Floats:
    return np.diff(x, prepend=np.nan)


def _derivative(seconds: Floats, x: Floats) -> Floats:
    if len(x) < 2:
        return np.full(len(x), np.nan)
    found: Floats = np.gradient(x, seconds)
    return found


def _integral(seconds: Floats, x: Floats) -> Floats:
    strips = np.nan_to_num(0.5 * (x[1:] + x[:-1]) * np.diff(seconds), nan=0.0)
    return np.concatenate(([0.0], np.cumsum(strips))) if len(x) else x


_SAME_S = 1e-9


def _smooth(seconds: Floats, x: Floats, window_s: float) -> Floats:
    known = np.isfinite(x)
    sums = np.concatenate(([0.0], np.cumsum(np.where(known, x, 0.0))))
    counts = np.concatenate(([0], np.cumsum(known)))
    half_s = 0.5 * window_s + _SAME_S  # includes rows exactly at the ends
    first = np.searchsorted(seconds, seconds - half_s, "left")
    after = np.searchsorted(seconds, seconds + half_s, "right")
    found: Floats = (sums[after] - sums[first]) / (counts[after] - counts[first])
    return found


TIMED: Mapping[str, Function] = {
    "unwrap": Function(unwrapped, _same),
    "diff": Function(_diff, _same),
    "derivative": Function(_derivative, lambda units: product_unit(units[0], "s", -1)),
    "integral": Function(_integral, lambda units: product_unit(units[0], "s")),
    "smooth": Function(_smooth, lambda units: units[0], 2, 2),
}

WHERE = "where"
ARITIES: Mapping[str, tuple[int, int | None]] = {
    **{name: (each.least, each.most) for name, each in {**ELEMENTWISE, **TIMED}.items()},
    WHERE: (3, 3),
}
"""Number of arguments of each function. `where(condition, a, b)` is a if the condition holds, else b."""
