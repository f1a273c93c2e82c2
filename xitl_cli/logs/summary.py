"""Summary of a log without analysing it, for `xitl logs info`."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from xitl_cli.logs.model.log import Base, Format, Log, LogHealth
from xitl_cli.logs.model.sections import Fact
from xitl_cli.logs.model.table import Column, Table

_SHORTEST_S = 0.1
_READ_WHOLE_BYTES = 16 << 20


@dataclass(frozen=True, slots=True)
class MessageSummary:
    """Summary of one message or topic."""

    name: str
    rows: int
    rate_hz: float | None
    """Rate of one instance, over the time from the first row of the message to its last. None if that time is zero or
    if rows have no write time.
    """
    instances: int | None
    """None if the message has no instances."""
    columns: tuple[Column, ...] | None
    """None if they were not read."""


@dataclass(frozen=True, slots=True)
class Summary:
    """Summary of a log."""

    path: Path
    format: Format
    base: Base
    span_s: tuple[float, float] | None
    start_utc: str | None
    """UTC of the first row in the form 2026-11-21 12:00:00; None if unknown."""
    about: tuple[Fact, ...]
    """Vehicle, firmware and similar facts, if the log has them."""
    facts: Mapping[str, str]
    """Facts that the format itself contains."""
    health: LogHealth
    messages: tuple[MessageSummary, ...]

    def as_json(self) -> dict[str, Any]:
        span = self.span_s
        return {
            "file": str(self.path),
            "format": self.format,
            "size_bytes": self.health.size_bytes,
            "time_base": self.base,
            "from_s": None if span is None else span[0],
            "until_s": None if span is None else span[1],
            "duration_s": None if span is None else span[1] - span[0],
            "start_utc": self.start_utc,
            "about": {fact.key: fact.value for fact in self.about},
            "facts": dict(self.facts),
            "health": self.health.as_json(),
            "messages": [
                {
                    "name": message.name,
                    "rows": message.rows,
                    "rate_hz": message.rate_hz,
                    "instances": message.instances,
                    "fields": None
                    if message.columns is None
                    else [
                        {"name": column.name, "unit": column.unit, "kind": column.kind, "shape": list(column.shape)}
                        for column in message.columns
                    ],
                }
                for message in self.messages
            ],
        }


def summarize_log(log: Log, *, every_field: bool = False) -> Summary:
    """Return the summary of a log.

    For a large recording, only the index is read, unless `every_field` is True.
    """
    span, zero = log.span_ns, log.zero_ns
    indexed = log.of_topics and log.health.size_bytes > _READ_WHOLE_BYTES and not every_field
    about = () if indexed else _about(log)
    messages = tuple(_indexed(table, span) for table in log.tables.values()) if indexed else _messages(log)
    utc = next((str(fact.value) for fact in about if fact.key == "utc_start"), None)
    if utc is None and span is not None and log.base == "utc":
        utc = (datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=span[0] // 1000)).strftime("%Y-%m-%d %H:%M:%S")
    return Summary(
        path=log.path,
        format=log.format,
        base=log.base,
        span_s=None if span is None else ((span[0] - zero) / 1e9, (span[1] - zero) / 1e9),
        start_utc=utc,
        about=tuple(fact for fact in about if fact.key not in ("utc_start", "duration_s")),
        facts=log.facts,
        health=log.health,  # after the messages: reading them finds damage inside a recording
        messages=messages,
    )


def _messages(log: Log) -> tuple[MessageSummary, ...]:
    """Summaries of all messages, including those inside the MAVLink frames of a recording."""
    found = []
    for name, table in log.tables.items():
        found.append(_message(table))
        if name.startswith("/") and "frame" in table.columns:
            with suppress(KeyError):
                found += [_message(inner) for inner in log.frame_tables(name).values()]
    return tuple(found)


def _message(table: Table) -> MessageSummary:
    instances = None if table.instance is None else _distinct(table, table.instance)
    first_ns, last_ns = table.ends_ns or (0, 0)
    length_s = (last_ns - first_ns) * 1e-9
    each = len(table) / (instances or 1)
    rate_hz = (each - 1) / length_s if each > 1 and length_s >= _SHORTEST_S else None
    return MessageSummary(table.name, len(table), rate_hz, instances, tuple(table.columns.values()))


def _indexed(table: Table, span_ns: tuple[int, int] | None) -> MessageSummary:
    length_s = 0.0 if span_ns is None else (span_ns[1] - span_ns[0]) * 1e-9
    rows = table.indexed_rows
    rate_hz = (rows - 1) / length_s if rows > 1 and length_s >= _SHORTEST_S else None
    return MessageSummary(table.name, rows, rate_hz, None, None)


def _distinct(table: Table, column: str) -> int:
    values = table.values(column, raw=True)
    if values.dtype.kind == "u" and values.dtype.itemsize == 1:
        return int(np.count_nonzero(np.bincount(values, minlength=256)))
    return len(np.unique(values))


def _about(log: Log) -> tuple[Fact, ...]:
    from xitl_cli.logs.analyses.vehicle import facts_of

    try:
        return facts_of(log)
    except Exception:  # noqa: BLE001  a summary is shown of what can be told; `xitl logs analyze` names the fault
        return ()
