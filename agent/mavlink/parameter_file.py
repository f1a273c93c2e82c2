"""`@PARAM/param.pck`: all parameters in one file, in ArduPilot's format (libraries/AP_Filesystem, Param).

The header has three 16-bit numbers: 0x671B, or 0x671C with defaults; the number of parameters in the file; the total
number. Each parameter follows:

- type (4 bits: 1 INT8, 2 INT16, 3 INT32, 4 REAL32) and flags (4 bits, 1 for a default after the value),
- number of characters kept from the last name, and number of new ones minus one (4 bits each),
- the new characters of the name, and the value.

Zero bytes before a parameter keep its value within one piece of the reads.
"""

from __future__ import annotations

import errno
import struct
from collections.abc import Sequence
from typing import Callable, NamedTuple

from agent.mavlink.ftp import DATA_BYTES
from agent.mavlink.parameters import same_value

_MAGIC, _MAGIC_WITH_DEFAULTS = 0x671B, 0x671C
_HEADER = struct.Struct("<HHH")
_TYPES = {2: (1, "<b"), 4: (2, "<h"), 6: (3, "<i"), 9: (4, "<f")}  # by MAV_PARAM_TYPE
_LIMIT = 65535


class ParameterFileRow(NamedTuple):
    """One parameter."""

    name: str
    type: int
    """MAV_PARAM_TYPE."""
    value: float
    default: float


class ParameterQuery(NamedTuple):
    """Query after the `?` of the file's name."""

    start: int = 0
    limit: int = 0
    """Largest number of parameters, 0 for all."""
    with_defaults: bool = False


def parse_query(text: str) -> ParameterQuery:
    """Parse `start=10&count=5&withdefaults=1`. Other keys are ignored. Raises OSError for an invalid number."""
    numbers = {"start": 0, "count": 0, "withdefaults": 0}
    for part in text.split("&"):
        name, _, number = part.partition("=")
        if name in numbers:
            most = 1 if name == "withdefaults" else _LIMIT - 1
            if not number.isascii() or not number.isdigit() or int(number[:6]) > most:
                raise OSError(errno.EINVAL, f"param.pck: {part} is not a number from 0 to {most}")
            numbers[name] = int(number[:6])
    return ParameterQuery(numbers["start"], numbers["count"], numbers["withdefaults"] == 1)


WHOLE = ParameterQuery()


def pack_parameters(rows: Sequence[ParameterFileRow], query: ParameterQuery = WHOLE, piece: int = DATA_BYTES) -> bytes:
    """Return the file, for reads of `piece` bytes each."""
    chosen = rows[query.start : query.start + query.limit] if query.limit else rows[query.start :]
    magic = _MAGIC_WITH_DEFAULTS if query.with_defaults else _MAGIC
    data = bytearray(_HEADER.pack(magic, len(chosen), len(rows)))
    before = ""
    for name, kind, value, default in chosen:
        number, layout = _TYPES[kind]
        common = 0
        while common < min(len(name) - 1, len(before)) and name[common] == before[common]:
            common += 1
        value_bytes = _value(layout, value)
        with_default = query.with_defaults and not same_value(value, default)
        default_bytes = _value(layout, default) if with_default else b""
        head = bytes((number | (0x10 if with_default else 0), common | (len(name) - common - 1) << 4))
        entry = head + name[common:].encode("ascii") + value_bytes + default_bytes
        # Zeros before the entry keep its value within one piece.
        across = (len(data) + len(entry)) % piece
        if len(value_bytes) > 1 and 0 < across < len(value_bytes):
            data += bytes(len(value_bytes) - across)
        data += entry
        before = name
    return bytes(data)


def _value(layout: str, value: float) -> bytes:
    return struct.pack(layout, value if layout == "<f" else int(value))


class PackedParameters:
    """A ServedFile with the content at the first read, which also defines the piece size."""

    def __init__(self, rows: Callable[[], Sequence[ParameterFileRow]], query: ParameterQuery) -> None:
        """Raises OSError when the query is beyond the last parameter."""
        self._rows = rows()
        self._query = query
        self._content = b""
        if query.start >= len(self._rows):
            raise OSError(errno.EINVAL, f"param.pck: start={query.start}, but there are only {len(self._rows)}")

    @property
    def size(self) -> int:
        return len(self._content or pack_parameters(self._rows, self._query))

    def read(self, offset: int, count: int) -> bytes:
        if not self._content and count:
            self._content = pack_parameters(self._rows, self._query, count)
        return self._content[offset : offset + count]
