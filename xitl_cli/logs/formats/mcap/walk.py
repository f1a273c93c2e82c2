"""Index built from the records, for a file without a valid summary and for the bytes between indexed chunks.

Untrusted records are judged by their opcode, length and content. After damage, the reader searches the next record.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap import records
from xitl_cli.logs.formats.mcap.chunks import Chunks, message_index, scan
from xitl_cli.logs.formats.mcap.index import LARGEST_CHUNK, MOST_CHUNKS, Chunk, MessageRows, RecordingIndex
from xitl_cli.logs.formats.mcap.records import (
    AttachmentRecord,
    ChannelRecord,
    ChunkHead,
    MalformedError,
    OtherRecord,
    SchemaRecord,
)
from xitl_cli.logs.model.file_bytes import FileReader

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
_EXACT = (records.FOOTER, records.DATA_END)
"""Records that later versions of MCAP cannot extend; all others may get further fields."""

_PRIVATE = 0x80
_MOST_OTHERS = 100_000
_CHAIN = 3
_RECORD = np.dtype([("opcode", "u1"), ("length", "<u8")])


def chunk_at(source: FileReader, place: int) -> ChunkHead | None:
    """Chunk that begins at `place`, judged only by its fields, not by the opcode and length of its record."""
    try:
        head = ChunkHead.parse(source.peek(place, 9 + records.CHUNK_FIXED + 32), 1 << 62)
    except MalformedError:
        return None
    known = head.compression in ("", "lz4", "zstd")
    if not known or head.start_ns > head.end_ns or head.unpacked_size > LARGEST_CHUNK:
        return None
    if head.compression == "" and head.data_size != head.unpacked_size:
        return None
    return head if head.data_size else None


def plausible_record(source: FileReader, place: int, opcode: int, length: int, end: int) -> bool:
    """Whether a record of this opcode and length is plausible at `place`, before `end`."""
    if place + 9 + length > end or length < _SHORTEST.get(opcode, 0):
        return False
    if opcode in _EXACT:
        return length == _SHORTEST[opcode]
    if opcode == records.CHUNK:
        try:
            head = ChunkHead.parse(source.peek(place, 9 + records.CHUNK_FIXED + 32), length)
        except MalformedError:
            return False
        return head.data_at + head.data_size <= 9 + length
    if opcode == records.MESSAGE_INDEX:
        size = int.from_bytes(source.peek(place + 11, 4), "little")
        return size % 16 == 0 and length >= 6 + size
    return opcode in _SHORTEST or opcode >= _PRIVATE


def next_record(source: FileReader, begin: int, end: int) -> int | None:
    """First offset at which a few records follow each other; for a chunk, one is enough."""
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


def _chain(source: FileReader, place: int, end: int) -> bool:
    for _ in range(_CHAIN):
        if place == end:
            return True
        head = source.peek(place, 9)
        if len(head) < 9:
            return False
        opcode, length = records.HEAD.unpack(head)
        if opcode >= _PRIVATE or not plausible_record(source, place, opcode, length, end):
            return False
        if opcode == records.CHUNK and chunk_at(source, place) is not None:
            return True
        if opcode == records.FOOTER:
            return True
        place += 9 + length
    return True


_BLOCK = 4 << 20
_LARGEST_RECORD = 1 << 28
_IN_CHUNKS = (records.SCHEMA, records.CHANNEL, records.MESSAGE)


class Walk:
    """Walks the records of `source`, adds them to `index`, and adds damage to its `losses`.

    counting: add the content of chunks to the index's counts and span; False if a summary has counted it.
    """

    def __init__(self, source: FileReader, index: RecordingIndex, chunks: Chunks, counting: bool) -> None:
        self._source = source
        self._index = index
        self._losses = index.losses
        self._chunks = chunks
        self._counting = counting
        self._chunk: Chunk | None = None
        self._offsets: dict[int, NDArray[np.int64]] = {}
        self._places: dict[int, int] = {}

    def read_range(self, begin: int, end: int) -> None:
        """Read the records between two offsets."""
        at = begin
        while at < end:
            at = self._one(at, end)
        self._finish_chunk()

    def _one(self, at: int, end: int) -> int:
        """Read the record at an offset. Return the offset of the next."""
        head = self._source.peek(at, 9) if end - at >= 9 else b""
        if len(head) < 9:
            self._losses.truncated_bytes += end - at
            return end
        opcode, length = records.HEAD.unpack(head)
        if plausible_record(self._source, at, opcode, length, end):
            try:
                return self._read(at, opcode, length, end)
            except MalformedError:
                self._losses.note(at, 9 + length, "a record does not hold what it should")
                return at + 9 + int(length)
        stop = at + 9 + int(length)
        if opcode and opcode not in _SHORTEST and stop <= end and (stop == end or self._follows(stop, end)):
            self._finish_chunk()  # from a later version of the format
            return stop
        return self._damaged(at, opcode, length, end)

    def _read(self, at: int, opcode: int, length: int, end: int) -> int:
        stop = at + 9 + length
        if opcode == records.MESSAGE_INDEX:
            self._add_message_index(at, length)
            return stop
        self._finish_chunk()
        if opcode == records.CHUNK:
            head = ChunkHead.parse(self._source.peek(at, 9 + records.CHUNK_FIXED + 32), length)
            self._add_chunk(at, stop - at, head, head.data_size)
        elif opcode in _IN_CHUNKS:
            # Records outside chunks: consecutive records form an uncompressed chunk.
            data = self._source.read(at, max(min(_BLOCK, end - at), 9 + length))
            found = scan(data, 0, len(data), None, loose=True)
            size = len(data) - found.cut
            self._describe(found.schemas, found.channels)
            if len(found.rows.size) and len(self._index.chunks) < MOST_CHUNKS:
                chunk = Chunk(at, size, at, size, size, "", 0, 2**63 - 1, loose=True)
                self._index.chunks.append(chunk)
                self._index.settle_last(self._source.size)
                self._count(chunk, found.rows)
            for offset, lost in found.lost:
                self._losses.note(at + offset, lost, "a record does not hold what it should")
            return at + size
        elif opcode == records.HEADER:
            self._index.profile, self._index.library = records.parse_header(self._body(at, length))
        elif opcode == records.ATTACHMENT:
            begin = self._source.peek(at + 9, min(length, 4096))
            self._index.attachments.append(AttachmentRecord.parse(begin, at + 9, length))
        elif opcode == records.METADATA and len(self._index.others) < _MOST_OTHERS:
            name, values = records.parse_metadata(self._body(at, length))
            self._index.metadata.setdefault(name, values)
            self._index.others.append(OtherRecord(at, stop - at, name))
        elif opcode >= _PRIVATE and len(self._index.others) < _MOST_OTHERS:
            self._index.others.append(OtherRecord(at, stop - at, None))
        elif opcode == records.FOOTER and self._source.peek(stop, len(records.MAGIC) + 1) == records.MAGIC:
            return end
        return stop

    def _body(self, at: int, length: int) -> bytes:
        if length > _LARGEST_RECORD:
            raise MalformedError
        return self._source.peek(at + 9, length)

    def _damaged(self, at: int, opcode: int, length: int, end: int) -> int:
        head = chunk_at(self._source, at)
        if head is not None and at + head.data_at + head.data_size <= end:
            stop = at + head.data_at + head.data_size
            if stop == end or self._follows(stop, end):
                self._finish_chunk()
                self._losses.note(at, 0, "the record of a chunk is damaged at its begin")
                self._add_chunk(at, stop - at, head, head.data_size)
                return stop
        following = next_record(self._source, at + 1, end)
        stop = end if following is None else following
        self._finish_chunk()
        if head is not None and opcode == records.CHUNK:
            there = min(stop - at - head.data_at, head.data_size)
            self._add_chunk(at, stop - at, head, max(there, 0))
            if self._chunk is not None:
                self._chunk.cut = True
        if following is None and (at + 9 + length > end or end != self._source.size):
            self._losses.truncated_bytes += end - at
        else:
            self._losses.note(at, stop - at, "no record begins here")
        return stop

    def _follows(self, place: int, end: int) -> bool:
        head = self._source.peek(place, 9)
        if len(head) < 9:
            return False
        opcode, length = records.HEAD.unpack(head)
        return plausible_record(self._source, place, opcode, length, end)

    def _add_chunk(self, at: int, size: int, head: ChunkHead, data_size: int) -> None:
        if len(self._index.chunks) >= MOST_CHUNKS:
            self._losses.note(at, size, "there are too many chunks")
            return
        begin, kind = at + head.data_at, head.compression
        self._chunk = Chunk(at, size, begin, data_size, head.unpacked_size, kind, head.start_ns, head.end_ns)
        self._offsets, self._places = {}, {}

    def _add_message_index(self, at: int, length: int) -> None:
        if self._chunk is None or at != self._chunk.place + self._chunk.size or length > _LARGEST_RECORD:
            return
        record = self._source.peek(at, 9 + length)
        self._chunk.size += len(record)
        if len(record) < 15:
            return
        number = int.from_bytes(record[9:11], "little")
        offsets = message_index(record, number)
        if offsets is not None:
            self._offsets[number], self._places[number] = offsets, at

    def _finish_chunk(self) -> None:
        """Read a chunk once its message indexes have been read."""
        chunk, self._chunk = self._chunk, None
        if chunk is None:
            return
        self._index.chunks.append(chunk)
        self._index.settle_last(self._source.size)
        if chunk.refused:
            return
        chunk.index_places = b"".join(struct.pack("<HQ", *entry) for entry in self._places.items())
        offsets = np.concatenate(list(self._offsets.values())) if self._offsets else None
        found = self._chunks.content(chunk, offsets)
        self._describe(found.schemas, found.channels)
        self._count(chunk, found.rows)

    def _describe(self, schemas: list[SchemaRecord], channels: list[ChannelRecord]) -> None:
        for schema in schemas:
            self._index.add_schema(schema)
        for channel in channels:
            self._index.add_channel(channel)

    def _count(self, chunk: Chunk, rows: MessageRows) -> None:
        numbers, counts = np.unique(rows.channel, return_counts=True)
        chunk.holds = frozenset(numbers.tolist())
        known = np.isin(rows.channel, list(self._index.channels))
        strangers = int((~known).sum())
        if strangers:
            messages = "a message" if strangers == 1 else f"{strangers} messages"
            self._losses.note(chunk.place, int(rows.size[~known].sum()), f"{messages} of no channel that is described")
        if not self._counting or not known.any():
            return
        for number, count in zip(numbers.tolist(), counts.tolist(), strict=True):
            if number in self._index.channels:
                self._index.counts[number] = self._index.counts.get(number, 0) + count
        stamps = rows.stamp_ns[known]
        first, last = int(stamps.min()), int(stamps.max())
        span = self._index.span_ns or (first, last)
        self._index.span_ns = min(span[0], first), max(span[1], last)


def between(chunks: list[Chunk], begin: int, end: int) -> Iterator[tuple[int, int]]:
    """Ranges without a chunk."""
    for chunk in chunks:
        if chunk.place > begin:
            yield begin, chunk.place
        begin = max(begin, chunk.place + chunk.size)
    if end > begin:
        yield begin, end
