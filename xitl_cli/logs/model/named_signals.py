"""Signals of a log by the names and expressions that a user types: ATT.Roll, IMU[1].AccX, hypot(XKF1.VN, XKF1.VE).

Signals of different messages are resampled at the stamps of the message with the most rows, within their common span.
Numbers are interpolated linearly, angles along the shorter arc. Whole numbers without a unit (modes, counts, flags)
hold their last value. In a pause of ten intervals and more than a second, the value is unknown.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from xitl_cli.logs.expressions.evaluation import ARITIES, Evaluation, Quantity
from xitl_cli.logs.expressions.syntax import ExpressionError, Language, Name, Tree, names_in, parse
from xitl_cli.logs.model.errors import LogError, UnknownNameError
from xitl_cli.logs.model.table import Floats, Stamps, Table, by_instance, column_named, rising, seconds_since
from xitl_cli.logs.model.text import resolve_name

TIME = "time_s"
SIGNALS = Language("expression", "hypot(XKF1.VN, XKF1.VE)", ARITIES)

TIME_FIELDS = frozenset(
    ("TimeUS", "TimeMS", "time_boot_ms", "time_usec", "time_unix_usec", "stamp", "header.stamp", "timestamp")
)
"""Time fields of DataFlash, MAVLink, ROS 2 and Foxglove. They rise steadily and are not signals."""

_MOST_COMPONENTS = 32
_LEAST_PAUSE_NS, _PAUSE_IN_INTERVALS = 1_000_000_000, 10
_TURNS = {"deg": 360.0, "rad": 2.0 * np.pi}
_REST = re.compile(r"(?:\[(?P<instance>\d+)\])?(?:\.(?P<column>.+))?")
_INDEXED = re.compile(r"(?P<column>.+)\[(?P<index>\d+)\]")


@dataclass(frozen=True, slots=True, eq=False)
class LogSignal:
    """One signal of a log. A field has its logged stamps; an expression has the stamps of `base`, rising."""

    name: str
    """As a user would type it."""
    unit: str
    """Empty if unknown."""
    stamp_ns: Stamps
    """(N,)"""
    values: Floats
    """(N,)"""
    base: str
    zero_ns: int = 0
    """The stamp from which seconds count."""
    held: bool = False
    """A state, which lasts until the next row."""
    interpolated: tuple[str, ...] = ()
    """Messages that were resampled at the stamps of `base`."""
    notes: tuple[str, ...] = ()
    """Sentences on possible misunderstandings."""

    @property
    def time_s(self) -> Floats:
        """(N,) seconds since the log's own zero."""
        return seconds_since(self.zero_ns, self.stamp_ns)

    @property
    def time_base(self) -> str:
        """Sentence on the stamps of the signal; "" if it uses only one message."""
        if not self.interpolated:
            return ""
        return f"{self.name}: at the times of {self.base}, with {', '.join(self.interpolated)} resampled"


class SignalSource(Protocol):
    """Part of a log that the search for signals needs."""

    path: Path

    @property
    def rowless(self) -> Collection[str]:
        """Names of messages without a row."""

    @property
    def tables(self) -> Mapping[str, Table]:
        """Tables by name."""

    @property
    def zero_ns(self) -> int:
        """Instant of the log's zero on its own clock."""


def find_signal(log: SignalSource, text: str, *, raw: bool = False) -> LogSignal:
    """Return the signal of a name or an expression. Of a message with instances, take the lowest. Raises LogError."""
    tree = parsed_signal(text, [log])
    if isinstance(tree, Name) or tree is None:
        return _single(log, text.strip(), raw)
    return expression_signal(log, text.strip(), tree, raw=raw)


def signals_named(logs: Sequence[SignalSource], wanted: str, *, raw: bool = False) -> list[list[LogSignal]]:
    """For each log, the signals that match a name or an expression. Raises LogError if no log has any.

    The name of a message selects all its fields, for each instance. An expression uses the lowest instance.
    """
    tree = parsed_signal(wanted, logs)
    signals: list[list[LogSignal]] = []
    refusals: list[LogError] = []
    for log in logs:
        try:
            if isinstance(tree, Name) or tree is None:
                signals.append(named_signals(log, wanted.strip(), raw))
            else:
                signals.append([expression_signal(log, wanted.strip(), tree, raw=raw)])
        except LogError as error:
            signals.append([])
            refusals.append(error)
    if len(refusals) == len(logs):
        raise refusals[0]
    return signals


def parsed_signal(text: str, logs: Sequence[SignalSource]) -> Tree | None:
    """Expression tree of the text; None if the text is the plain name of a signal. Raises LogError."""
    try:
        return parse(text, SIGNALS, [name for log in logs for name in log.tables])
    except ExpressionError as error:
        for log in logs:
            if table_of(log, text.strip()) is not None and not re.search(r"[\s()+*%<>=,]", text.strip()):
                return None
        raise LogError(f"{text!r} {error}") from None


def expression_signal(log: SignalSource, text: str, tree: Tree, *, raw: bool = False) -> LogSignal:
    """Evaluate an expression. Raises LogError."""
    paths = [path for path in dict.fromkeys(names_in(tree)) if path.casefold() != TIME]
    signals = {path: _single(log, path, raw) for path in paths}
    if not signals:
        raise LogError(f"{text!r} contains no signal; add one, such as ATT.Roll")
    stamp_ns, base = _time_base(text, list(signals.values()))
    values: dict[str, Quantity] = {}
    for path, signal in signals.items():
        if signal.base == base:
            span = (signal.stamp_ns >= stamp_ns[0]) & (signal.stamp_ns <= stamp_ns[-1])
            values[path] = Quantity(signal.values[rising(signal.stamp_ns) & span], signal.unit)
        else:
            values[path] = Quantity(interpolation(signal)(stamp_ns), signal.unit)
    seconds = seconds_since(log.zero_ns, stamp_ns)
    evaluation = Evaluation(text, lambda path: values.get(path) or Quantity(seconds, "s"), lambda: seconds)
    try:
        with np.errstate(all="ignore"):
            result = evaluation.quantity(tree)
    except ExpressionError as error:
        raise LogError(f"{text!r} {error}") from None
    if result.is_text:
        raise LogError(f"{text!r} is a text, not a signal; compare it with another text")
    others = tuple(dict.fromkeys(signal.base for signal in signals.values() if signal.base != base))
    numbers = np.broadcast_to(np.asarray(result.values, dtype=np.float64), stamp_ns.shape).copy()
    notes = tuple(dict.fromkeys(evaluation.notes))
    return LogSignal(
        text, result.unit or "", stamp_ns, numbers, base, log.zero_ns, result.is_truth, others, notes
    )  # fmt: skip


def _time_base(text: str, signals: Sequence[LogSignal]) -> tuple[Stamps, str]:
    """Rising stamps of the signal with the most rows, within the common span of all, and its message."""
    cleaned = {signal.base: rising(signal.stamp_ns) for signal in signals}
    stamps = {signal.base: signal.stamp_ns[cleaned[signal.base]] for signal in signals}
    begin = max(int(own[0]) for own in stamps.values())
    moving = [stamps[signal.base] for signal in signals if not signal.held] or list(stamps.values())
    end = min(int(own[-1]) for own in moving)
    inside = {name: own[(own >= begin) & (own <= end)] for name, own in stamps.items()}
    base = max(inside, key=lambda name: len(inside[name]))
    if not len(inside[base]):
        raise LogError(f"{text!r}: {' and '.join(stamps)} do not overlap in time")
    return inside[base], base


def interpolation(signal: LogSignal) -> Callable[[Stamps], Floats]:
    """Return a function of the signal at other stamps, by the rules in the module docstring.

    It gives NaN before the first row. After the last row, it gives NaN or, for a held signal, the last value.
    """
    usable = rising(signal.stamp_ns) & (np.isfinite(signal.values) | signal.held)
    stamp_ns, values = signal.stamp_ns[usable], signal.values[usable]
    if not len(values):
        return lambda at_ns: np.full(len(at_ns), np.nan)
    if signal.held:

        def held_at(at_ns: Stamps) -> Floats:
            last = np.searchsorted(stamp_ns, at_ns, "right") - 1
            result: Floats = np.where(last >= 0, values[np.maximum(last, 0)], np.nan)
            return result

        return held_at
    turn = _TURNS.get(signal.unit)
    smooth = values if turn is None else np.unwrap(values, period=turn)
    low = None if turn is None or np.array_equal(smooth, values) else 0.0 if values.min() >= 0.0 else -turn / 2.0
    steps = np.diff(stamp_ns)
    pause_ns = max(_LEAST_PAUSE_NS, _PAUSE_IN_INTERVALS * float(np.median(steps))) if len(steps) else 0.0

    def at(at_ns: Stamps) -> Floats:
        result: Floats = np.interp((at_ns - stamp_ns[0]) * 1.0, (stamp_ns - stamp_ns[0]) * 1.0, smooth, np.nan, np.nan)
        after = np.clip(np.searchsorted(stamp_ns, at_ns, "left"), 1, max(len(stamp_ns) - 1, 1))
        if len(steps):
            exact = stamp_ns[np.clip(np.searchsorted(stamp_ns, at_ns, "left"), 0, len(stamp_ns) - 1)] == at_ns
            result[(steps[after - 1] > pause_ns) & ~exact] = np.nan
        if low is not None and turn is not None:
            result = np.mod(result - low, turn) + low
        return result

    return at


def table_of(log: SignalSource, path: str) -> Table | None:
    """Table named at the beginning of the path; the longest name if several match."""
    folded = path.casefold()
    names = [
        name
        for name in log.tables
        if folded == name.casefold() or folded.startswith((f"{name}.".casefold(), f"{name}[".casefold()))
    ]
    if names:
        return log.tables[max(names, key=len)]
    framed = re.match(r"(?P<topic>/[^.:]+):(?P<message>\w+)", path)  # from MAVLink frames of a recording
    name = f"{framed['topic']}:{framed['message'].upper()}" if framed else ""
    return log.tables[name] if name and name in log.tables else None


def _single(log: SignalSource, path: str, raw: bool) -> LogSignal:
    signals = named_signals(log, path, raw, lowest=True)
    if len(signals) > 1:
        names = ", ".join(signal.name for signal in signals[:4])
        raise LogError(f"{path} stands for {len(signals)} signals; choose one, such as {names}")
    return signals[0]


def named_signals(log: SignalSource, path: str, raw: bool = False, *, lowest: bool = False) -> list[LogSignal]:
    """Fields of a message. Raises LogError.

    Without an instance in the path, these are the fields of every instance, or of the lowest if `lowest` is True.
    """
    table = table_of(log, path)
    if table is None:
        raise no_message(log, path)
    rest = _REST.fullmatch(path[len(table.name) :])
    if rest is None:
        raise LogError(
            f"{path!r} is not the name of a signal; write {table.name}.FIELD, or {table.name}[1].FIELD for an instance"
        )
    # The tables of the instances, each with its label.
    number, wanted = rest["instance"], rest["column"]
    if table.instance is None:
        if int(number or 0):
            raise LogError(f"{table.name} has no instances; write {table.name}.FIELD")
        parts = {table.name: table}
    else:
        split = by_instance(table)
        if number is not None and int(number) not in split:
            instances = ", ".join(f"{table.name}[{instance}]" for instance in split)
            raise LogError(f"{table.name} has no instance {number}; choose from {instances}")
        numbers = list(split) if number is None else [int(number)]
        plain = number is None and len(split) == 1
        parts = {table.name if plain else f"{table.name}[{own}]": split[own] for own in numbers}
    if lowest:
        parts = dict(list(parts.items())[:1])
    # The field, with or without index, or every numeric field.
    signals: list[LogSignal] = []
    for label, part in parts.items():
        if wanted is None:
            columns = signal_columns(part)
            if not columns:
                raise LogError(f"{label} has no numeric field; `xitl logs dump` shows its fields")
            for name in columns:
                signals += _components(part, label, name, None, raw, log.zero_ns)
        else:
            indexed = None if wanted in part.columns else _INDEXED.fullmatch(wanted)
            name = column_named(part, indexed["column"] if indexed else wanted)
            index = int(indexed["index"]) if indexed else None
            signals += _components(part, label, name, index, raw, log.zero_ns)
    return signals


def no_message(log: SignalSource, path: str) -> LogError:
    """Error for a name that begins with no message of the log."""
    typed = re.split(r"[.\[]", path, maxsplit=1)[0]
    if typed.casefold() in map(str.casefold, log.rowless):
        return LogError(f"{log.path}: has no row of {typed}; `xitl logs info` lists the messages with rows")
    try:
        resolve_name(typed, log.tables, f"{log.path}: has no message", "`xitl logs info` lists them")
    except UnknownNameError as error:
        return error
    return LogError(f"{path!r} is not the name of a signal; write {typed}.FIELD")


def signal_columns(table: Table) -> list[str]:
    """Every numeric field except time and instance."""
    numbers = [name for name, column in table.columns.items() if column.kind == "number" and name != table.instance]
    return [name for name in numbers if name not in TIME_FIELDS] or numbers


def _components(
    table: Table, label: str, name: str, index: int | None, raw: bool, zero_ns: int
) -> list[LogSignal]:  # fmt: skip
    column = table.columns[name]
    if column.kind != "number":
        raise LogError(f"{table.name}.{name} is {column.kind}, which cannot be plotted; `xitl logs dump` shows it")
    stored = np.asarray(table.values(name, raw=raw))
    values = stored.astype(np.float64)
    unit = column.raw_unit if raw else column.unit
    held = stored.dtype.kind in "iub" and not unit
    if values.ndim == 1:
        if index is not None:
            raise LogError(f"{table.name}.{name} is a single number; write it without [{index}]")
        return [LogSignal(f"{label}.{name}", unit, table.stamp_ns, values, label, zero_ns, held)]
    flat = values.reshape(len(values), -1)
    if index is not None and index >= flat.shape[1]:
        raise LogError(f"{table.name}.{name} has {flat.shape[1]} elements per row; [{index}] does not exist")
    chosen = range(min(flat.shape[1], _MOST_COMPONENTS)) if index is None else (index,)
    return [
        LogSignal(f"{label}.{name}[{element}]", unit, table.stamp_ns, flat[:, element], label, zero_ns, held)
        for element in chosen
    ]
