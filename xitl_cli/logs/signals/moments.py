"""Moments of a log, each with a short text: context for long loops, missed deadlines and silent links."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

import xitl_cli.logs.signals as signals
from xitl_cli.logs.model.codes import ARMED, DISARMED, error_name, event_name
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.signals.states import error_rows, event_rows, parameter_rows, vehicle_kind

SPELL_NS = 2_000_000_000  # rows closer together belong to one action
MOST = 2000
NAMED = 6
MANY_PARAMETERS = 3

_RANK = (
    "log",
    "clock",
    "fault",
    "arming",
    "mode",
    "mission",
    "parameters",
    "file",
    "estimator",
    "error",
    "event",
    "takeover",
    "text",
)


@dataclass(frozen=True, slots=True)
class Moment:
    """An event of a log."""

    at_ns: int
    until_ns: int
    kind: str
    """log, clock, fault, arming, mode, mission, parameters, file, estimator, error, event, takeover or text."""
    text: str
    source: str


def moments(log: Log) -> list[Moment]:
    """Moments in order of time; at most 2000 of a kind."""
    every: list[Moment] = []
    for moments_of in (
        _beginning, _faults, _arming, _modes, _mission, _parameters, _files, _estimator, _errors, _events, _texts,
    ):  # fmt: skip
        every += islice(moments_of(log), MOST)
    return sorted(every, key=lambda moment: moment.at_ns)


def moments_near(every: Sequence[Moment], from_ns: int, until_ns: int, margin_ns: int = 0) -> list[Moment]:
    """Moments that overlap the span, the most informative kinds first."""
    near = [
        moment for moment in every if moment.until_ns >= from_ns - margin_ns and moment.at_ns <= until_ns + margin_ns
    ]
    return sorted(near, key=lambda moment: (_RANK.index(moment.kind), moment.at_ns))


def moments_text(near: Sequence[Moment]) -> str:
    """At most six moments in one line; "nothing that was logged" if there is none. Texts appear only if nothing else
    does."""
    telling = [moment for moment in near if moment.kind != "text"] or list(near)
    texts = list(dict.fromkeys(moment.text for moment in telling))
    if not texts:
        return "nothing that was logged"
    more = f" and {len(texts) - NAMED} more" if len(texts) > NAMED else ""
    return "; ".join(texts[:NAMED]) + more


def _beginning(log: Log) -> Iterator[Moment]:
    if log.span_ns is not None:
        begin = log.span_ns[0]
        yield Moment(begin, begin, "log", "the log begins", "")


def _arming(log: Log) -> Iterator[Moment]:
    span = log.span_ns or (0, 0)
    for armed in signals.armed(log):
        if armed.from_ns > span[0]:
            yield Moment(armed.from_ns, armed.from_ns, "arming", "armed", armed.source)
        if armed.until_ns < span[1]:
            yield Moment(armed.until_ns, armed.until_ns, "arming", "disarmed", armed.source)


def _modes(log: Log) -> Iterator[Moment]:
    for mode in signals.modes(log):
        yield Moment(mode.from_ns, mode.from_ns, "mode", f"mode {mode.text}", mode.source)


def _spells(stamps: Sequence[int]) -> list[tuple[int, int, int]]:
    """Begin, end and number of rows of each action."""
    spells: list[tuple[int, int, int]] = []
    for at_ns in sorted(stamps):
        if spells and at_ns - spells[-1][1] <= SPELL_NS:
            spells[-1] = (spells[-1][0], at_ns, spells[-1][2] + 1)
        else:
            spells.append((at_ns, at_ns, 1))
    return spells


def _mission(log: Log) -> Iterator[Moment]:
    for name in ("CMD", "MISSION_ITEM_INT", "MISSION_ITEM", "MISSION_COUNT"):
        table = log.tables.get(name)
        if table is not None:
            for begin, end, rows in _spells(table.stamp_ns.tolist()):
                yield Moment(begin, end, "mission", f"mission written ({rows} items)", name)


def _parameters(log: Log) -> Iterator[Moment]:
    """Changed parameters. The initial list of all parameters is no change."""
    known: dict[str, float] = {}
    changed: list[tuple[int, str]] = []
    source = ""
    for row in parameter_rows(log):
        before = known.get(row.name)
        known[row.name] = row.value
        if before is not None and before != row.value and not row.name.startswith("STAT_"):
            changed.append((row.at_ns, row.name))
            source = row.source
    for begin, end, rows in _spells([at_ns for at_ns, _ in changed]):
        names = [name for at_ns, name in changed if begin <= at_ns <= end]
        text = f"{rows} parameters set" if rows > MANY_PARAMETERS else f"{', '.join(names)} set"
        yield Moment(begin, end, "parameters", text, source)


def _files(log: Log) -> Iterator[Moment]:
    table = log.tables.get("FILE")
    column = None if table is None else next((name for name in ("FileName", "Name") if name in table.columns), None)
    if table is None or column is None:
        return
    names = np.asarray(table.values(column)).astype(str)
    for name in dict.fromkeys(names.tolist()):
        for begin, end, _ in _spells(table.stamp_ns[names == name].tolist()):
            yield Moment(begin, end, "file", f"{name} copied into the log", "FILE")


def _estimator(log: Log) -> Iterator[Moment]:
    table = log.tables.get("ORGN")
    if table is not None and "Type" in table.columns:
        seen: set[int] = set()
        for at_ns, kind in zip(table.stamp_ns.tolist(), table.values("Type", raw=True).tolist(), strict=True):
            if kind not in seen:
                seen.add(kind)
                text = "origin of the estimator set" if kind == 0 else "home set"
                yield Moment(at_ns, at_ns, "estimator", text, "ORGN")
    for name in ("XKF1", "NKF1"):
        core = log.tables.get(name)
        if core is not None and len(core):
            at_ns = int(core.stamp_ns.min())
            yield Moment(at_ns, at_ns, "estimator", "the estimator begins", name)
            return


def _errors(log: Log) -> Iterator[Moment]:
    kind = vehicle_kind(log)
    for at_ns, subsystem, code in error_rows(log):
        yield Moment(at_ns, at_ns, "error", error_name(subsystem, code, kind), "ERR")


def _events(log: Log) -> Iterator[Moment]:
    for at_ns, number in event_rows(log):
        if number not in (ARMED, DISARMED):  # reported above
            yield Moment(at_ns, at_ns, "event", event_name(number), "EV")


def _faults(log: Log) -> Iterator[Moment]:
    for topic, field, text in (("/faults", "fault", "fault"), ("/takeovers", "from_node", "takeover from")):
        table = log.tables.get(topic)
        if table is None or field not in table.columns:
            continue
        begins = table.values("active").tolist() if "active" in table.columns else [None] * len(table)
        for at_ns, name, active in zip(table.stamp_ns.tolist(), table.values(field), begins, strict=True):
            change = "" if active is None else " begins" if active else " ends"
            yield Moment(at_ns, at_ns, "fault" if active is not None else "takeover", f"{text} {name}{change}", topic)


def _texts(log: Log) -> Iterator[Moment]:
    for text in signals.texts(log):
        yield Moment(text.at_ns, text.at_ns, "text", f"“{text.text.strip()[:80]}”", text.source)
