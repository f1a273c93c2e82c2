"""`@PARAM/param.pck`: all parameters in one file, packed as ArduPilot does (libraries/AP_Filesystem, Param).

A header of three 16-bit numbers: 0x671B, or 0x671C with defaults; how many parameters the file has; how many there are.
Then each parameter: type (4 bits: 1 INT8, 2 INT16, 3 INT32, 4 REAL32) and flags (4 bits, 1 for a default behind the
value), what of the name before is kept and how much follows (4 bits each), the rest of the name, and the value. Zero
bytes ahead of a parameter keep its value within one piece of the reads.
"""

from __future__ import annotations

import errno
import struct
from collections.abc import Iterable, Sequence
from typing import Callable, NamedTuple

from agent.mavlink.ftp import DATA_BYTES
from agent.mavlink.parameters import same_value

_MAGIC, _MAGIC_WITH_DEFAULTS = 0x671B, 0x671C
_HEADER = struct.Struct("<HHH")
_TYPES = {2: (1, "<b"), 4: (2, "<h"), 6: (3, "<i"), 9: (4, "<f")}  # by MAV_PARAM_TYPE
_LIMIT = 65535


class ParameterFileRow(NamedTuple):
    """One parameter; `type` is a MAV_PARAM_TYPE."""

    name: str
    type: int
    value: float
    default: float


class ParameterQuery(NamedTuple):
    """What stands behind the `?` of the file's name. limit: how many at most, 0 for all."""

    start: int = 0
    limit: int = 0
    with_defaults: bool = False


def parse_query(text: str) -> ParameterQuery:
    """`start=10&count=5&withdefaults=1`; what else it says is passed over. Raises OSError for a bad number."""
    found = {"start": 0, "count": 0, "withdefaults": 0}
    for part in text.split("&"):
        name, _, number = part.partition("=")
        if name in found:
            most = 1 if name == "withdefaults" else _LIMIT - 1
            if not number.isascii() or not number.isdigit() or int(number[:6]) > most:
                raise OSError(errno.EINVAL, f"param.pck: {part} is no number from 0 to {most}")
            found[name] = int(number[:6])
    return ParameterQuery(found["start"], found["count"], found["withdefaults"] == 1)


WHOLE = ParameterQuery()


def pack_parameters(rows: Sequence[ParameterFileRow], query: ParameterQuery = WHOLE, piece: int = DATA_BYTES) -> bytes:
    """The file, for reads of `piece` bytes each."""
    chosen = rows[query.start : query.start + query.limit] if query.limit else rows[query.start :]
    magic = _MAGIC_WITH_DEFAULTS if query.with_defaults else _MAGIC
    return _HEADER.pack(magic, len(chosen), len(rows)) + _packed(chosen, query.with_defaults, piece)


def _packed(rows: Iterable[ParameterFileRow], with_defaults: bool, piece: int) -> bytes:
    data = bytearray()
    before = ""
    for name, kind, value, default in rows:
        number, layout = _TYPES[kind]
        kept = 0
        while kept < min(len(name), len(before)) and name[kept] == before[kept]:
            kept += 1
        kept = min(kept, len(name) - 1)
        value_bytes = _value(layout, value)
        also = _value(layout, default) if with_defaults and not same_value(value, default) else b""
        head = bytes((number | (0x10 if also else 0), kept | (len(name) - kept - 1) << 4))
        entry = head + name[kept:].encode("ascii") + value_bytes + also
        across = (_HEADER.size + len(data) + len(entry)) % piece
        if len(value_bytes) > 1 and 0 < across < len(value_bytes):
            data += bytes(len(value_bytes) - across)
        data += entry
        before = name
    return bytes(data)


def _value(layout: str, value: float) -> bytes:
    return struct.pack(layout, value if layout == "<f" else int(value))


class PackedParameters:
    """The file as it was at the first read, whose size is that of the pieces. A ServedFile."""

    def __init__(self, rows: Callable[[], Sequence[ParameterFileRow]], query: ParameterQuery) -> None:
        """Raises OSError where nothing is left of what is asked for."""
        self._rows = rows()
        self._query = query
        self._content = b""
        if query.start >= len(self._rows):
            raise OSError(errno.EINVAL, f"param.pck: start={query.start}, and there are {len(self._rows)}")

    @property
    def size(self) -> int:
        return len(self._content or pack_parameters(self._rows, self._query))

    def read(self, offset: int, count: int) -> bytes:
        if not self._content and count:
            self._content = pack_parameters(self._rows, self._query, count)
        return self._content[offset : offset + count]
