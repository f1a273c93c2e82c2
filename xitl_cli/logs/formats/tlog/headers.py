"""Headers of many MAVLink frames at once, and whether the frames check out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.tlog.checksum import checksums
from xitl_cli.logs.formats.tlog.dialects import definitions

MAGIC_1, MAGIC_2 = 0xFE, 0xFD
LONGEST_FRAME = 10 + 255 + 2 + 13
SIGNED = 0x01

UNKNOWN = -1
"""In place of a message number that no dialect has."""


@dataclass(frozen=True, slots=True)
class Headers:
    """(N,) each, of the frames that begin at `start`. size: of the whole frame. kind: place of the message number among
    the known ones, or UNKNOWN. readable: it lies within the data and asks for nothing that is not known."""

    start: NDArray[np.int64]
    payload: NDArray[np.int64]
    length: NDArray[np.int64]
    size: NDArray[np.int64]
    number: NDArray[np.int64]
    kind: NDArray[np.int16]
    signed: NDArray[np.bool_]
    readable: NDArray[np.bool_]

    def of(self, rows: NDArray[np.intp]) -> Headers:
        return Headers(*(getattr(self, name)[rows] for name in Headers.__slots__))


def headers(data: NDArray[np.uint8], start: NDArray[np.int64]) -> Headers:
    """Every `start` is where a byte MAGIC_1 or MAGIC_2 is."""
    last = len(data) - 1

    def at(offset: int) -> NDArray[np.int64]:
        return data[np.minimum(start + offset, last)].astype(np.int64)

    second = data[start] == MAGIC_2
    length, flags = at(1), np.where(second, at(2), 0)
    signed = (flags & SIGNED) != 0
    head = np.where(second, 10, 6)
    size = head + length + 2 + np.where(signed, 13, 0)
    number = np.where(second, at(7) | at(8) << 8 | at(9) << 16, at(5))
    kinds = _kind_by_number()
    kind = np.where(number < len(kinds), kinds[np.minimum(number, len(kinds) - 1)], np.int16(UNKNOWN))
    readable = (start + size <= len(data)) & ((flags & ~SIGNED) == 0)
    readable &= second | (kind == UNKNOWN) | (length <= _size_by_kind()[kind])  # MAVLink 1 has no extension fields
    return Headers(start, start + head, length, size, number, kind.astype(np.int16), signed, readable)


def whole(data: NDArray[np.uint8], frames: Headers) -> NDArray[np.bool_]:
    """(N,) whether the message is known and the checksum is right."""
    result: NDArray[np.bool_] = frames.readable & (frames.kind != UNKNOWN)
    known = np.flatnonzero(result)
    ends = frames.payload[known] + frames.length[known]
    first = frames.start[known] + 1
    extra = _extra_by_kind()[frames.kind[known]]
    told = data[ends].astype(np.uint16) | data[ends + 1].astype(np.uint16) << np.uint16(8)
    result[known] = checksums(data, first, ends - first, extra) == told
    return result


@cache
def numbers() -> tuple[int, ...]:
    """Message number by kind."""
    return tuple(sorted(definitions()))


@cache
def _kind_by_number() -> NDArray[np.int16]:
    known = numbers()
    kinds = np.full(known[-1] + 2, UNKNOWN, dtype=np.int16)
    kinds[list(known)] = np.arange(len(known))
    return kinds


@cache
def _size_by_kind() -> NDArray[np.int64]:
    return np.array([definitions()[number].size for number in numbers()], dtype=np.int64)


@cache
def _extra_by_kind() -> NDArray[np.uint8]:
    return np.array([definitions()[number].crc_extra for number in numbers()], dtype=np.uint8)
