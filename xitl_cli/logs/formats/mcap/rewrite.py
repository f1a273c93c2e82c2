"""Rewriting of a recording: the readable part, with the summary and the indexes that readers need to seek.

Sound chunks, attachments, metadata and private records are copied unchanged. The rest of a damaged chunk, and messages
outside chunks, become chunks. The `mcap` package writes the records.
"""

from __future__ import annotations

import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap import records as written
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap import container
from xitl_cli.logs.formats.mcap.container import (
    MESSAGE_OVERHEAD,
    AttachmentRecord,
    ChannelRecord,
    Chunk,
    ChunkContent,
    Chunks,
    OtherRecord,
    RecordingIndex,
    SchemaRecord,
)
from xitl_cli.logs.model.file_bytes import FileReader

_PIECE = 16 << 20
_LOG_TIME = 15  # bytes of a message's record before it
_PACK: dict[str, Callable[[bytes], bytes]] = {"lz4": lz4.frame.compress, "zstd": zstandard.compress, "": bytes}
_OTHERWISE = "lz4"


@dataclass(slots=True)
class Rewritten:
    """Counts of written records."""

    messages: int = 0
    topics: int = 0
    chunks: int = 0
    rebuilt: int = 0
    """Chunks that are not copies."""
    attachments: int = 0
    metadata: int = 0
    strangers: int = 0
    """Omitted messages, of channels without a description."""

    def as_json(self) -> dict[str, int]:
        return asdict(self)


def examine(index: RecordingIndex, chunks: Chunks) -> None:
    """Read the content of all chunks, so that the index's losses are complete, and check the file's own index against
    it."""
    counts: dict[int, int] = {}
    loose_schemas, loose_channels = deque(index.loose_schemas.items()), deque(index.loose_channels.items())
    schemas, channels = {0}, set[int]()
    for chunk in index.chunks:
        indexed = bool(chunk.index_places)
        content = _content(chunks, chunk)
        if indexed and not chunk.index_places and chunks.is_sound(chunk):
            index.losses.note(chunk.place, 0, "a message index does not match its chunk")
        schemas |= {schema.id for schema in content.schemas} | _taken_until(chunk.place, loose_schemas)
        channels |= {channel.id for channel in content.channels} | _taken_until(chunk.place, loose_channels)
        in_chunk = _counts(content.rows.channel)
        for channel, count in in_chunk:
            counts[channel] = counts.get(channel, 0) + count
        used = {channel for channel, _ in in_chunk} & index.channels.keys()
        if used - channels or {index.channels[channel].schema_id for channel in used} - schemas:
            # The summary describes them, and readers that start at the beginning do not know them.
            index.losses.note(chunk.place, 0, "the channel or schema of a message is not described before it")
            channels |= used
            schemas |= index.schemas.keys()
    if {channel: count for channel, count in counts.items() if channel in index.channels} != index.counts:
        index.losses.note(0, 0, "the message counts of the summary are wrong")


def _taken_until(place: int, described: deque[tuple[int, int]]) -> set[int]:
    """Take the ids from the front that are described up to a position. described: id and position."""
    ids = set[int]()
    while described and described[0][1] <= place:
        ids.add(described.popleft()[0])
    return ids


def rewrite(source: FileReader, index: RecordingIndex, chunks: Chunks, out: BinaryIO) -> Rewritten:
    """Write the recording behind `index` to `out`. Raises OSError."""
    writer = _Writer(source, index, chunks, out)
    parts: list[Chunk | AttachmentRecord | OtherRecord] = [*index.chunks, *index.attachments, *index.others]
    for part in sorted(parts, key=lambda part: part.place):
        if isinstance(part, AttachmentRecord):
            writer.attachment(part)
        elif isinstance(part, OtherRecord):
            writer.other(part)
        elif not part.refused:
            writer.chunk(part)
    return writer.finish()


def _content(chunks: Chunks, chunk: Chunk) -> ChunkContent:
    """All records of a chunk. Discards its message indexes if they are damaged."""
    offsets = chunks.indexed_offsets(chunk) if chunk.index_places else None
    if offsets is None:
        chunk.index_places = b""
    return chunks.content(chunk, offsets)


def _counts(channel: NDArray[np.uint16]) -> list[tuple[int, int]]:
    channels, counts = np.unique(channel, return_counts=True)
    return list(zip(channels.tolist(), counts.tolist(), strict=True))


class _Writer:
    """Writes records in sequence, and collects the content of the summary."""

    def __init__(self, source: FileReader, index: RecordingIndex, chunks: Chunks, out: BinaryIO) -> None:
        self._source = source
        self._index = index
        self._chunks = chunks
        self._out = out
        self._at = 0
        self._crc = 0
        self._channels: set[int] = set()
        self._schemas: set[int] = set()
        self._counts: dict[int, int] = {}
        self._span: tuple[int, int] | None = None
        self._chunk_indexes: list[written.ChunkIndex] = []
        self._attachment_indexes: list[written.AttachmentIndex] = []
        self._metadata_indexes: list[written.MetadataIndex] = []
        self._done = Rewritten()
        self._put(container.MAGIC)
        self._write(written.Header(index.profile, index.library))

    def chunk(self, chunk: Chunk) -> None:
        """Write a chunk, or messages outside of chunks."""
        data, content = self._chunks.unpacked(chunk), _content(self._chunks, chunk)
        known = np.isin(content.rows.channel, list(self._index.channels))
        self._done.strangers += int((~known).sum())
        own = {channel.id for channel in content.channels}
        if not known.any() and not own:
            return
        channel = content.rows.channel[known]
        if known.all() and self._is_whole(chunk, content):
            self._add_schemas({channel.schema_id for channel in content.channels} - {one.id for one in content.schemas})
            self._add_channels(number for number, _ in _counts(channel) if number not in own)
            self._channels |= own
            self._schemas |= {schema.id for schema in content.schemas}
            packed, compression = self._source.read(chunk.data_place, chunk.data_size), chunk.compression
            offsets = content.rows.offset - MESSAGE_OVERHEAD
        elif known.any():
            self._add_channels(number for number, _ in _counts(channel))
            # The known messages in sequence, and the offset of each.
            begin = content.rows.offset[known] - MESSAGE_OVERHEAD
            size = content.rows.size[known] + MESSAGE_OVERHEAD
            view = memoryview(data)
            data = b"".join([view[at : at + length] for at, length in zip(begin.tolist(), size.tolist(), strict=True)])
            offsets = np.cumsum(size) - size
            compression = chunk.compression if chunk.compression in _PACK and not chunk.loose else _OTHERWISE
            packed = _PACK[compression](data)
            self._done.rebuilt += 1
        else:
            return
        self._packed(packed, data, compression, channel, offsets)

    def attachment(self, attachment: AttachmentRecord) -> None:
        place, size = attachment.record
        at, crc = self._copy(place, size)
        end = attachment.place + attachment.size
        stored = int.from_bytes(self._source.read(end, 4), "little")
        if stored and end + 4 == place + size and crc != stored:
            self._index.losses.note(place, 0, "the checksum of an attachment does not match")
        self._attachment_indexes.append(
            written.AttachmentIndex(
                offset=at,
                length=size,
                log_time=attachment.log_ns,
                create_time=attachment.create_ns,
                data_size=attachment.size,
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )

    def other(self, record: OtherRecord) -> None:
        at, _ = self._copy(record.place, record.size)
        if record.name is not None:
            self._metadata_indexes.append(written.MetadataIndex(at, record.size, record.name))

    def finish(self) -> Rewritten:
        """Write the summary."""
        self._write(written.DataEnd(self._crc))
        begin, groups, offsets = self._at, list[bytes](), list[written.SummaryOffset]()
        schemas = [_schema(schema) for schema in self._index.schemas.values() if schema.id]
        channels = [self._channel(channel) for channel in self._index.channels.values()]
        done = self._done
        done.messages, done.topics = sum(self._counts.values()), len(self._counts)
        done.chunks, done.attachments = len(self._chunk_indexes), len(self._attachment_indexes)
        done.metadata = len(self._metadata_indexes)
        first, last = self._span or (0, 0)
        statistics = written.Statistics(
            attachment_count=done.attachments,
            channel_count=len(channels),
            channel_message_counts=self._counts,
            chunk_count=done.chunks,
            message_count=done.messages,
            message_end_time=last,
            message_start_time=first,
            metadata_count=done.metadata,
            schema_count=len(schemas),
        )
        summary_records: Sequence[tuple[Opcode, Sequence[written.McapRecord]]] = (
            (Opcode.SCHEMA, schemas),
            (Opcode.CHANNEL, channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.ATTACHMENT_INDEX, self._attachment_indexes),
            (Opcode.METADATA_INDEX, self._metadata_indexes),
        )
        at = begin
        for opcode, records_of_group in summary_records:
            group = b"".join(map(_bytes, records_of_group))
            if group:
                groups.append(group)
                offsets.append(written.SummaryOffset(opcode, at, len(group)))
            at += len(group)
        summary = b"".join([*groups, *map(_bytes, offsets)])
        footer = _bytes(written.Footer(begin, at, 0))[:-4]
        self._put(summary + footer)
        self._put(zlib.crc32(summary + footer).to_bytes(4, "little") + container.MAGIC)
        return done

    def _is_whole(self, chunk: Chunk, content: ChunkContent) -> bool:
        """Whether the chunk can be copied unchanged."""
        known = {0, *self._index.schemas}
        return (
            self._chunks.is_sound(chunk)
            and not (chunk.loose or chunk.cut or chunk.headless or content.lost or content.cut)
            and all(channel.schema_id in known for channel in content.channels)
        )

    def _add_channels(self, numbers: Iterable[int]) -> None:
        """Write channels and schemas that were not written before."""
        for number in numbers:
            if number not in self._channels:
                self._channels.add(number)
                channel = self._index.channels[number]
                self._add_schemas({channel.schema_id})
                self._write(self._channel(channel))

    def _add_schemas(self, numbers: Iterable[int]) -> None:
        for number in numbers:
            schema = self._index.schemas.get(number)
            if schema is not None and number not in self._schemas:
                self._schemas.add(number)
                self._write(_schema(schema))

    def _channel(self, channel: ChannelRecord) -> written.Channel:
        """Channel without its schema if that is lost."""
        schema_id = channel.schema_id if channel.schema_id in self._index.schemas else 0
        return written.Channel(channel.id, channel.topic, channel.encoding, channel.metadata, schema_id)

    def _packed(
        self, packed: bytes, data: bytes, compression: str, channel: NDArray[np.uint16], offsets: NDArray[np.int64]
    ) -> None:
        """Write a chunk and the indexes of its messages, which begin at `offsets` in `data`."""
        if not len(offsets):
            stamp_ns = np.zeros(0, dtype=np.uint64)
        else:
            anywhere: NDArray[np.uint64] = np.ndarray((len(data) - 7,), "<u8", data, strides=(1,))
            stamp_ns = anywhere[offsets + _LOG_TIME]
        first, last = (int(stamp_ns.min()), int(stamp_ns.max())) if len(stamp_ns) else (0, 0)
        if len(stamp_ns):
            span = self._span or (first, last)
            self._span = min(span[0], first), max(span[1], last)
        at = self._at
        self._write(written.Chunk(compression, packed, last, first, zlib.crc32(data), len(data)))
        size, places = self._at - at, dict[int, int]()
        for number, count in _counts(channel):
            self._counts[number] = self._counts.get(number, 0) + count
            places[number] = self._at
            own = channel == number
            pairs = np.stack([stamp_ns[own], offsets[own].astype(np.uint64)], axis=1).astype("<u8").tobytes()
            head = container.HEAD.pack(container.MESSAGE_INDEX, 6 + len(pairs)) + struct.pack("<HI", number, len(pairs))
            self._put(head + pairs)
        self._chunk_indexes.append(
            written.ChunkIndex(
                chunk_length=size,
                chunk_start_offset=at,
                compression=compression,
                compressed_size=len(packed),
                message_end_time=last,
                message_index_length=self._at - at - size,
                message_index_offsets=places,
                message_start_time=first,
                uncompressed_size=len(data),
            )
        )

    def _copy(self, place: int, size: int) -> tuple[int, int]:
        """Copy a record unchanged. Return its new offset, and the checksum of its content without the last four
        bytes."""
        at, crc = self._at, 0
        self._put(self._source.read(place, 9))
        for begin in range(9, size, _PIECE):
            part = self._source.read(place + begin, min(_PIECE, size - begin))
            self._put(part)
            crc = zlib.crc32(part[: max(size - 4 - begin, 0)], crc)
        return at, crc

    def _write(self, record: written.McapRecord) -> None:
        self._put(_bytes(record))

    def _put(self, data: bytes) -> None:
        self._out.write(data)
        self._at += len(data)
        self._crc = zlib.crc32(data, self._crc)


def _bytes(record: written.McapRecord) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _schema(schema: SchemaRecord) -> written.Schema:
    return written.Schema(schema.id, schema.data, schema.encoding, schema.name)
