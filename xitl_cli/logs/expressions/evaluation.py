"""Evaluation of a tree over arrays: numbers, truths and texts, one per sample, with the unit of the result."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.expressions.functions import ELEMENTWISE, TIMED, WHERE, unwrapped
from xitl_cli.logs.expressions.syntax import (
    Arithmetic,
    Call,
    ComparisonChain,
    ExpressionError,
    Junction,
    Name,
    Number,
    Prefix,
    Text,
    Tree,
    Word,
)
from xitl_cli.logs.expressions.units import Unit, power_unit, product_unit, same_unit

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
_SHORT_WAY = "is the short way round"
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
            case Number(value=value) | Text(value=value):
                return Quantity(value)
            case Word(value=value):
                return Quantity(np.bool_(value))
            case Name(path=path):
                return self.resolve(path)
            case Prefix(sign="not", operand=operand):
                return Quantity(np.logical_not(self._truth(operand)))
            case Prefix(sign=sign, operand=operand):
                found = self._number(operand)
                return found if sign == "+" or found.lacking else Quantity(-found.values, found.unit)
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
                    truth, chosen, other = (
                        self._truth(arguments[0]),
                        self._number(arguments[1]),
                        self._number(arguments[2]),
                    )
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
                raise ExpressionError("compares a text with a number; put texts in quotes, numbers not")
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
                self.notes.append(f"{self._shown(node)} is of {left.unit} and {right.unit}")
            half = _HALF_TURN.get(unit or "", np.inf)
            if node.sign == "-" and right.unit and np.size(values) and np.nanmax(np.abs(values), initial=0.0) > half:
                wrap = "wrap180" if unit == "deg" else "wrap_pi"
                self.notes.append(
                    f"{self._shown(node)} goes beyond half a turn; {wrap}({self._shown(node)}) {_SHORT_WAY}"
                )
        return Quantity(values, unit)

    def _call(self, node: Call) -> Quantity:
        told = len(self.notes)
        values = [self._number(argument) for argument in node.arguments]
        if node.function in _ROUND_THE_CIRCLE:
            self.notes[told:] = [note for note in self.notes[told:] if not note.endswith(_SHORT_WAY)]
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
            if any(np.ndim(each) or not each > 0.0 for each in further):
                raise ExpressionError(f"holds {self._shown(node)}: its time is a number of seconds above 0")
            return Quantity(function.apply(seconds, x, *further), function.unit(units))
        function = ELEMENTWISE[node.function]
        given = {"deg": "rad", "rad": "deg"}.get(function.angles)
        if given is not None and units[0] == given:
            argument = self._shown(node.arguments[0])
            turned = "radians" if function.angles == "rad" else "degrees"
            better = argument if node.function in ("radians", "degrees") else f"{node.function}({turned}({argument}))"
            self.notes.append(f"{self._shown(node)} takes {function.angles} and gets {given}; write {better}")
        numbers = [np.asarray(value.values, dtype=np.float64) for value in values]
        return Quantity(function.apply(*numbers), function.unit(units))

    def _number(self, node: Tree) -> Quantity:
        value = self.quantity(node)
        if value.is_text or value.is_truth:
            raise ExpressionError(f"cannot be worked out: {self._shown(node)!r} is no number")
        return value

    def _truth(self, node: Tree) -> Any:
        value = self.quantity(node)
        if not value.is_truth:
            raise ExpressionError(
                f"cannot be worked out: {self._shown(node)!r} is no condition; compare it, such as '… > 0'"
            )
        return value.values
