"""Constraints and verdicts of a plan: expressions over named values, in the language of the logs.

mission.cross_track_rms_m < 2 and driver.completed
abs(environment.wind.mean_mps - 4) + 2 * faults.lossy-link.link.loss <= 8

A value may be unknown (None) for a run that ended early. A result that depends on it is unknown too.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.logs.expressions.evaluation import ARITHMETIC, ARITIES, COMPARISONS, ELEMENTWISE
from xitl_cli.logs.expressions.syntax import (
    Arithmetic,
    Call,
    ComparisonChain,
    ExpressionError,
    Junction,
    Language,
    Name,
    Number,
    Prefix,
    TextLiteral,
    Tree,
    Word,
    names_in,
    parse,
)

__all__ = ["Expression", "ExpressionError", "Value", "parse_expression"]

Value: TypeAlias = float | int | str | bool | None

_LANGUAGE = Language(
    "expression",
    "mission.cross_track_rms_m < 2",
    {name: ARITIES[name] for name in ELEMENTWISE},
    null=True,
    elements=False,
)


def _power(base: float, exponent: float) -> float | None:
    """Return None for a complex power, such as that of a negative number with a broken exponent."""
    power = float(base) ** float(exponent)
    return None if isinstance(power, complex) else power


_SCALAR: Mapping[str, Callable[[Any, Any], Any]] = {**ARITHMETIC, "**": _power}
_PREFIXES: Mapping[str, Callable[[Any], Any]] = {"not": operator.not_, "-": operator.neg, "+": operator.pos}


@dataclass(frozen=True, slots=True)
class Expression:
    """A parsed expression."""

    text: str
    """The text as written."""
    names: tuple[str, ...]
    """Dotted names of the needed values."""
    _tree: Tree

    def value(self, values: Mapping[str, Any]) -> Value:
        """Return its result for these values by name; None if it depends on an unknown value or cannot be computed.

        `and` and `or` use known values: false and unknown is false. Raises ExpressionError for a mix of text and
        numbers.
        """
        try:
            found = self._evaluate(self._tree, values)
        except (ZeroDivisionError, OverflowError):
            return None
        except TypeError as error:
            raise ExpressionError(f"cannot be computed ({error}); compare values of one kind") from None
        return None if isinstance(found, float) and math.isnan(found) else found

    def holds(self, values: Mapping[str, Any]) -> bool | None:
        """Return the result as true, false or unknown."""
        found = self.value(values)
        return None if found is None else bool(found)

    def _evaluate(self, node: Tree, values: Mapping[str, Any]) -> Any:
        match node:
            case Number(value=value) | TextLiteral(value=value) | Word(value=value):
                return value
            case Name(path=path):
                return values[path]
            case Junction(sign=sign, parts=parts):
                wanted = sign == "or"
                known: bool | None = not wanted
                for node in parts:
                    found = self._evaluate(node, values)
                    if found is not None and bool(found) is wanted:
                        return wanted
                    known = None if found is None else known
                return known
            case Prefix(sign=sign, operand=operand):
                inner = self._evaluate(operand, values)
                if inner is None:
                    return None
                return _PREFIXES[sign](inner)
            case ComparisonChain():
                left = self._evaluate(node.sides[0], values)
                result: bool | None = True
                for sign, side in zip(node.signs, node.sides[1:], strict=True):
                    right = self._evaluate(side, values)
                    if left is None or right is None:
                        result = None
                    elif not COMPARISONS[sign](left, right):
                        return False
                    left = right
                return result
            case Arithmetic(sign=sign, left=left, right=right):
                sides = [self._evaluate(left, values), self._evaluate(right, values)]
                if any(isinstance(side, str) for side in sides):  # Python repeats, joins and formats texts
                    raise TypeError(f"{sign} of a text")
                return None if None in sides else _SCALAR[sign](*sides)
            case Call(function=function, arguments=arguments):
                numbers = [self._evaluate(one, values) for one in arguments]
                return None if None in numbers else _called(function, numbers)
        raise AssertionError(node)


def _called(function: str, numbers: list[Any]) -> float | None:
    """Return None for an undefined result, such as the root of a negative number."""
    with np.errstate(all="ignore"):
        found = float(ELEMENTWISE[function].apply(*numbers))
    return found if math.isfinite(found) else None


def parse_expression(text: str, known: Iterable[str] = ()) -> Expression:
    """Return the expression in `text`. known: names with characters outside words, such as `faults.lossy-link`.

    Raises ExpressionError.
    """
    tree = parse(text, _LANGUAGE, known)
    names = tuple(dict.fromkeys(names_in(tree)))
    if function := next((name for name in names if name in _LANGUAGE.functions), None):
        raise ExpressionError(f"names the function {function} without its values; write {function}(…)")
    return Expression(text, names, tree)
