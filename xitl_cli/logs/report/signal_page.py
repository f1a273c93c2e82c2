"""A page of the signals that a user asked for: one plot a unit, all on one time line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np

import xitl_cli.logs.signals as signals
from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Plot, Section, Trace
from xitl_cli.logs.model.table import Floats, Stamps, Table, by_instance, column_named, whole_ns
from xitl_cli.logs.report.build import ReportLog, open_all, short_names, state_marks, time_lines
from xitl_cli.logs.report.model import Overview, RefusedFile
from xitl_cli.logs.report.page import FileCard, Page, PagePart, page_marks
from xitl_cli.logs.report.plots import ThinTrace, thin
from xitl_cli.logs.report.wording import damage_sentences

_MOST_COMPONENTS = 32
_TIMES = frozenset(
    ("TimeUS", "TimeMS", "time_boot_ms", "time_usec", "time_unix_usec", "stamp", "header.stamp", "timestamp")
)
"""When a row is of, in DataFlash logs, MAVLink, ROS 2 and Foxglove: a line that rises, and no signal."""

_REST = re.compile(r"(?:\[(?P<instance>\d+)\])?(?:\.(?P<column>.+))?")
_INDEXED = re.compile(r"(?P<column>.+)\[(?P<index>\d+)\]")


@dataclass(frozen=True, slots=True)
class NamedSignal:
    """stamp_ns and values: (N,), as logged. name: as it would be typed."""

    name: str
    unit: str
    stamp_ns: Stamps
    values: Floats


def signals_named(logs: Sequence[Log], wanted: str, *, raw: bool = False) -> list[list[NamedSignal]]:
    """For each log what it has of it. Raises LogError when none has any."""
    found: list[list[NamedSignal]] = []
    why: list[LogError] = []
    for log in logs:
        try:
            found.append(_of(log, wanted, raw))
        except LogError as error:
            found.append([])
            why.append(error)
    if len(why) == len(logs):
        raise why[0]
    return found


def _of(log: Log, wanted: str, raw: bool) -> list[NamedSignal]:
    folded = wanted.casefold()
    names = [
        name
        for name in log.tables
        if folded == name.casefold() or folded.startswith((f"{name}.".casefold(), f"{name}[".casefold()))
    ]
    if not names:
        raise _no_message(log, wanted)
    table = log.tables[max(names, key=len)]
    rest = _REST.fullmatch(wanted[len(table.name) :])
    if rest is None:
        raise LogError(
            f"{wanted!r} names no signal; write {table.name}.FIELD, or {table.name}[1].FIELD for an instance"
        )
    return [
        signal
        for label, part in _instances(table, rest["instance"])
        for signal in _columns(part, label, rest["column"], raw)
    ]


def _no_message(log: Log, wanted: str) -> LogError:
    typed = re.split(r"[.\[]", wanted, maxsplit=1)[0] if not wanted.startswith("/") else wanted
    if typed.casefold() in map(str.casefold, log.rowless):
        return LogError(f"{log.path}: has no row of {typed}; `xitl logs info` lists what it has")
    known = {name.casefold(): name for name in log.tables}
    near = get_close_matches(typed.casefold(), known, n=1)
    advice = f"did you mean {known[near[0]]}? " if near else ""
    return LogError(f"{log.path}: has no message {typed!r}; {advice}`xitl logs info` lists them")


def _instances(table: Table, wanted: str | None) -> list[tuple[str, Table]]:
    if table.instance is None:
        if int(wanted or 0):
            raise LogError(f"{table.name} has no instances; write {table.name}.FIELD")
        return [(table.name, table)]
    split = by_instance(table)
    if wanted is None:
        return [(f"{table.name}[{number}]" if len(split) > 1 else table.name, part) for number, part in split.items()]
    if int(wanted) not in split:
        there = ", ".join(f"{table.name}[{number}]" for number in split)
        raise LogError(f"{table.name} has no instance {wanted}; there is {there}")
    return [(f"{table.name}[{wanted}]", split[int(wanted)])]


def _columns(table: Table, label: str, wanted: str | None, raw: bool) -> list[NamedSignal]:
    """wanted: a field, a field with an index; None: every field that is a number, but time and the instance."""
    if wanted is None:
        numbers = [name for name, column in table.columns.items() if column.kind == "number" and name != table.instance]
        columns = [name for name in numbers if name not in _TIMES] or numbers
        if not columns:
            raise LogError(f"{label} has no field that is a number; `xitl logs dump` shows what it has")
        return [signal for name in columns for signal in _components(table, label, name, None, raw)]
    indexed = None if wanted in table.columns else _INDEXED.fullmatch(wanted)
    name = column_named(table, indexed["column"] if indexed else wanted)
    return _components(table, label, name, int(indexed["index"]) if indexed else None, raw)


def _components(table: Table, label: str, name: str, index: int | None, raw: bool) -> list[NamedSignal]:
    column = table.columns[name]
    if column.kind != "number":
        raise LogError(f"{table.name}.{name} is {column.kind}, which cannot be drawn; `xitl logs dump` shows it")
    values = np.asarray(table.values(name, raw=raw), dtype=np.float64)
    unit = column.raw_unit if raw else column.unit
    if values.ndim == 1:
        if index is not None:
            raise LogError(f"{table.name}.{name} is a single number; write it without [{index}]")
        return [NamedSignal(f"{label}.{name}", unit, table.stamp_ns, values)]
    flat = values.reshape(len(values), -1)
    if index is not None and index >= flat.shape[1]:
        raise LogError(f"{table.name}.{name} has {flat.shape[1]} numbers a row; [{index}] is beyond them")
    chosen = range(min(flat.shape[1], _MOST_COMPONENTS)) if index is None else (index,)
    return [NamedSignal(f"{label}.{name}[{each}]", unit, table.stamp_ns, flat[:, each]) for each in chosen]


_MOST_NAMES = 3


def signal_page(
    paths: Sequence[Path],
    wanted: Sequence[str],
    from_s: float | None,
    until_s: float | None,
    *,
    raw: bool = False,
    vessel: str | None = None,
) -> tuple[Page, list[RefusedFile]]:
    """from_s and until_s: on the page's time line. vessel: as of `open_all`.

    Raises LogError when no file opens, or none has a signal.
    """
    with ExitStack() as opened:
        logs, refusals = open_all(paths, opened, vessel)
        if not logs:
            raise LogError(refusals[-1].sentence)
        names = short_names([log.path for log in logs])
        sources = [
            ReportLog(log, line, name if len(logs) > 1 else "")
            for log, line, name in zip(logs, time_lines(logs), names, strict=True)
        ]
        by_unit: dict[str, list[Trace]] = {}
        names_by_unit: dict[str, list[str]] = {}
        for text in wanted:
            for source, parts in zip(sources, signals_named(logs, text, raw=raw), strict=True):
                for signal in parts:
                    names_by_unit.setdefault(signal.unit, []).append(signal.name)
                    by_unit.setdefault(signal.unit, []).append(_trace(source, signal, from_s, until_s))
        if not any(len(trace.x) for traces in by_unit.values() for trace in traces):
            raise LogError(f"{paths[0]}: nothing of {', '.join(wanted)} lies between --from and --until; widen them")
        overview = Overview(modes=state_marks(sources, signals.modes), armed=state_marks(sources, signals.armed))
        cards = tuple(
            FileCard(
                source.label or source.log.path.name,
                (("time line", source.time_line.sentence),) if source.label else (),
                damage_sentences(source.log.health),
                source.log.health.degraded,
            )
            for source in sources
            if source.label or source.log.health.degraded
        )
    plots = tuple(
        Plot(f"signals.{unit or 'numbers'}", _title(names_by_unit[unit]), unit, tuple(traces))
        for unit, traces in by_unit.items()
    )
    part = PagePart(Section("signals", "Signals", plots=plots), TimeLine())
    title = " + ".join(names)
    return Page(title, "", (part,), cards, tuple(each.sentence for each in refusals), page_marks(overview)), refusals


def _trace(source: ReportLog, signal: NamedSignal, from_s: float | None, until_s: float | None) -> ThinTrace:
    at_s = source.time_line.seconds(signal.stamp_ns)
    inside = np.ones(len(at_s), dtype=np.bool_)
    if from_s is not None:
        inside &= at_s >= from_s
    if until_s is not None:
        inside &= at_s <= until_s
    at_ns = whole_ns(at_s[inside] * 1e9)
    return thin(Trace(source.named(signal.name), at_ns, signal.values[inside]), over_time=True)


def _title(names: Sequence[str]) -> str:
    once = list(dict.fromkeys(names))
    return ", ".join(once[:_MOST_NAMES]) + (f" and {len(once) - _MOST_NAMES} more" if len(once) > _MOST_NAMES else "")
