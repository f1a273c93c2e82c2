"""Index of a recording from the summary at the file's end, and the list of its damage."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap import records
from xitl_cli.logs.formats.mcap.records import (
    AttachmentRecord,
    ChannelRecord,
    ChunkIndexRecord,
    MalformedError,
    OtherRecord,
    SchemaRecord,
    StatisticsRecord,
)
from xitl_cli.logs.model.file_bytes import FileReader
from xitl_cli.logs.model.log import Losses

MOST_CHUNKS = 1_000_000
MOST_SCHEMA_BYTES = 64 << 20
LARGEST_CHUNK = 1 << 30
LATEST_NS = 2**63 - 1
"""Largest int64; later stamps, which are damage, count as this."""

_EXPANSION = 256


@dataclass(frozen=True, slots=True)
class MessageRows:
    """Messages of a chunk, in the chunk's order; each array is (n,)."""

    channel: NDArray[np.uint16]
    offset: NDArray[np.int64]
    """Position of the payload."""
    size: NDArray[np.int64]
    """Of the payload, bytes."""
    stamp_ns: NDArray[np.int64]
    """Log time."""

    def of_channel(self, channel: int) -> MessageRows:
        mine = self.channel == channel
        return MessageRows(self.channel[mine], self.offset[mine], self.size[mine], self.stamp_ns[mine])


@dataclass(slots=True)
class Chunk:
    """`data_size` bytes at `data_place`, compressed unless `compression` is ""."""

    place: int
    size: int
    """Of the whole record at `place`, to count its loss."""
    data_place: int
    data_size: int
    unpacked_size: int
    compression: str
    start_ns: int
    end_ns: int
    unpacked_from: int = 0
    """Offset of its first byte in the uncompressed file."""
    index_places: bytes = b""
    rows: MessageRows | None = None
    """Its messages, if it has no trustworthy message index and was searched."""
    holds: frozenset[int] | None = None
    """Channels in it, if known."""
    loose: bool = False
    """Records outside of any chunk."""
    cut: bool = False
    """It extends beyond the end of the file."""
    headless: bool = False
    """Its record is damaged at the beginning."""
    refused: bool = False
    """Its size is too large to be true."""

    def index(self) -> dict[int, int]:
        """Offsets of message index records by channel; empty if there are none."""
        return dict(struct.iter_unpack("<HQ", self.index_places))


@dataclass(slots=True)
class RecordingLosses(Losses):
    """Damage of a recording, and the number of duplicate definitions."""

    redefined: int = 0


@dataclass(slots=True)
class RecordingIndex:
    """Index of a recording."""

    profile: str = ""
    library: str = ""
    schemas: dict[int, SchemaRecord] = field(default_factory=dict)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    """Messages by channel."""
    span_ns: tuple[int, int] | None = None
    attachments: list[AttachmentRecord] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    others: list[OtherRecord] = field(default_factory=list)
    """Metadata and private records."""
    closed: bool = False
    """The writer has finished the file."""
    summarized: bool = False
    """It has a valid summary."""
    losses: RecordingLosses = field(default_factory=RecordingLosses)
    schema_bytes: int = 0
    unpacked_bytes: int = 0
    unpacked_to: int = 0

    def add_schema(self, schema: SchemaRecord) -> None:
        known = self.schemas.get(schema.id)
        if known is not None:
            self.losses.redefined += known != schema
        elif self.schema_bytes + len(schema.data) <= MOST_SCHEMA_BYTES:
            self.schema_bytes += len(schema.data)
            self.schemas[schema.id] = schema

    def add_channel(self, channel: ChannelRecord) -> None:
        """Add a channel. The first channel of an id is kept, because earlier messages belong to it."""
        known = self.channels.setdefault(channel.id, channel)
        self.losses.redefined += known != channel

    def settle(self, size_bytes: int) -> None:
        """Sort the chunks, assign their positions in the uncompressed file, and refuse chunks of an implausible
        size."""
        self.chunks.sort(key=lambda chunk: chunk.place)
        self.unpacked_bytes = self.unpacked_to = 0
        for chunk in self.chunks:
            self._settle(chunk, size_bytes)

    def settle_last(self, size_bytes: int) -> None:
        """Like `settle`, for a chunk just added at the end."""
        self._settle(self.chunks[-1], size_bytes)

    def _settle(self, chunk: Chunk, size_bytes: int) -> None:
        most = LARGEST_CHUNK + _EXPANSION * size_bytes - self.unpacked_bytes
        if chunk.refused or chunk.unpacked_size > min(most, LARGEST_CHUNK):
            if not chunk.refused:
                self.losses.note(chunk.place, chunk.size, f"a chunk claims {chunk.unpacked_size} bytes unpacked")
            chunk.refused = True
            return
        self.unpacked_bytes += chunk.unpacked_size
        chunk.unpacked_from = max(chunk.data_place, self.unpacked_to)
        self.unpacked_to = chunk.unpacked_from + chunk.unpacked_size


_FOOTER_SIZE = 9 + 20
_LARGEST = 1 << 30


def has_footer(source: FileReader) -> bool:
    """Whether the file ends with a footer, as a finished file does."""
    return _footer(source) is not None


def from_summary(source: FileReader, losses: RecordingLosses) -> RecordingIndex | None:
    """Index from the summary; None if it is missing or wrong. Its chunks are not settled yet."""
    found = _footer(source)
    if found is None:
        return None
    start, crc, end = found
    if not len(records.MAGIC) < start < end or end - start > _LARGEST:
        return None
    data = source.read(start, end - start)
    if crc and zlib.crc32(source.read(end, 9 + 16), zlib.crc32(data)) != crc:
        losses.note(start, 0, "the checksum of the summary does not match")
        return None
    index, entries, statistics = (
        RecordingIndex(closed=True, summarized=True, losses=losses),
        list[ChunkIndexRecord](),
        list[StatisticsRecord](),
    )
    try:
        at = 0
        while at < len(data):
            if len(data) - at < 9:
                raise MalformedError
            opcode, length = records.HEAD.unpack_from(data, at)
            body = data[at + 9 : at + 9 + length]
            if len(body) != length:
                raise MalformedError
            at += 9 + length
            if opcode == records.SCHEMA:
                index.add_schema(SchemaRecord.parse(body))
            elif opcode == records.CHANNEL:
                index.add_channel(ChannelRecord.parse(body))
            elif opcode == records.CHUNK_INDEX:
                entries.append(ChunkIndexRecord.parse(body))
            elif opcode == records.STATISTICS:
                statistics.append(StatisticsRecord.parse(body))
    except MalformedError:
        return None
    if not statistics or not _agree(index, entries, statistics[-1]):
        return None
    index.counts = {channel: count for channel, count in statistics[-1].counts.items() if count}
    if statistics[-1].messages:
        index.span_ns = min(statistics[-1].start_ns, LATEST_NS), min(statistics[-1].end_ns, LATEST_NS)
    return index if _add_chunks(index, entries, source, start, bool(crc)) else None


def _footer(source: FileReader) -> tuple[int, int, int] | None:
    """Start of the summary, its checksum and its end."""
    place = source.size - len(records.MAGIC) - _FOOTER_SIZE
    tail = source.read(place, _FOOTER_SIZE + len(records.MAGIC))
    if place <= 0 or len(tail) != _FOOTER_SIZE + len(records.MAGIC) or not tail.endswith(records.MAGIC):
        return None
    if records.HEAD.unpack_from(tail) != (records.FOOTER, 20):
        return None
    start, crc = records.parse_footer(tail[9:])
    return start, crc, place


def _agree(index: RecordingIndex, entries: list[ChunkIndexRecord], statistics: StatisticsRecord) -> bool:
    """Whether the parts of the summary are consistent."""
    counts = statistics.counts
    return (
        len(entries) == statistics.chunks
        and len(entries) <= MOST_CHUNKS
        and sum(counts.values()) == statistics.messages
        and all(channel in index.channels for channel, count in counts.items() if count)
        and all(channel.schema_id in (0, *index.schemas) for channel in index.channels.values())
        and statistics.start_ns <= statistics.end_ns
    )


def _add_chunks(
    index: RecordingIndex, entries: list[ChunkIndexRecord], source: FileReader, end: int, sure: bool
) -> bool:
    """Add the chunks of the summary. False if they are not at their stated offsets. sure: the summary has a
    checksum."""
    entries.sort(key=lambda entry: entry.place)
    free, wrong = len(records.MAGIC), list[ChunkIndexRecord]()
    for entry in entries:
        data_place = entry.place + 9 + records.CHUNK_FIXED + len(entry.compression)
        if (
            entry.place < free
            or data_place + entry.data_size > entry.place + entry.length
            or entry.place + entry.length + entry.index_length > end
            or entry.start_ns > entry.end_ns
        ):
            return False
        free = entry.place + entry.length + entry.index_length
        head = source.read(entry.place, 9)
        if len(head) != 9 or records.HEAD.unpack(head) != (records.CHUNK, entry.length - 9):
            wrong.append(entry)
        index.chunks.append(
            Chunk(
                place=entry.place,
                size=entry.length + entry.index_length,
                data_place=data_place,
                data_size=entry.data_size,
                unpacked_size=entry.unpacked_size,
                compression=entry.compression,
                start_ns=entry.start_ns,
                end_ns=entry.end_ns,
                index_places=entry.index_places,
                headless=bool(wrong) and wrong[-1] is entry,
            )
        )
    if wrong and (not sure or 2 * len(wrong) > len(entries)):
        return False
    for entry in wrong:
        index.losses.note(entry.place, 0, "a chunk does not begin where the summary says it does")
    return True
