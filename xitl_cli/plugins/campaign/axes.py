"""Axes of a plan: values of the profile's keys, and the resulting points of a campaign.

    environment.wind.mean_mps: [0, 4, 8]                           # a list
    environment.current.speed_mps: {from: 0, to: 1, count: 5}      # a range: count or step, scale: linear or log
    faults.lossy-link.link.loss: {uniform: [0, 0.5]}               # a distribution
    faults.gnss-dropout: [off, on]                                 # a fault by name, the base's or a shipped one
    extends.environment: [environments/calm, environments/current] # parts of profiles, merged into the base
    autopilot.firmware: [ardurover-4.5, ardurover-4.6]             # programs, relative to the plan

The same plan gives the same points on every machine. The plan's seed and the key of an axis determine its draws.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from statistics import NormalDist
from typing import Any, Literal, TypeAlias

from sim_core.dataclass import dataclass
from xitl_cli.plugins.campaign.expression import Expression
from xitl_cli.profile.files.entry import Entry, Origin, Problem, ProfileError, shown

AxisValue: TypeAlias = float | int | str | bool | tuple[Any, ...] | dict[str, Any] | None
Combine: TypeAlias = Literal["grid", "latin_hypercube", "one_at_a_time"]

MOST_VALUES = 10_000_000
"""A range with more values is treated as a mistake."""
EXTENDS, FAULTS = "extends", "faults"
_BELOW_ONE = 1.0 - 1e-15
_MOMENTS = {"uniform": 2, "loguniform": 2, "normal": 2, "lognormal": 2, "triangular": 3, "integers": 2}
_MEANING = {
    "uniform": "[low, high]",
    "loguniform": "[low, high]",
    "normal": "[mean, standard deviation]",
    "lognormal": "[median, standard deviation of the logarithm]",
    "triangular": "[low, mode, high]",
    "integers": "[first, last]",
}


@dataclass(frozen=True, slots=True)
class RunPoint:
    """One run of a campaign."""

    number: int
    """Index, from 1."""
    values: Mapping[str, AxisValue]
    """Differences from the base, by key of the profile."""
    seed: int

    def key(self, base: str) -> str:
        """Return the key that identifies the run in a resumed campaign; base: digest of the profile without axes."""
        text = json.dumps([base, sorted(self.values.items()), self.seed], default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class Distribution:
    """Distribution of the values of an axis."""

    kind: str
    """One of uniform, loguniform, normal, lognormal, triangular, integers."""
    moments: tuple[float, ...]
    within: tuple[float, float] | None = None
    """Limits at which it is truncated."""

    def quantile(self, share: float) -> float | int:
        """Return the value with a share (in [0, 1)) of all draws below it."""
        if self.within is not None:
            low, high = (self._share_below(bound) for bound in self.within)
            share = low + share * (high - low)
        value = self._quantile(share)
        if self.within is not None:
            value = min(max(value, self.within[0]), self.within[1])
        return value

    def _quantile(self, share: float) -> float | int:
        share = min(max(share, 1e-15), _BELOW_ONE)
        first, second, *rest = self.moments
        if self.kind == "uniform":
            return first + share * (second - first)
        if self.kind == "loguniform":
            return float(first * (second / first) ** share)
        if self.kind == "normal":
            return NormalDist(first, second).inv_cdf(share)
        if self.kind == "lognormal":
            return first * math.exp(NormalDist(0.0, second).inv_cdf(share))
        if self.kind == "triangular":
            (high,) = rest
            turn = (second - first) / (high - first)
            if share < turn:
                return first + math.sqrt(share * (high - first) * (second - first))
            return high - math.sqrt((1.0 - share) * (high - first) * (high - second))
        return int(first) + int(share * (int(second) - int(first) + 1))

    def _share_below(self, value: float) -> float:
        """Return the share by bisection: quantiles grow with the share."""
        if value <= self._quantile(0.0):
            return 0.0
        if value >= self._quantile(1.0):
            return 1.0
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._quantile(middle) < value else (low, middle)
        return 0.5 * (low + high)


@dataclass(frozen=True, slots=True)
class Axis:
    """A key of the profile with its values (a list or a range), or its distribution."""

    key: str
    origin: Origin
    values: tuple[AxisValue, ...] = ()
    distribution: Distribution | None = None
    ends: tuple[float, float] | None = None
    """(low, high) of a range without count and step, which has no list of values."""
    log: bool = False
    """The range is logarithmic."""
    weights: tuple[float, ...] = ()
    """Weights of the values of a choice."""
    count: int | None = None
    """Number of draws in a grid."""

    @property
    def drawn(self) -> bool:
        """True if a grid has to draw its values."""
        return self.distribution is not None or bool(self.weights)

    @property
    def numeric(self) -> bool:
        """True if all its values are numbers."""
        numbers = (isinstance(value, (int, float)) and not isinstance(value, bool) for value in self.values)
        return self.distribution is not None or self.ends is not None or (bool(self.values) and all(numbers))

    def quantile(self, share: float) -> AxisValue:
        """Return the value at a share in [0, 1) of the axis: of its distribution, or along its range or list."""
        if self.distribution is not None:
            return self.distribution.quantile(share)
        if self.weights:
            total, below = sum(self.weights), 0.0
            for value, weight in zip(self.values, self.weights, strict=True):
                below += weight / total
                if share < below:
                    return value
            return self.values[-1]
        if self.ends is not None:
            low, high = self.ends
            return low * (high / low) ** share if self.log else low + share * (high - low)
        return self.values[min(int(share * len(self.values)), len(self.values) - 1)]

    def grid_values(self, seed: int) -> tuple[AxisValue, ...]:
        """Return its values in a grid. The plan's seed draws the values of a distribution."""
        if not self.drawn:
            if self.ends is not None:
                raise _wrong(self.origin, self.key, "is a range without values; add count or step")
            return self.values
        if self.count is None:
            raise _wrong(
                self.origin, self.key, "is a distribution; add count, or use combine: latin_hypercube with samples"
            )
        rng = axis_generator(seed, self.key)
        return tuple(self.quantile(float(share)) for share in rng.random(self.count))

    def example(self) -> AxisValue:
        """Return one of its values."""
        return self.quantile(0.5) if self.drawn or self.ends is not None else self.values[0]


def axis_generator(seed: int, key: str) -> Any:
    """Return the random generator of one axis, independent of the other axes of a plan."""
    from numpy.random import SeedSequence, default_rng

    return default_rng(SeedSequence([seed, *hashlib.sha256(key.encode()).digest()[:8]]))


def read_axes(entry: Entry | None) -> tuple[Axis, ...]:
    """Return the axes of a plan's `axes:`. Raises ProfileError with every problem."""
    if entry is None or entry.value is None:
        return ()
    if not isinstance(entry.value, dict):
        raise _wrong(entry.origin, "axes", "is not a group; write `key of the profile: values` under it")
    axes: list[Axis] = []
    problems: list[Problem] = []
    for key, below in entry.value.items():
        try:
            axes.append(_axis(key, below))
        except ProfileError as error:
            problems += error.problems
    if problems:
        raise ProfileError(problems, entry.origin.source)
    return tuple(axes)


def _axis(key: str, entry: Entry) -> Axis:
    fault = key.startswith(f"{FAULTS}.") and key.count(".") == 1
    if isinstance(entry.value, tuple):
        if not entry.value:
            raise _wrong(entry.origin, key, "has no value; add at least one")
        values = tuple(_switch(key, item) if fault else _plain(item) for item in entry.value)
        for number, value in enumerate(values):
            if value in values[:number] and type(value) is type(values[values.index(value)]):
                raise _wrong(entry.value[number].origin, key, f"has {shown(value)} twice; remove one of them")
        return Axis(key, entry.origin, values)
    if fault:
        raise _wrong(entry.origin, key, "is a whole fault, on or off; write [off, on], or name a key of the fault")
    if not isinstance(entry.value, dict):
        raise _wrong(
            entry.origin, key, f"= {shown(entry.value)} is a single value; write a list, or put it under `set:`"
        )
    if "from" in entry.value or "to" in entry.value:
        return _range(key, entry, entry.value)
    return _distribution(key, entry, entry.value)


def _plain(entry: Entry) -> AxisValue:
    value: Any = entry.plain()
    return value  # type: ignore[no-any-return]


def _switch(key: str, entry: Entry) -> bool:
    words = {"on": True, "off": False, True: True, False: False}
    if not isinstance(entry.value, (str, bool)) or entry.value not in words:
        raise _wrong(entry.origin, key, f"= {shown(entry.plain())} is not a switch; write on or off")
    return words[entry.value]


def _range(key: str, entry: Entry, keys: Mapping[str, Entry]) -> Axis:
    _only(key, keys, ("from", "to", "step", "count", "scale"))
    low, high = _number(key, keys, "from", entry), _number(key, keys, "to", entry)
    scale = keys["scale"].value if "scale" in keys else "linear"
    if scale not in ("linear", "log"):
        raise _wrong(keys["scale"].origin, f"{key}.scale", f"= {shown(scale)} is not a scale; write linear or log")
    if not high > low:
        raise _wrong(entry.origin, key, f"goes from {low:g} to {high:g}; `to` must be the larger one")
    if scale == "log" and low <= 0:
        raise _wrong(entry.origin, key, f"is logarithmic from {low:g}; start above 0")
    if "step" in keys and "count" in keys:
        raise _wrong(keys["step"].origin, key, "has step and count; remove one of them")
    if "step" in keys:
        step = _number(key, keys, "step", entry)
        if scale == "log" and step <= 1:
            raise _wrong(keys["step"].origin, f"{key}.step", f"= {step:g} is a factor here; use more than 1")
        if step <= 0:
            raise _wrong(keys["step"].origin, f"{key}.step", f"= {step:g} is too small; use a value above 0")
        steps = math.log(high / low) / math.log(step) if scale == "log" else (high - low) / step
        _few(key, keys["step"], steps)
        numbers = range(math.floor(steps * (1 + 1e-12) + 1e-9) + 1)
        exact = [low * step**number if scale == "log" else low + number * step for number in numbers]
        return Axis(key, entry.origin, _tidy(exact, low, high, step), log=scale == "log")
    if "count" in keys:
        count = _count(key, keys["count"])
        if count < 2:
            raise _wrong(keys["count"].origin, f"{key}.count", "= 1 does not make a range; use at least 2")
        shares = [number / (count - 1) for number in range(count)]
        exact = [low * (high / low) ** share if scale == "log" else low + share * (high - low) for share in shares]
        return Axis(key, entry.origin, _tidy([*exact[:-1], high], low, high), log=scale == "log")
    return Axis(key, entry.origin, ends=(low, high), log=scale == "log")


def _tidy(values: Sequence[float], *written: float) -> tuple[AxisValue, ...]:
    """Round 0.30000000000000004 to 0.3, and return whole numbers if all written numbers are whole."""
    rounded = [float(f"{value:.12g}") for value in values]
    whole = all(isinstance(number, int) for number in written) and all(value.is_integer() for value in rounded)
    return tuple(int(value) if whole else value for value in rounded)


def _distribution(key: str, entry: Entry, keys: Mapping[str, Entry]) -> Axis:
    kinds = [kind for kind in (*_MOMENTS, "choice") if kind in keys]
    if len(kinds) != 1:
        known = ", ".join((*_MOMENTS, "choice"))
        problem = "is neither a range nor a distribution" if not kinds else f"is both {' and '.join(kinds)}"
        raise _wrong(entry.origin, key, f"{problem}; write a list, {{from: …, to: …}} or one of {known}")
    (kind,) = kinds
    _only(key, keys, (kind, "count", "weights" if kind == "choice" else "within"))
    count = _count(key, keys["count"]) if "count" in keys else None
    chosen = keys[kind]
    if kind == "choice":
        if not isinstance(chosen.value, tuple) or not chosen.value:
            raise _wrong(chosen.origin, f"{key}.choice", "is not a list of values; write [a, b, …]")
        values = tuple(_plain(item) for item in chosen.value)
        weights = _numbers(f"{key}.weights", keys["weights"]) if "weights" in keys else (1.0,) * len(values)
        if len(weights) != len(values) or min(weights) < 0 or sum(weights) <= 0:
            raise _wrong(keys["weights"].origin, f"{key}.weights", f"are not {len(values)} shares; give one per value")
        return Axis(key, entry.origin, values, weights=weights, count=count)
    moments = _numbers(f"{key}.{kind}", chosen)
    if len(moments) != _MOMENTS[kind]:
        raise _wrong(chosen.origin, f"{key}.{kind}", f"needs {_MEANING[kind]}")
    low, high = moments[0], moments[-1]
    if kind in ("normal", "lognormal"):
        wrong = high <= 0 or (kind == "lognormal" and low <= 0)
    else:
        wrong = not low < high or list(moments) != sorted(moments) or (kind == "loguniform" and low <= 0)
    if wrong or (kind == "integers" and not all(float(moment).is_integer() for moment in moments)):
        raise _wrong(chosen.origin, f"{key}.{kind}", f"= {list(moments)} is not a valid {_MEANING[kind]}; correct it")
    within = _numbers(f"{key}.within", keys["within"]) if "within" in keys else None
    if within is not None and (len(within) != 2 or not within[0] < within[1]):
        raise _wrong(keys["within"].origin, f"{key}.within", "is not [low, high]; give two increasing numbers")
    pair = None if within is None else (within[0], within[1])
    return Axis(key, entry.origin, distribution=Distribution(kind, moments, pair), count=count)


def _only(key: str, entries: Mapping[str, Entry], known: Sequence[str]) -> None:
    import difflib

    for name, entry in entries.items():
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            fix = f"did you mean {close[0]!r}?" if close else f"known keys: {', '.join(known)}"
            raise _wrong(entry.origin, f"{key}.{name}", f"is not a known key; {fix}")


def _number(key: str, keys: Mapping[str, Entry], name: str, entry: Entry) -> float:
    if name not in keys:
        raise _wrong(entry.origin, key, f"has no `{name}`; write {{from: …, to: …, count: …}}")
    (number,) = _numbers(f"{key}.{name}", Entry((keys[name],), keys[name].origin))
    return number


def _numbers(key: str, entry: Entry) -> tuple[float, ...]:
    items = entry.value if isinstance(entry.value, tuple) else (entry,)
    for item in items:
        numeric = isinstance(item.value, (int, float)) and not isinstance(item.value, bool)
        if not numeric or not math.isfinite(item.value):  # type: ignore[arg-type]
            raise _wrong(item.origin, key, f"= {shown(item.plain())} is not a number; write a finite number")
    return tuple(item.value for item in items)  # type: ignore[misc]


def _count(key: str, entry: Entry) -> int:
    if not isinstance(entry.value, int) or isinstance(entry.value, bool) or entry.value < 1:
        raise _wrong(entry.origin, f"{key}.count", f"= {shown(entry.plain())} is not a count; write a whole number")
    _few(key, entry, entry.value)
    return entry.value


def _few(key: str, entry: Entry, count: float) -> None:
    if count >= MOST_VALUES:
        raise _wrong(entry.origin, key, f"has about {count:.0e} values; use fewer")


def _wrong(origin: Origin, key: str, problem: str) -> ProfileError:
    return ProfileError([Problem(origin, f"{key} {problem}")], origin.source)


def combinations(
    axes: Sequence[Axis],
    combine: Combine,
    samples: int | None,
    seed: int,
    constraints: Sequence[Expression],
    base_values: Mapping[str, AxisValue],
) -> Iterator[dict[str, AxisValue]]:
    """Yield the values of each point that satisfies all constraints.

    samples: size of a Latin hypercube, before constraints. Each axis is divided into that many layers of equal
    probability, and every layer is used once (McKay, Beckman and Conover 1979). base_values: values of the base, by
    key. One at a time begins with the base itself.
    """
    for values in _all_combinations(axes, combine, samples, seed):
        if combine == "one_at_a_time" and any(base_values[key] == value for key, value in values.items()):
            continue  # the base again
        named = {**base_values, **values}
        if all(constraint.holds(named) for constraint in constraints):
            yield values


def raw_count(axes: Sequence[Axis], combine: Combine, samples: int | None) -> int:
    """Return the number of combinations before constraints."""
    if combine == "latin_hypercube":
        return samples or 0
    counts = [axis.count or 0 if axis.drawn else len(axis.values) for axis in axes]
    return 1 + sum(counts) if combine == "one_at_a_time" else math.prod(counts)


def _all_combinations(
    axes: Sequence[Axis], combine: Combine, samples: int | None, seed: int
) -> Iterator[dict[str, AxisValue]]:
    keys = [axis.key for axis in axes]
    if combine == "latin_hypercube":
        samples = samples or 0
        shares: dict[str, list[float]] = {}
        for axis in axes:
            rng = axis_generator(seed, axis.key)
            shares[axis.key] = ((rng.permutation(samples) + rng.random(samples)) / max(samples, 1)).tolist()
        for number in range(samples):
            yield {axis.key: axis.quantile(shares[axis.key][number]) for axis in axes}
        return
    values_by_axis = [axis.grid_values(seed) for axis in axes]
    if combine == "one_at_a_time":
        yield {}
        for key, values in zip(keys, values_by_axis, strict=True):
            yield from ({key: value} for value in values)
        return
    for values in product(*values_by_axis):
        yield dict(zip(keys, values, strict=True))


def short(value: float) -> float | int:
    """Return a number rounded for display."""
    rounded = float(f"{value:.4g}")
    return int(rounded) if rounded.is_integer() and abs(rounded) < 1e15 else rounded


def value_text(value: Any) -> str:
    """Return a value of an axis in the form of a plan, with numbers to four digits."""
    if isinstance(value, float) and math.isfinite(value):
        return str(short(value))
    if isinstance(value, (tuple, list)):
        return ", ".join(map(value_text, value))
    return value if isinstance(value, str) else json.dumps(value)
