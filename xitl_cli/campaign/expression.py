"""Constraints and verdicts of a plan: arithmetic and comparisons over named values, read by a parser of their own.

mission.cross_track_rms_m < 2 and driver.completed
abs(environment.wind.mean_mps - 4) + 2 * faults.lossy-link.link.loss <= 8
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

Value: TypeAlias = float | int | str | bool | None

LONGEST = 1000
_PATH = re.compile(r"[A-Za-z_]\w*(?:\s*\.\s*\w+)+")
_TEXT = re.compile(r"'[^']*'|\"[^\"]*\"")
_WORDS: dict[str, Value] = {"true": True, "false": False, "null": None, "True": True, "False": False, "None": None}
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": abs,
    "min": min,
    "max": max,
    "sqrt": math.sqrt,
    "log": math.log,
    "log10": math.log10,
    "exp": math.exp,
}
_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.Pow: lambda base, exponent: float(base) ** float(exponent),
}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}


class ExpressionError(ValueError):
    """What is wrong with an expression and what to write, to follow the expression itself."""


@dataclass(frozen=True, slots=True)
class Expression:
    """text: as written. names: the values that it needs, dotted."""

    text: str
    names: tuple[str, ...]
    _tree: ast.expr
    _placeholders: Mapping[str, str]

    def value(self, values: Mapping[str, Any]) -> Value:
        """What it says of these values by name; None where that hangs on one that is None or cannot be computed.

        `and` and `or` go by what is known: false and unknown is false. Raises ExpressionError where text meets numbers.
        """
        try:
            found = self._evaluate(self._tree, values)
        except (ZeroDivisionError, OverflowError):
            return None
        except ValueError:  # the root of a negative number
            return None
        except TypeError as error:
            raise ExpressionError(f"cannot be computed ({error}); compare values of one kind") from None
        return None if isinstance(found, complex) or (isinstance(found, float) and math.isnan(found)) else found

    def holds(self, values: Mapping[str, Any]) -> bool | None:
        """The same as true, false or unknown."""
        found = self.value(values)
        return None if found is None else bool(found)

    def _evaluate(self, node: ast.expr, values: Mapping[str, Any]) -> Any:
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Name):
            return values[self._placeholders[node.id]] if node.id in self._placeholders else _WORDS[node.id]
        if isinstance(node, ast.BoolOp):
            return self._either(isinstance(node.op, ast.Or), node.values, values)
        if isinstance(node, ast.UnaryOp):
            inner = self._evaluate(node.operand, values)
            if inner is None:
                return None
            if isinstance(node.op, ast.Not):
                return not inner
            return -inner if isinstance(node.op, ast.USub) else inner
        if isinstance(node, ast.Compare):
            return self._compared(node, values)
        if isinstance(node, ast.BinOp):
            sides = [self._evaluate(node.left, values), self._evaluate(node.right, values)]
            return None if None in sides else _BINARY[type(node.op)](*sides)
        assert isinstance(node, ast.Call)
        assert isinstance(node.func, ast.Name)
        arguments = [self._evaluate(one, values) for one in node.args]
        return None if None in arguments else _FUNCTIONS[node.func.id](*arguments)

    def _either(self, wanted: bool, nodes: Iterable[ast.expr], values: Mapping[str, Any]) -> bool | None:
        known: bool | None = not wanted
        for node in nodes:
            found = self._evaluate(node, values)
            if found is not None and bool(found) is wanted:
                return wanted
            known = None if found is None else known
        return known

    def _compared(self, node: ast.Compare, values: Mapping[str, Any]) -> bool | None:
        left = self._evaluate(node.left, values)
        result: bool | None = True
        for kind, right_node in zip(node.ops, node.comparators, strict=True):
            right = self._evaluate(right_node, values)
            if left is None or right is None:
                result = None
            elif not _COMPARE[type(kind)](left, right):
                return False
            left = right
        return result


def parse_expression(text: str, known: Iterable[str] = ()) -> Expression:
    """The expression in `text`. known: names that may hold what is no part of a word, such as `faults.lossy-link`.

    Raises ExpressionError.
    """
    if len(text) > LONGEST:
        raise ExpressionError(f"is longer than {LONGEST} characters; make several of it")
    placeholders: dict[str, str] = {}
    source = _with_placeholders(text, sorted(known, key=len, reverse=True), placeholders)
    try:
        tree = ast.parse(source.strip(), mode="eval").body
        _check(tree, placeholders)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        if isinstance(error, ExpressionError):
            raise
        raise ExpressionError("is no expression; write for example mission.cross_track_rms_m < 2") from None
    return Expression(text, tuple(dict.fromkeys(placeholders.values())), tree, placeholders)


def _with_placeholders(text: str, known: list[str], placeholders: dict[str, str]) -> str:
    """Names become words of their own, as Python knows no `links.0.lost`; what stands in quotes stays as it is."""

    def placeholder(name: str) -> str:
        name = re.sub(r"\s", "", name)
        for word, meant in placeholders.items():
            if meant == name:
                return f" {word} "
        word = f"_xitl_{len(placeholders)}"
        placeholders[word] = name
        return f" {word} "

    parts, at = [], 0
    for quoted in [*_TEXT.finditer(text), None]:
        plain = text[at : quoted.start() if quoted else len(text)]
        alternatives = [rf"(?<![\w.]){re.escape(name)}(?![\w.])" for name in known] + [_PATH.pattern]
        parts.append(re.sub("|".join(alternatives), lambda match: placeholder(match[0]), plain))
        if quoted:
            parts.append(quoted[0])
            at = quoted.end()
    source = "".join(parts)
    for match in re.finditer(r"(?<![\w'\".])[A-Za-z_]\w*(?!\w*\s*\()", _TEXT.sub("''", source)):
        word = match[0]
        if word not in placeholders and word not in _WORDS and word not in ("and", "or", "not"):
            placeholders[word] = word  # a name without dots, such as `seed`
    return source


def _check(node: ast.AST, placeholders: Mapping[str, str]) -> None:
    if isinstance(node, ast.Constant):
        if not isinstance(node.value, (int, float, str, bool)) or isinstance(node.value, complex):
            raise ExpressionError("holds a value that is neither number nor text; leave it out")
        return
    if isinstance(node, ast.Name):
        if node.id in _FUNCTIONS and node.id in placeholders:
            raise ExpressionError(f"names the function {node.id} without its values; write {node.id}(…)")
        if node.id not in placeholders and node.id not in _WORDS:
            raise ExpressionError(f"holds {node.id}, which is no name; write dotted names, numbers and text in quotes")
        return
    if isinstance(node, ast.Call):
        if not isinstance(node.func, ast.Name) or node.func.id not in _FUNCTIONS or node.keywords:
            raise ExpressionError(f"calls what is not known; there are {', '.join(_FUNCTIONS)}")
        children: list[ast.expr] = list(node.args)
    elif isinstance(node, ast.BoolOp):
        children = node.values
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Not, ast.USub, ast.UAdd)):
        children = [node.operand]
    elif isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        children = [node.left, node.right]
    elif isinstance(node, ast.Compare) and all(type(kind) in _COMPARE for kind in node.ops):
        children = [node.left, *node.comparators]
    else:
        raise ExpressionError(
            "holds what no expression has; there are + - * / % **, comparisons, and, or, not, parentheses and "
            + ", ".join(_FUNCTIONS)
        )
    for child in children:
        _check(child, placeholders)
