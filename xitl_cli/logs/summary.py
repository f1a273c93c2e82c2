"""Summary of a log without analysing it, for `xitl logs info`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from xitl_cli.logs.clocks.readings import utc_offset
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import MAV_TYPES, board_name, release_name
from xitl_cli.logs.model.log import Base, Format, Log, LogHealth
from xitl_cli.logs.model.sections import Fact, Value
from xitl_cli.logs.model.table import Column, Table
from xitl_cli.logs.signals import px4
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.states import (
    autopilot_heartbeats,
    autopilot_messages,
    firmware_text,
    last_parameters,
    vehicle_kind,
)

_EMBEDDED = re.compile(r"^xitl (\S+), messages and modes as")
_HASH = re.compile(r"\(([0-9a-f]{6,12})\)")
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
    try:
        return vehicle_facts(log)
    except Exception:  # noqa: BLE001  a summary is shown of what can be told; `xitl logs analyze` names the fault
        return ()


def vehicle_facts(log: Log) -> tuple[Fact, ...]:
    """Vehicle, firmware, times and logging. Empty for a log without a stamped row. Raises what damaged rows raise."""
    if log.span_ns is None:
        return ()
    beats = autopilot_heartbeats(log)
    parameters = last_parameters(log)
    logging: list[Fact] = []
    rows = (("LOG_BITMASK", "log_bitmask"), ("LOG_DISARMED", "log_disarmed"), ("LOG_BACKEND_TYPE", "log_backend"))
    logging.extend(
        Fact(key, name, int(parameters[name])) for name, key in rows if abs(parameters.get(name, np.inf)) < 2**32
    )
    clock = LogClock(log)
    times: list[Fact] = []
    length_s = (clock.end_ns - clock.start_ns) * 1e-9
    times.append(Fact("duration_s", "Duration", rounded(length_s, 1), "s"))
    if log.base == "boot" and not log.zero_ns:
        times.append(Fact("uptime_start_s", "Uptime at the start", rounded(clock.start_ns * 1e-9, 1), "s"))
        times.append(Fact("uptime_end_s", "Uptime at the end", rounded(clock.end_ns * 1e-9, 1), "s"))
    start, source = _utc_at_start(log, clock)
    if start is not None:
        times.append(Fact("utc_start", f"UTC at the start ({source})", start.strftime("%Y-%m-%d %H:%M:%S")))
    times.extend(
        Fact(f"recording_{key}", label, log.facts[key])
        for key, label in (("profile", "Profile"), ("technique", "Technique"), ("seed", "Seed"))
        if key in log.facts
    )
    every = (
        Fact("vehicle", "Vehicle", None if (kind := vehicle_kind(log)) == "unknown" else kind),
        Fact("vehicle_type", "Type", None if beats is None else MAV_TYPES.get(int(beats.values("type", raw=True)[0]))),
        *_firmware(log),
        *times,
        *logging,
    )
    return tuple(fact for fact in every if fact.value is not None)


def _firmware(log: Log) -> Iterator[Fact]:
    text = firmware_text(log)
    version = log.tables.get("VER")
    said = autopilot_messages(log, "AUTOPILOT_VERSION")
    name: Value = text
    number_text: Value = None
    commit: Value = None
    build: Value = None
    board: Value = None
    if text is not None and (own := _EMBEDDED.match(text)):
        name, number_text = "xitl embedded autopilot", own.group(1)
    elif text is not None and (found := _HASH.search(text)):
        commit = found.group(1)
    if version is not None:
        row = {column: version.values(column, raw=True)[-1] for column in version.columns}
        name = str(row["FWS"]) if "FWS" in row and str(row["FWS"]) else name
        if {"Maj", "Min", "Pat"} <= set(row):
            number_text = f"{row['Maj']}.{row['Min']}.{row['Pat']}"
        commit = f"{int(row['GH']):08x}" if "GH" in row else commit
        build = release_name(int(row["FWT"])) if "FWT" in row else None
        board = board_name(int(row["BT"]), int(row.get("BST", 0))) if "BT" in row else None
    elif said is not None and "flight_sw_version" in said.columns:
        packed = int(said.values("flight_sw_version", raw=True)[-1])
        if packed:
            number_text = number_text or f"{packed >> 24}.{packed >> 16 & 255}.{packed >> 8 & 255}"
            build = release_name(packed & 255)
        commit = commit or _custom_version(said)
    if log.format == "ulog":
        name = log.facts.get("sys_name")
        number_text, commit, board = px4.release(log)
    yield Fact("firmware", "Firmware", name)
    yield Fact("firmware_version", "Version", number_text)
    yield Fact("firmware_commit", "Commit", commit)
    yield Fact("firmware_release", "Release", build or None)
    yield Fact("board", "Board", board)


def _custom_version(said: Table) -> str | None:
    if "flight_custom_version" not in said.columns:
        return None
    characters = np.asarray(said.values("flight_custom_version", raw=True))[-1:].ravel()
    text = bytes(int(each) & 255 for each in characters).split(b"\0", 1)[0].decode("ascii", "replace")
    return text if text.isprintable() and text else None


def _utc_at_start(log: Log, clock: LogClock) -> tuple[datetime | None, str]:
    found = utc_offset(log)
    if found is None:
        return None, ""
    try:
        epoch = datetime(1970, 1, 1, tzinfo=UTC)
        return epoch + timedelta(microseconds=(clock.start_ns + found.offset_ns) // 1000), found.source
    except OverflowError:
        return None, ""
