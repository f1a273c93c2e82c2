"""The records of an MCAP file, a whole chunk at a time: byte for byte the output of `mcap.writer.Writer`.

That writer packs every message field by field into a buffer, which took a fifteenth of a run's time. The layout is from
https://mcap.dev/spec. The package's record classes pack the rare records.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from tempfile import SpooledTemporaryFile
from typing import Any, BinaryIO
from weakref import finalize

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

ChunkMessage = tuple[int, int, bytes]
"""Channel, log time and the record of a message."""

COMPRESSIONS: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "zstd": ("zstd", zstandard.compress),
    "lz4": ("lz4", lz4.frame.compress),
    "none": ("", bytes),
}
"""Name in the file and packing function, by the name in a profile."""

_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_OPCODE, _MESSAGE_INDEX_OPCODE = int(Opcode.MESSAGE), int(Opcode.MESSAGE_INDEX)
_INDEX_BYTES = 1 << 16  # of the chunk index that stay in memory: some minutes of a run in real time
_LENGTH_BYTES = 9  # opcode and length of a record, which its length does not include
MESSAGE_BYTES = _MESSAGE.size  # of a message's record, without its payload


def message_record(channel: int, log_ns: int, payload: bytes, publish_ns: int) -> bytes:
    """Return the record of one message, for `ChunkWriter.write_chunk`."""
    length = MESSAGE_BYTES - _LENGTH_BYTES + len(payload)
    return _MESSAGE.pack(_MESSAGE_OPCODE, length, channel, 0, log_ns, publish_ns) + payload


class ChunkWriter:
    """Writes an MCAP file to `stream`, from its start. Every method passes on errors of the stream.

    like: a writer whose schemas and channels this file has from its start, with the same numbers.
    """

    def __init__(self, stream: BinaryIO, compression: str, like: ChunkWriter | None = None) -> None:
        self._stream = stream
        self._compression, self._compressed = COMPRESSIONS[compression]
        self._definitions = RecordBuilder()  # schemas and channels for the start of the next chunk
        self._schemas: list[Schema] = [] if like is None else [*like._schemas]
        self._channels: list[Channel] = [] if like is None else [*like._channels]
        for record in (*self._schemas, *self._channels):
            record.write(self._definitions)
        self._counts: Counter[int] = Counter()
        # A temporary file has the index of the chunks, because a night has some hundred thousand.
        self._chunk_index = SpooledTemporaryFile(_INDEX_BYTES)  # noqa: SIM115  read by `finish`
        finalize(self, self._chunk_index.close)
        self._chunks = 0
        self.span_ns = 0, 0
        """Earliest and latest log time of the written chunks; zeros without a chunk."""
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        stream.write(MCAP0_MAGIC + _packed(Header("xitl", "xitl")))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Return the number of a new schema."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        schema.write(self._definitions)
        return schema.id

    def register_channel(self, topic: str, encoding: str, schema: int) -> int:
        """Return the number of a new channel."""
        number = len(self._channels) + 1
        channel = Channel(id=number, topic=topic, message_encoding=encoding, metadata={}, schema_id=schema)
        self._channels.append(channel)
        channel.write(self._definitions)
        return number

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Write a file into the recording."""
        offset = self._stream.tell()
        attachment = _packed(Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data))
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=len(attachment),
                create_time=0,
                log_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )
        self._stream.write(attachment)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write named texts into the recording."""
        offset = self._stream.tell()
        metadata = _packed(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=offset, length=len(metadata), name=name))
        self._stream.write(metadata)

    def write_chunk(self, messages: Sequence[ChunkMessage]) -> None:
        """Write a chunk of at least one message, and its index."""
        definitions = _content(self._definitions)
        entries: dict[int, list[int]] = {}  # by channel: log time and offset, alternating
        at = len(definitions)
        for channel, log_ns, record in messages:
            entries.setdefault(channel, []).extend((log_ns, at))
            at += len(record)
        data = b"".join([definitions, *(record for _, _, record in messages)])
        stamps_ns = [log_ns for _, log_ns, _ in messages]
        chunk = Chunk(
            compression=self._compression,
            data=self._compressed(data),
            message_start_time=min(stamps_ns),
            message_end_time=max(stamps_ns),
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        offset, packed = self._stream.tell(), _packed(chunk)
        indices, offsets, index_bytes = [], {}, 0
        for channel, pairs in entries.items():
            self._counts[channel] += len(pairs) // 2
            offsets[channel] = offset + len(packed) + index_bytes
            content = struct.pack(f"<HI{len(pairs)}Q", channel, 8 * len(pairs), *pairs)
            indices.append(struct.pack("<BQ", _MESSAGE_INDEX_OPCODE, len(content)) + content)
            index_bytes += len(indices[-1])
        index = ChunkIndex(
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            chunk_start_offset=offset,
            chunk_length=len(packed),
            message_index_offsets=offsets,
            message_index_length=index_bytes,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            uncompressed_size=chunk.uncompressed_size,
        )
        self._chunk_index.write(_packed(index))
        start_ns, end_ns = self.span_ns if self._chunks else (chunk.message_start_time, 0)
        self.span_ns = min(start_ns, chunk.message_start_time), max(end_ns, chunk.message_end_time)
        self._chunks += 1
        self._stream.write(b"".join([packed, *indices]))

    def finish(self) -> None:
        """Write the end of the data and the summary section with the indexes."""
        self._stream.write(_packed(DataEnd(0)))
        start = self._stream.tell()
        start_ns, end_ns = self.span_ns
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunks,
            message_count=self._counts.total(),
            message_end_time=end_ns,
            message_start_time=start_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        self._chunk_index.seek(0)
        groups = {
            Opcode.SCHEMA: _joined(self._schemas),
            Opcode.CHANNEL: _joined(self._channels),
            Opcode.STATISTICS: _packed(statistics),
            Opcode.CHUNK_INDEX: self._chunk_index.read(),
            Opcode.ATTACHMENT_INDEX: _joined(self._attachments),
            Opcode.METADATA_INDEX: _joined(self._metadata),
        }
        summary, offsets = b"", []
        for opcode, group in groups.items():
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group))
            )
            summary += group
        offset_start = start + len(summary)
        summary += _joined(offsets)
        footer = Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=0)
        footer.summary_crc = zlib.crc32(summary + _packed(footer)[:-4])
        self._stream.write(summary + _packed(footer) + MCAP0_MAGIC)


def _joined(records: Iterable[Any]) -> bytes:
    return b"".join(map(_packed, records))


def _packed(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return _content(builder)


def _content(builder: RecordBuilder) -> bytes:
    """Return the content of the builder and clear it."""
    content: bytes = builder.end()  # type: ignore[no-untyped-call]
    return content
