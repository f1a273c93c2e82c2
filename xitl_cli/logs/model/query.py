"""What a user picks out of a log by words: messages, a span of time, a condition; and the rows that remain.

A condition is on the rows of a message: `Roll > 5 and I == 0`, `abs(GyrX) >= 0.1`, `Name == 'ATC_RATE'`. It is in
Python's own grammar, of which little is allowed: names of fields, numbers and texts, comparisons, and, or, not,
+ - * / %, abs, and [k] for an element of an array. It is evaluated on whole columns; nothing of it is run.
"""

from __future__ import annotations

import ast
import math
import operator
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Rows, Table, column_named
from xitl_cli.logs.model.text import resolve_name

NS_PER_S = 1_000_000_000
_FIRST, _MOST = 256, 16_384
_SEQUENTIAL_BYTES = 64 << 20
_LONGEST = 1000
_DEEPEST = 50
_ALLOWED = "names, numbers, 'texts', == != < <= > >=, and, or, not, + - * / %, abs() and [0]"
TIME = "time_s"

_COMPARISONS: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_ARITHMETIC: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
}


@dataclass(frozen=True, slots=True)
class NamedTables:
    """tables: in the order of the names, each once. rowless: those that the log knows and has no row of."""

    tables: tuple[Table, ...]
    rowless: tuple[str, ...]


def tables_named(log: Log, wanted: Iterable[str]) -> NamedTables:
    """The tables of messages or topics; "IMU,ATT" are two names. Raises LogError."""
    names = [name.strip() for text in wanted for name in text.split(",") if name.strip()]
    if not len(log):
        raise LogError(f"{log.path}: holds no message that can be read; `xitl logs info` says what is wrong with it")
    known = {name.casefold(): name for name in log.rowless}
    without = {name: known[name.casefold()] for name in names if name.casefold() in known}
    tables = {table.name: table for table in (log[name] for name in names if name not in without)}
    return NamedTables(tuple(tables.values()), tuple(dict.fromkeys(without.values())))


def stamps_between(log: Log, from_s: float | None, until_s: float | None) -> tuple[int | None, int | None]:
    """First and last stamp of a span given in seconds. Raises LogError for an empty span."""
    for option, value in (("--from", from_s), ("--until", until_s)):
        if value is not None and not (math.isfinite(value) and abs(value) < 9e9):
            raise LogError(f"{option} = {value} is no time in a log; give seconds since {log.zero_in_words}")
    if from_s is not None and until_s is not None and until_s < from_s:
        raise LogError(f"--until = {until_s:g} is before --from = {from_s:g}; swap them")
    zero = log.zero_ns
    from_ns = None if from_s is None else zero + round(from_s * NS_PER_S)
    until_ns = None if until_s is None else zero + round(until_s * NS_PER_S)
    return from_ns, until_ns


class Condition:
    """A parsed condition. Raises LogError when `text` is none. names: of the fields in it."""

    def __init__(self, text: str) -> None:
        self.text = text
        if len(text) > _LONGEST:
            raise LogError(f"the condition is {len(text)} characters long; {_LONGEST} are allowed")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # Python's advice on programs
                self._tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            reason = error.msg if isinstance(error, SyntaxError) else "it cannot be read"
            raise LogError(f"{text!r} is no condition ({reason}); write one such as 'Roll > 5 and I == 0'") from error
        if _depth(self._tree) > _DEEPEST:
            raise LogError(f"{text!r} is nested more than {_DEEPEST} deep; write it simpler")
        self.names = tuple(dict.fromkeys(_names(self._tree)))

    def lacked(self, tables: Sequence[Table]) -> dict[str, list[str]]:
        """By table, the fields that the condition names and it lacks. Raises LogError for one that none of them has."""
        lacked: dict[str, list[str]] = {}
        for name in self.names:
            without = [table for table in tables if not _has(table, name)]
            if len(without) == len(tables) > 1:
                every = [column for table in tables for column in table.columns]
                lacks = f"none of {', '.join(table.name for table in tables)} has a field"
                resolve_name(name, dict.fromkeys(every), lacks, "`xitl logs info --fields` lists them")
            for table in without:
                lacked.setdefault(table.name, []).append(name)
        return lacked if len(tables) > 1 else {}

    def holds(
        self, table: Table, rows: Rows, zero_ns: int, *, raw: bool = False, lacks: Collection[str] = ()
    ) -> NDArray[np.bool_]:
        """(n,) whether the condition holds in each of these rows; a comparison with NaN does not, nor one with a field
        among those that the table `lacks`. Raises LogError."""
        with np.errstate(all="ignore"):
            result = _Evaluation(self.text, table, rows, zero_ns, raw, lacks).of(self._tree)
        if not _is_truth(result):
            raise LogError(f"{self.text!r} is a value and no condition; compare it with something, such as '… > 0'")
        count = len(table.stamp_ns[rows])
        return np.broadcast_to(np.asarray(result, dtype=np.bool_), (count,))


class _Lacking:
    """What stands for a field that a message does not have."""


_LACKING = _Lacking()


class _Evaluation:
    def __init__(self, text: str, table: Table, rows: Rows, zero_ns: int, raw: bool, lacks: Collection[str]) -> None:
        self._text, self._table, self._rows, self._zero_ns, self._raw = text, table, rows, zero_ns, raw
        self._lacks = lacks

    def of(self, node: ast.expr) -> Any:
        match node:
            case ast.Constant(value=bool() | str() as value):
                return value
            case ast.Constant(value=int() | float() as value):
                return value if abs(value) < 2**62 else float(value)
            case ast.Name() | ast.Attribute():
                return self._column(self._dotted(node))
            case ast.Subscript(value=ast.Name() | ast.Attribute() as array, slice=ast.Constant(value=int() as element)):
                return self._element(self._dotted(array), element)
            case ast.UnaryOp(op=ast.Not()):
                return np.logical_not(self._truth(node.operand))
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign):
                value = self._number(node.operand)
                return -value if isinstance(sign, ast.USub) and value is not _LACKING else value
            case ast.BoolOp(op=joined, values=values):
                joins = np.logical_and if isinstance(joined, ast.And) else np.logical_or
                result = self._truth(values[0])
                for value_node in values[1:]:
                    result = joins(result, self._truth(value_node))
                return result
            case ast.BinOp(left=left, op=sign, right=right) if type(sign) in _ARITHMETIC:
                return self._arithmetic(type(sign), self._number(left), self._number(right))
            case ast.Call(func=ast.Name(id="abs"), args=[argument], keywords=[]):
                value = self._number(argument)
                return value if value is _LACKING else np.abs(value)
            case ast.Compare(left=first, ops=signs, comparators=others):
                return self._comparison(first, signs, others)
        raise LogError(f"{self._text!r}: {ast.unparse(node)!r} is not allowed in a condition; there are {_ALLOWED}")

    def _comparison(self, first: ast.expr, signs: list[ast.cmpop], others: list[ast.expr]) -> Any:
        left, result = self.of(first), None
        for sign, node in zip(signs, others, strict=True):
            compare = _COMPARISONS.get(type(sign))
            if compare is None:
                raise LogError(f"{self._text!r}: there is no `in` or `is` in a condition; there are {_ALLOWED}")
            right = self.of(node)
            if left is _LACKING or right is _LACKING:
                result, left = np.False_, right
                continue
            if _is_text(left) != _is_text(right):
                raise LogError(f"{self._text!r} compares a text with a number; put texts in quotes, numbers not")
            truth = compare(left, right)
            result = truth if result is None else np.logical_and(result, truth)
            left = right
        return result

    def _arithmetic(self, sign: type[ast.operator], left: Any, right: Any) -> Any:
        if left is _LACKING or right is _LACKING:
            return _LACKING
        if sign is ast.Mult or not (isinstance(left, np.ndarray) or isinstance(right, np.ndarray)):
            left, right = np.asarray(left, dtype=np.float64), np.asarray(right, dtype=np.float64)
        return _ARITHMETIC[sign](left, right)

    def _number(self, node: ast.expr) -> Any:
        value = self.of(node)
        if _is_text(value) or _is_truth(value):
            raise LogError(f"{self._text!r}: {ast.unparse(node)!r} is no number, nothing can be worked out with it")
        return value

    def _truth(self, node: ast.expr) -> Any:
        value = self.of(node)
        if not _is_truth(value):
            raise LogError(f"{self._text!r}: {ast.unparse(node)!r} is no condition; compare it, such as '… > 0'")
        return value

    def _dotted(self, node: ast.expr) -> str:
        if isinstance(node, ast.Attribute):
            return f"{self._dotted(node.value)}.{node.attr}"
        if isinstance(node, ast.Name):
            return node.id
        raise LogError(f"{self._text!r}: {ast.unparse(node)!r} is no name of a field; there are {_ALLOWED}")

    def _column(self, name: str) -> Any:
        if name in self._lacks:
            return _LACKING
        if name == TIME and TIME not in self._table.columns:
            return (self._table.stamp_ns[self._rows] - self._zero_ns) * 1e-9
        column = self._table.columns[column_named(self._table, name)]
        if column.shape:
            raise LogError(f"{self._text!r}: {column.name} of {self._table.name} is an array; write {column.name}[0]")
        return self._values(column.name)

    def _element(self, name: str, element: int) -> Any:
        if name in self._lacks:
            return _LACKING
        column = self._table.columns[column_named(self._table, name)]
        if len(column.shape) != 1:
            raise LogError(f"{self._text!r}: {column.name} of {self._table.name} is no array; leave [{element}] out")
        values = self._values(column.name)
        if not 0 <= element < values.shape[1]:
            raise LogError(
                f"{self._text!r}: {column.name} of {self._table.name} has {values.shape[1]} elements, from 0"
            )
        return values[:, element]

    def _values(self, column: str) -> NDArray[Any]:
        values = self._table.values(column, self._rows, raw=self._raw)
        if self._table.columns[column].kind == "bytes":
            raise LogError(f"{self._text!r}: {column} of {self._table.name} is bytes, which are not compared")
        if values.dtype.kind in "iu":  # small ones would wrap round
            return values.astype(np.float64 if values.dtype == np.uint64 else np.int64)
        return values


def _depth(tree: ast.AST) -> int:
    deepest, level = 0, [tree]
    while level:
        deepest += 1
        level = [child for node in level for child in ast.iter_child_nodes(node)]
    return deepest


def _names(tree: ast.AST) -> Iterator[str]:
    """Of the fields, as they are written; of what is no condition at all some of them."""
    if isinstance(tree, ast.Name | ast.Attribute):
        yield ast.unparse(tree)
        return
    for child in ast.iter_child_nodes(tree):
        if not (isinstance(tree, ast.Call) and child is tree.func):
            yield from _names(child)


def _has(table: Table, name: str) -> bool:
    return name == TIME or name.casefold() in {column.casefold() for column in table.columns}


def _is_text(value: Any) -> bool:
    return isinstance(value, str) or (isinstance(value, np.ndarray) and value.dtype.kind == "U")


def _is_truth(value: Any) -> bool:
    return isinstance(value, (bool, np.bool_)) or (isinstance(value, np.ndarray) and value.dtype.kind == "b")


@dataclass(frozen=True, slots=True)
class RowBatch:
    """Rows of one part of the file. rows: of each table, ascending; order: (n,) which table's next row comes when."""

    rows: tuple[NDArray[np.intp], ...]
    order: NDArray[np.intp]

    def first(self, count: int | None) -> RowBatch:
        """The first `count` rows; all for None."""
        if count is None or count >= len(self.order):
            return self
        order = self.order[:count]
        return RowBatch(tuple(rows[: np.count_nonzero(order == own)] for own, rows in enumerate(self.rows)), order)


def merge_rows(
    tables: Sequence[Table],
    from_ns: int | None,
    until_ns: int | None,
    condition: Condition | None,
    zero_ns: int,
    at_once: int = _MOST,
    *,
    raw: bool = False,
) -> Iterator[RowBatch]:
    """Rows of several tables in the order of the file, in batches that begin small: only what is used is read."""
    lacked = condition.lacked(tables) if condition is not None else {}
    if condition is not None:
        for table in tables:  # what is wrong with it is said now, not after a thousand rows
            condition.holds(table, slice(0, 1), zero_ns, raw=raw, lacks=lacked.get(table.name, ()))
    chosen = [rows_between(table, from_ns, until_ns) for table in tables]
    owner = np.concatenate([np.full(len(rows), number, np.intp) for number, rows in enumerate(chosen)])
    rows = np.concatenate(chosen)
    if len(tables) > 1:
        place = np.concatenate([table.file_offset[rows] for table, rows in zip(tables, chosen, strict=True)])
        order = np.argsort(place, kind="stable")
        owner, rows = owner[order], rows[order]
    begin, size = 0, _FIRST
    while begin < len(rows):
        some = slice(begin, begin + size)
        batch = _batch(tables, owner[some], rows[some], condition, lacked, zero_ns, raw)
        if len(batch.order):
            yield batch
        begin, size = begin + size, min(size * 2, at_once)


def rows_at_once(log: Log, tables: Sequence[Table]) -> int:
    """Batch size: large for a recording, which is read from its beginning for any of its rows, else small."""
    if log.format != "mcap":
        return _MOST
    widest = max(sum(math.prod(map(abs, column.shape)) for column in table.columns.values()) for table in tables)
    return max(_MOST, _SEQUENTIAL_BYTES // (8 * max(widest, 1)))


def rows_between(table: Table, from_ns: int | None, until_ns: int | None) -> NDArray[np.intp]:
    """Rows stamped from `from_ns` to `until_ns`, both included; None: no limit."""
    if from_ns is None and until_ns is None:
        return np.arange(len(table), dtype=np.intp)
    stamps = table.stamp_ns
    inside = np.ones(len(stamps), dtype=np.bool_)
    if from_ns is not None:
        inside &= stamps >= from_ns
    if until_ns is not None:
        inside &= stamps <= until_ns
    return np.flatnonzero(inside)


def _batch(
    tables: Sequence[Table],
    owner: NDArray[np.intp],
    rows: NDArray[np.intp],
    condition: Condition | None,
    lacked: Mapping[str, Collection[str]],
    zero_ns: int,
    raw: bool,
) -> RowBatch:
    kept = np.ones(len(rows), dtype=np.bool_)
    if condition is not None:
        for number, table in enumerate(tables):
            own = np.flatnonzero(owner == number)
            if len(own):
                lacks = lacked.get(table.name, ())
                kept[own] = condition.holds(table, rows[own], zero_ns, raw=raw, lacks=lacks)
    owner, rows = owner[kept], rows[kept]
    return RowBatch(tuple(rows[owner == number] for number in range(len(tables))), owner)
