"""Evaluation of a tree over arrays: numbers, truths and texts, one per sample, with the unit of the result.

Units of results: m/s times s is m. "" means unknown; None is the unit of a plain number, which fits any unit.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.expressions.syntax import (
    Arithmetic,
    Call,
    ComparisonChain,
    ExpressionError,
    Junction,
    Name,
    Number,
    Prefix,
    TextLiteral,
    Tree,
    Word,
)

Unit: TypeAlias = str | None

_FACTOR = re.compile(r"(?P<symbol>[A-Za-zµ°%]+)\^?(?P<power>[²³]|\d)?")
_RAISED = {"²": 2, "³": 3}
_SHOWN = {1: "", 2: "²", 3: "³"}


def same_unit(units: Sequence[Unit]) -> Unit:
    """Unit of a sum, a choice or a distance: the common unit of all."""
    known = [unit for unit in units if unit is not None]
    if not known:
        return None
    return known[0] if len(set(known)) == 1 else ""


def product_unit(left: Unit, right: Unit, power: int = 1) -> Unit:
    """Unit of left times right to the power of 1 or -1."""
    if right is None:
        return left
    divisor = _powers(right)
    factors = {} if left is None else _powers(left)
    if factors is None or divisor is None:
        return ""
    return _text({name: factors.get(name, 0) + power * divisor.get(name, 0) for name in {**factors, **divisor}})


def power_unit(unit: Unit, exponent: float) -> Unit:
    """Unit of a quantity to a power; "" if the powers are not whole."""
    if unit is None:
        return None
    factors = _powers(unit)
    if factors is None:
        return ""
    raised = {name: power * exponent for name, power in factors.items()}
    if not all(float(power).is_integer() for power in raised.values()):
        return ""
    return _text({name: round(power) for name, power in raised.items()})


def _powers(unit: str) -> dict[str, int] | None:
    """Powers of base units: {"m": 1, "s": -2} for "m/s/s". None if the unit is no such product, or is empty."""
    if not unit:
        return None
    powers: dict[str, int] = {}
    for number, part in enumerate(unit.split("/")):
        for factor in re.split(r"[.·*]", part):
            if number == 0 and factor == "1":
                continue
            match = _FACTOR.fullmatch(factor)
            if match is None:
                return None
            power = _RAISED.get(match["power"] or "", 0) or int(match["power"] or 1)
            powers[match["symbol"]] = powers.get(match["symbol"], 0) + (power if number == 0 else -power)
    return powers


def _text(powers: dict[str, int]) -> str:
    """Unit in the notation of logs: m/s/s."""
    above = [f"{name}{_SHOWN.get(power, f'^{power}')}" for name, power in powers.items() if power > 0]
    below = [f"/{name}" * -power for name, power in powers.items() if power < 0]
    return ".".join(above) + "".join(below) if above else "1" + "".join(below) if below else ""


# The functions of the language: their arguments, their effect on arrays and on units.
#
# Angles of sin, cos and tan are radians. wrap180, wrap360 and wrap_pi bring angles and differences of angles into
# ±180, 0 to 360 and ±π. Functions in `TIMED` work along time and get the seconds of their samples first:
#
#      unwrap(x)            an angle without its jumps: of 2π for radians, else of 360
#      diff(x)              from sample to sample; the first is unknown
#      derivative(x)        per second, by the second-order differences of uneven steps
#      integral(x)          over time from the first sample, by the trapezoidal rule; unknown values add nothing
#      smooth(x, seconds)   mean of known values within half of that time before and after

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


def _hypotenuse(*sides: Any) -> Any:
    return np.sqrt(sum(np.square(side, dtype=np.float64) for side in sides))


def _none(units: Sequence[Unit]) -> Unit:
    return None


def _radians(units: Sequence[Unit]) -> Unit:
    return "rad"


ELEMENTWISE: Mapping[str, Function] = {
    "abs": Function(np.abs, same_unit),
    "sign": Function(np.sign, _none),
    "floor": Function(np.floor, same_unit),
    "ceil": Function(np.ceil, same_unit),
    "sqrt": Function(np.sqrt, lambda units: power_unit(units[0], 0.5)),
    "exp": Function(np.exp, _none),
    "log": Function(np.log, _none),
    "log10": Function(np.log10, _none),
    "hypot": Function(_hypotenuse, same_unit, 2, 3),
    "sin": Function(np.sin, _none, angles="rad"),
    "cos": Function(np.cos, _none, angles="rad"),
    "tan": Function(np.tan, _none, angles="rad"),
    "asin": Function(np.arcsin, _radians),
    "acos": Function(np.arccos, _radians),
    "atan": Function(np.arctan, _radians),
    "atan2": Function(np.arctan2, _radians, 2, 2),
    "radians": Function(np.radians, lambda units: _converted(units[0], "deg", "rad"), angles="deg"),
    "degrees": Function(np.degrees, lambda units: _converted(units[0], "rad", "deg"), angles="rad"),
    "wrap180": Function(lambda x: _wrapped(x, 360.0, -180.0), same_unit, angles="deg"),
    "wrap360": Function(lambda x: _wrapped(x, 360.0, 0.0), same_unit, angles="deg"),
    "wrap_pi": Function(lambda x: _wrapped(x, 2.0 * np.pi, -np.pi), same_unit, angles="rad"),
    "min": Function(lambda *values: np.minimum.reduce(np.broadcast_arrays(*values)), same_unit, 2, None),
    "max": Function(lambda *values: np.maximum.reduce(np.broadcast_arrays(*values)), same_unit, 2, None),
    "clip": Function(lambda x, low, high: np.minimum(np.maximum(x, low), high), same_unit, 3, 3),
}


def _converted(unit: Unit, old: str, new: str) -> Unit:
    """Unit after a conversion, also within a rate: deg/s becomes rad/s."""
    factor = product_unit(new, old, -1)
    return new if unit is None or unit == "" else product_unit(unit, factor)


def unwrapped(x: Floats, turn: float) -> Floats:
    """(N,) without jumps of more than half a turn. Unknown values are bridged from the last known value."""
    result = np.array(x, dtype=np.float64)
    known = np.isfinite(result)
    result[known] = np.unwrap(result[known], period=turn)
    return result


def _derivative(seconds: Floats, x: Floats) -> Floats:
    if len(x) < 2:
        return np.full(len(x), np.nan)
    result: Floats = np.gradient(x, seconds)
    return result


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
    means: Floats = (sums[after] - sums[first]) / (counts[after] - counts[first])
    return means


TIMED: Mapping[str, Function] = {
    "unwrap": Function(unwrapped, same_unit),
    "diff": Function(lambda seconds, x: np.diff(x, prepend=np.nan), same_unit),
    "derivative": Function(_derivative, lambda units: product_unit(units[0], "s", -1)),
    "integral": Function(_integral, lambda units: product_unit(units[0], "s")),
    "smooth": Function(_smooth, lambda units: units[0], 2, 2),
}

WHERE = "where"
ARITIES: Mapping[str, tuple[int, int | None]] = {
    **{name: (function.least, function.most) for name, function in {**ELEMENTWISE, **TIMED}.items()},
    WHERE: (3, 3),
}
"""Number of arguments of each function. `where(condition, a, b)` is a if the condition holds, else b."""


COMPARISONS: Mapping[str, Callable[[Any, Any], Any]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
ARITHMETIC: Mapping[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": operator.mod,
    "**": lambda base, exponent: np.power(np.asarray(base, dtype=np.float64), exponent),
}
_SHORT_WAY = "gives the shorter angle"
_ROUND_THE_CIRCLE = frozenset(("sin", "cos", "tan", "wrap180", "wrap360", "wrap_pi", "unwrap", "radians", "degrees"))
_HALF_TURN = {"deg": 180.0, "rad": np.pi}


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """Values with their unit."""

    values: Any
    """(N,), or one for all samples: numbers, truths or texts. None means that a message lacks it."""
    unit: Unit = None

    @property
    def is_text(self) -> bool:
        return isinstance(self.values, str) or (isinstance(self.values, np.ndarray) and self.values.dtype.kind == "U")

    @property
    def is_truth(self) -> bool:
        boolean = isinstance(self.values, np.ndarray) and self.values.dtype.kind == "b"
        return boolean or isinstance(self.values, (bool, np.bool_))

    @property
    def lacking(self) -> bool:
        return self.values is None


LACKING = Quantity(None)


@dataclass(slots=True)
class Evaluation:
    """State of evaluating an expression."""

    text: str
    resolve: Callable[[str], Quantity]
    """Value of a name."""
    seconds: Callable[[], NDArray[np.float64]]
    """Returns (N,) seconds of the samples; called only by functions along time."""
    notes: list[str] = field(default_factory=list)
    """Sentences on probable mistakes, such as degrees as argument of sin; filled by the evaluation."""

    def quantity(self, node: Tree) -> Quantity:
        """Evaluate a node. Raises ExpressionError, and the errors of `resolve`."""
        match node:
            case Number(value=value) | TextLiteral(value=value):
                return Quantity(value)
            case Word(value=value):
                return Quantity(np.bool_(value))
            case Name(path=path):
                return self.resolve(path)
            case Prefix(sign="not", operand=operand):
                return Quantity(np.logical_not(self._truth(operand)))
            case Prefix(sign=sign, operand=operand):
                number = self._number(operand)
                return number if sign == "+" or number.lacking else Quantity(-number.values, number.unit)
            case Junction(sign=sign, parts=parts):
                joins = np.logical_and if sign == "and" else np.logical_or
                result = self._truth(parts[0])
                for part in parts[1:]:
                    result = joins(result, self._truth(part))
                return Quantity(result)
            case Arithmetic(left=left, right=right):
                return self._arithmetic(node, self._number(left), self._number(right))
            case ComparisonChain():
                return self._comparison(node)
            case Call(function=name, arguments=arguments):
                if name == WHERE:
                    truth = self._truth(arguments[0])
                    chosen, other = self._number(arguments[1]), self._number(arguments[2])
                    if chosen.lacking or other.lacking:
                        return LACKING
                    return Quantity(np.where(truth, chosen.values, other.values), same_unit((chosen.unit, other.unit)))
                return self._call(node)
        raise AssertionError(node)

    def _shown(self, node: Tree) -> str:
        return self.text[node.begin : node.end]

    def _comparison(self, node: ComparisonChain) -> Quantity:
        left, result = self.quantity(node.sides[0]), None
        for sign, side in zip(node.signs, node.sides[1:], strict=True):
            right = self.quantity(side)
            if left.lacking or right.lacking:
                result, left = np.False_, right
                continue
            if left.is_text != right.is_text:
                raise ExpressionError("compares a text with a number; put quotes around texts only")
            truth = COMPARISONS[sign](left.values, right.values)
            result = truth if result is None else np.logical_and(result, truth)
            left = right
        return Quantity(result)

    def _arithmetic(self, node: Arithmetic, left: Quantity, right: Quantity) -> Quantity:
        if left.lacking or right.lacking:
            return LACKING
        first, second = left.values, right.values
        if node.sign == "*" or not (isinstance(first, np.ndarray) or isinstance(second, np.ndarray)):
            first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
        values = ARITHMETIC[node.sign](first, second)
        if node.sign in ("*", "/"):
            unit = product_unit(left.unit, right.unit, 1 if node.sign == "*" else -1)
        elif node.sign == "**":
            unit = power_unit(left.unit, float(second)) if np.ndim(second) == 0 else None if left.unit is None else ""
        else:
            unit = same_unit((left.unit, right.unit))
            if left.unit and right.unit and not unit:
                self.notes.append(f"{self._shown(node)} mixes {left.unit} and {right.unit}")
            half = _HALF_TURN.get(unit or "", np.inf)
            if node.sign == "-" and right.unit and np.size(values) and np.nanmax(np.abs(values), initial=0.0) > half:
                wrap = "wrap180" if unit == "deg" else "wrap_pi"
                self.notes.append(f"{self._shown(node)} exceeds half a turn; {wrap}({self._shown(node)}) {_SHORT_WAY}")
        return Quantity(values, unit)

    def _call(self, node: Call) -> Quantity:
        before = len(self.notes)
        values = [self._number(argument) for argument in node.arguments]
        if node.function in _ROUND_THE_CIRCLE:
            self.notes[before:] = [note for note in self.notes[before:] if not note.endswith(_SHORT_WAY)]
        if any(value.lacking for value in values):
            return LACKING
        units = [value.unit for value in values]
        if node.function in TIMED:
            function = TIMED[node.function]
            seconds = self.seconds()
            x = np.broadcast_to(np.asarray(values[0].values, dtype=np.float64), seconds.shape)
            if node.function == "unwrap":
                return Quantity(unwrapped(x, 2.0 * _HALF_TURN.get(units[0] or "", 180.0)), units[0])
            further = [value.values for value in values[1:]]
            if any(np.ndim(value) or not value > 0.0 for value in further):
                raise ExpressionError(f"contains {self._shown(node)}: the time must be a number of seconds above 0")
            return Quantity(function.apply(seconds, x, *further), function.unit(units))
        function = ELEMENTWISE[node.function]
        wrong = {"deg": "rad", "rad": "deg"}.get(function.angles)
        if wrong is not None and units[0] == wrong:
            argument = self._shown(node.arguments[0])
            converter = "radians" if function.angles == "rad" else "degrees"
            better = f"{node.function}({converter}({argument}))"
            if node.function in ("radians", "degrees"):
                better = argument
            self.notes.append(f"{self._shown(node)} takes {function.angles} and gets {wrong}; write {better}")
        numbers = [np.asarray(value.values, dtype=np.float64) for value in values]
        return Quantity(function.apply(*numbers), function.unit(units))

    def _number(self, node: Tree) -> Quantity:
        value = self.quantity(node)
        if value.is_text or value.is_truth:
            raise ExpressionError(f"cannot be evaluated: {self._shown(node)!r} is not a number")
        return value

    def _truth(self, node: Tree) -> Any:
        value = self.quantity(node)
        if not value.is_truth:
            raise ExpressionError(
                f"cannot be evaluated: {self._shown(node)!r} is not a condition; compare it, such as '… > 0'"
            )
        return value.values
