"""How the scheduler of an ArduPilot did, from the PM records of its DataFlash log.

A record of the log is 0xA3 0x95, its type, its payload; FMT (type 128) tells length, name, format and columns of one.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

HEAD = b"\xa3\x95"
_FMT = 128
_FMT_PAYLOAD = struct.Struct("<BB4s16s64s")
_CODES = {
    "b": "b", "B": "B", "M": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "d": "d", "n": "4s", "N": "16s",
    "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "q": "q", "Q": "Q", "g": "e", "a": "64s",
}  # fmt: skip
_LOOPS = ("NL", "NLoop")  # by version


@dataclass(frozen=True, slots=True)
class SchedulerRecord:
    """Sums over all rows. long_loops: loops that took longer than the period allows. max_us: the longest loop.

    fields: the columns that this version logs. load_*_percent: of the processor's time. None: not logged.
    """

    rows: int
    fields: tuple[str, ...]
    loops: int | None = None
    long_loops: int | None = None
    max_us: int | None = None
    load_mean_percent: float | None = None
    load_max_percent: float | None = None


def scheduler_record(log: Path) -> SchedulerRecord | None:
    """From a DataFlash log; None when it cannot be read or has no PM records."""
    try:
        data = log.read_bytes()
    except OSError:
        return None
    found = _format(data, b"PM")
    if found is None:
        return None
    kind, length, layout, columns = found
    rows = list(_rows(data, kind, length, layout, columns))
    if not rows:
        return None
    loops = next((name for name in _LOOPS if name in columns), None)
    loads = [row["Load"] / 10.0 for row in rows if "Load" in row]
    return SchedulerRecord(
        rows=len(rows),
        fields=tuple(name for name in columns if name != "TimeUS"),
        loops=None if loops is None else int(sum(row[loops] for row in rows)),
        long_loops=int(sum(row["NLon"] for row in rows)) if "NLon" in columns else None,
        max_us=int(max(row["MaxT"] for row in rows)) if "MaxT" in columns else None,
        load_mean_percent=sum(loads) / len(loads) if loads else None,
        load_max_percent=max(loads) if loads else None,
    )


def _format(data: bytes, name: bytes) -> tuple[int, int, struct.Struct, tuple[str, ...]] | None:
    """Type, length of a record, layout of its payload and columns."""
    head = HEAD + bytes([_FMT])
    at = data.find(head)
    while at >= 0 and at + 3 + _FMT_PAYLOAD.size <= len(data):
        kind, length, of, format_, columns = _FMT_PAYLOAD.unpack_from(data, at + 3)
        if of.rstrip(b"\0") == name:
            codes = [_CODES.get(letter) for letter in format_.rstrip(b"\0").decode("ascii", "replace")]
            if None not in codes:
                layout = struct.Struct("<" + "".join(code for code in codes if code))
                names = tuple(columns.rstrip(b"\0").decode("ascii", "replace").split(","))
                if layout.size + 3 == length and len(names) == len(codes):
                    return kind, length, layout, names
        at = data.find(head, at + 1)
    return None


def _rows(
    data: bytes, kind: int, length: int, layout: struct.Struct, columns: tuple[str, ...]
) -> Iterator[dict[str, float]]:
    """Records that another one, or the end of the log, follows: the head may also stand within a payload."""
    head = HEAD + bytes([kind])
    at = data.find(head)
    last_us = -1
    while at >= 0:
        end = at + length
        if end == len(data) or data[end : end + 2] == HEAD:
            row = dict(zip(columns, layout.unpack_from(data, at + 3), strict=True))
            if row.get("TimeUS", 0) > last_us:
                last_us = row.get("TimeUS", 0)
                yield row
                at = end - 1
        at = data.find(head, at + 1)
