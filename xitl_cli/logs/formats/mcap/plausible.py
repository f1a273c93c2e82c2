"""Which bytes may be a record: to walk a file whose records cannot be trusted, and to find the next after damage."""

from __future__ import annotations

import numpy as np

from xitl_cli.logs.formats.mcap import records
from xitl_cli.logs.formats.mcap.index import LARGEST_CHUNK
from xitl_cli.logs.formats.mcap.records import ChunkHead, MalformedError
from xitl_cli.logs.formats.mcap.source import Source

_SHORTEST = {
    records.HEADER: 8,
    records.FOOTER: 20,
    records.SCHEMA: 14,
    records.CHANNEL: 16,
    records.MESSAGE: 22,
    records.CHUNK: records.CHUNK_FIXED,
    records.MESSAGE_INDEX: 6,
    records.CHUNK_INDEX: 60,
    records.ATTACHMENT: 36,
    records.ATTACHMENT_INDEX: 48,
    records.STATISTICS: 46,
    records.METADATA: 8,
    records.METADATA_INDEX: 20,
    records.SUMMARY_OFFSET: 17,
    records.DATA_END: 4,
}
_EXACT = (records.FOOTER, records.SUMMARY_OFFSET, records.DATA_END)
_PRIVATE = 0x80
_CHAIN = 3
_BLOCK = 4 << 20
_RECORD = np.dtype([("opcode", "u1"), ("length", "<u8")])


def chunk_at(source: Source, place: int) -> ChunkHead | None:
    """The chunk that begins at `place`, judged by its fields alone and not by its record's own opcode and length."""
    try:
        head = records.chunk_head(source.peek(place, 9 + records.CHUNK_FIXED + 32), 1 << 62)
    except MalformedError:
        return None
    known = head.compression in ("", "lz4", "zstd")
    if not known or head.start_ns > head.end_ns or head.unpacked_size > LARGEST_CHUNK:
        return None
    if head.compression == "" and head.data_size != head.unpacked_size:
        return None
    return head if head.data_size else None


def may_be(source: Source, place: int, opcode: int, length: int, end: int) -> bool:
    """Whether a record of this opcode and length can be at `place`, all of it before `end`."""
    if place + 9 + length > end or length < _SHORTEST.get(opcode, 0):
        return False
    if opcode in _EXACT:
        return length == _SHORTEST[opcode]
    if opcode == records.CHUNK:
        try:
            head = records.chunk_head(source.peek(place, 9 + records.CHUNK_FIXED + 32), length)
        except MalformedError:
            return False
        return head.data_at + head.data_size == 9 + length
    if opcode == records.MESSAGE_INDEX:
        size = int.from_bytes(source.peek(place + 11, 4), "little")
        return size % 16 == 0 and length == 6 + size
    return opcode in _SHORTEST or opcode >= _PRIVATE


def next_record(source: Source, begin: int, end: int) -> int | None:
    """The first place at which a few records follow each other; of a chunk the one is enough."""
    while begin < end - 9:
        data = source.read(begin, min(_BLOCK + 8, end - begin))
        count = len(data) - 8
        if count <= 0:
            return None
        heads = np.ndarray((count,), dtype=_RECORD, buffer=data, strides=(1,))
        room = (end - 9 - begin - np.arange(count)).clip(0).astype(np.uint64)
        likely = (heads["opcode"] >= records.SCHEMA) & (heads["opcode"] <= records.DATA_END)
        likely &= (heads["length"] >= 4) & (heads["length"] <= room)
        for at in (np.flatnonzero(likely) + begin).tolist():
            if _chain(source, at, end):
                return int(at)
        begin += count
    return None


def _chain(source: Source, place: int, end: int) -> bool:
    for _ in range(_CHAIN):
        if place == end:
            return True
        head = source.peek(place, 9)
        if len(head) < 9:
            return False
        opcode, length = records.HEAD.unpack(head)
        if opcode >= _PRIVATE or not may_be(source, place, opcode, length, end):
            return False
        if opcode == records.CHUNK and chunk_at(source, place) is not None:
            return True
        if opcode == records.FOOTER:
            return True
        place += 9 + length
    return True
