"""The records of MCAP 0, parsed from bytes with any content."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<BQHIQQ")

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)

CHUNK_FIXED = 40
"""Bytes of a chunk's record without the name of its compression and its data."""

_CHUNK_HEAD = struct.Struct("<QQQII")


class MalformedError(ValueError):
    """These bytes are not a valid record."""


class Cursor:
    """Reads fields one after another. Raises MalformedError past the end."""

    def __init__(self, data: bytes, at: int = 0) -> None:
        self.data = data
        self.at = at

    def number(self, size: int) -> int:
        return int.from_bytes(self.read(size), "little")

    def text(self) -> str:
        return self.read(self.number(4)).decode("utf-8", "replace")

    def texts(self) -> dict[str, str]:
        """Texts by name, the form of metadata."""
        end = self.number(4) + self.at
        if end > len(self.data):
            raise MalformedError
        values = {}
        while self.at < end:
            key = self.text()
            values[key] = self.text()
        return values

    def read(self, size: int) -> bytes:
        end = self.at + size
        if end > len(self.data):
            raise MalformedError
        taken = self.data[self.at : end]
        self.at = end
        return taken


@dataclass(frozen=True, slots=True)
class SchemaRecord:
    id: int
    name: str
    encoding: str
    data: bytes

    @classmethod
    def parse(cls, body: bytes) -> SchemaRecord:
        cursor = Cursor(body)
        return cls(cursor.number(2), cursor.text(), cursor.text(), cursor.read(cursor.number(4)))


@dataclass(frozen=True, slots=True)
class ChannelRecord:
    """A channel."""

    id: int
    schema_id: int
    topic: str
    encoding: str
    metadata: dict[str, str] = field(default_factory=dict, compare=False)
    """Empty if unreadable; the other fields do not depend on it."""

    @classmethod
    def parse(cls, body: bytes) -> ChannelRecord:
        cursor = Cursor(body)
        number, schema_id = cursor.number(2), cursor.number(2)
        topic, encoding = cursor.text(), cursor.text()
        try:
            metadata = cursor.texts()
        except MalformedError:
            metadata = {}
        return cls(number, schema_id, topic, encoding, metadata)


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """A chunk's record without its data: `data_size` bytes, `data_at` bytes behind the beginning of the record."""

    start_ns: int
    end_ns: int
    unpacked_size: int
    crc: int
    compression: str
    data_at: int
    data_size: int

    @classmethod
    def parse(cls, record: bytes, length: int) -> ChunkHead:
        """Parse the first bytes of a chunk's record, with opcode and length. length: of the record."""
        if len(record) < 9 + CHUNK_FIXED:
            raise MalformedError
        start_ns, end_ns, unpacked_size, crc, name_size = _CHUNK_HEAD.unpack_from(record, 9)
        if name_size > 32:
            raise MalformedError
        cursor = Cursor(record, 9 + _CHUNK_HEAD.size)
        compression = cursor.read(name_size).decode("utf-8", "replace")
        data_size = cursor.number(8)
        if CHUNK_FIXED + name_size + data_size > length:
            raise MalformedError
        return cls(start_ns, end_ns, unpacked_size, crc, compression, cursor.at, data_size)


@dataclass(frozen=True, slots=True)
class ChunkIndexRecord:
    """An index entry of a chunk."""

    start_ns: int
    end_ns: int
    place: int
    length: int
    index_places: bytes
    """Packed pairs of channel (u16) and offset (u64)."""
    index_length: int
    compression: str
    data_size: int
    unpacked_size: int

    @classmethod
    def parse(cls, body: bytes) -> ChunkIndexRecord:
        cursor = Cursor(body)
        start_ns, end_ns, place, length = (cursor.number(8) for _ in range(4))
        places = cursor.read(cursor.number(4))
        if len(places) % 10:
            raise MalformedError
        index_length = cursor.number(8)
        compression = cursor.text()
        return cls(
            start_ns, end_ns, place, length, places, index_length, compression, cursor.number(8), cursor.number(8)
        )


@dataclass(frozen=True, slots=True)
class StatisticsRecord:
    messages: int
    chunks: int
    start_ns: int
    end_ns: int
    counts: dict[int, int]

    @classmethod
    def parse(cls, body: bytes) -> StatisticsRecord:
        if len(body) < 46:
            raise MalformedError
        messages, _, _, _, _, chunks, start_ns, end_ns, size = struct.unpack_from("<QHIIIIQQI", body)
        counts = Cursor(body, 46).read(size)
        if size % 10:
            raise MalformedError
        return cls(messages, chunks, start_ns, end_ns, dict(struct.iter_unpack("<HQ", counts)))


@dataclass(frozen=True, slots=True)
class AttachmentRecord:
    """Position of the `size` bytes of an attachment."""

    name: str
    place: int
    size: int
    record: tuple[int, int]
    """Offset and size of the whole record, with the opcode."""
    media_type: str
    log_ns: int
    create_ns: int

    @classmethod
    def parse(cls, begin: bytes, place: int, length: int) -> AttachmentRecord:
        """Parse the first bytes of an attachment's body. place: offset of the body in the file."""
        cursor = Cursor(begin)
        log_ns, create_ns = cursor.number(8), cursor.number(8)
        name, media_type = cursor.text(), cursor.text()
        size = cursor.number(8)
        if cursor.at + size + 4 > length:
            raise MalformedError
        return cls(name, place + cursor.at, size, (place - 9, length + 9), media_type, log_ns, create_ns)


@dataclass(frozen=True, slots=True)
class OtherRecord:
    """Position of a metadata record or a private record."""

    place: int
    size: int
    """With the opcode."""
    name: str | None
    """Of metadata; None for a private record."""


def parse_header(body: bytes) -> tuple[str, str]:
    """Profile and library."""
    cursor = Cursor(body)
    return cursor.text(), cursor.text()


def parse_footer(body: bytes) -> tuple[int, int]:
    """Beginning of the summary section (0: none), and its checksum (0: none)."""
    if len(body) < 20:
        raise MalformedError
    start, _, crc = struct.unpack_from("<QQI", body)
    return start, crc


def parse_metadata(body: bytes) -> tuple[str, dict[str, str]]:
    cursor = Cursor(body)
    return cursor.text(), cursor.texts()
