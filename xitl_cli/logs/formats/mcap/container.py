"""The MCAP container: its records, the index from the summary or from the records, and its chunks."""

from __future__ import annotations

import io
import struct
import zlib
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.model.file_bytes import FileReader
from xitl_cli.logs.model.log import Losses

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


# Index of a recording from the summary at the file's end, and the list of its damage.

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
    loose_schemas: dict[int, int] = field(default_factory=dict)
    """First position outside of chunks by id, in the order of the file."""
    loose_channels: dict[int, int] = field(default_factory=dict)
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
    footer = _footer(source)
    if footer is None:
        return None
    start, crc, end = footer
    if not len(MAGIC) < start < end or end - start > _LARGEST:
        return None
    data = source.read(start, end - start)
    if crc and zlib.crc32(source.read(end, 9 + 16), zlib.crc32(data)) != crc:
        losses.note(start, 0, "the checksum of the summary does not match")
        return None
    index = RecordingIndex(closed=True, summarized=True, losses=losses)
    entries, statistics = list[ChunkIndexRecord](), list[StatisticsRecord]()
    try:
        at = 0
        while at < len(data):
            if len(data) - at < 9:
                raise MalformedError
            opcode, length = HEAD.unpack_from(data, at)
            body = data[at + 9 : at + 9 + length]
            if len(body) != length:
                raise MalformedError
            at += 9 + length
            if opcode == SCHEMA:
                index.add_schema(SchemaRecord.parse(body))
            elif opcode == CHANNEL:
                index.add_channel(ChannelRecord.parse(body))
            elif opcode == CHUNK_INDEX:
                entries.append(ChunkIndexRecord.parse(body))
            elif opcode == STATISTICS:
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
    place = source.size - len(MAGIC) - _FOOTER_SIZE
    tail = source.read(place, _FOOTER_SIZE + len(MAGIC))
    if place <= 0 or len(tail) != _FOOTER_SIZE + len(MAGIC) or not tail.endswith(MAGIC):
        return None
    if HEAD.unpack_from(tail) != (FOOTER, 20):
        return None
    start, crc = parse_footer(tail[9:])
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
    free, wrong = len(MAGIC), list[ChunkIndexRecord]()
    for entry in entries:
        data_place = entry.place + 9 + CHUNK_FIXED + len(entry.compression)
        if (
            entry.place < free
            or data_place + entry.data_size > entry.place + entry.length
            or entry.place + entry.length + entry.index_length > end
            or entry.start_ns > entry.end_ns
        ):
            return False
        free = entry.place + entry.length + entry.index_length
        head = source.read(entry.place, 9)
        if len(head) != 9 or HEAD.unpack(head) != (CHUNK, entry.length - 9):
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
        index.losses.note(entry.place, 0, "a chunk is not at the offset that the summary gives")
    return True


# Chunks: decompressed to no more than their stated size, split into messages and cached; payloads by topic.

_PIECE = 1 << 16


def unpack(data: bytes, compression: str, size: int) -> tuple[bytes, str]:
    """Decompress at most `size` bytes. Return them and the reason why some are missing ("" if none are).

    Bytes before damage are kept.
    """
    if compression == "":
        return data[:size], "" if len(data) == size else f"a chunk of {size} bytes has {len(data)}"
    if compression == "lz4":
        unpacked, whole = _lz4(data, size)
    elif compression == "zstd":
        unpacked, whole = _zstd(data, size)
    else:
        return b"", f"a chunk has the compression {compression[:32]!r}, which is not supported"
    if whole and len(unpacked) == size:
        return unpacked, ""
    return unpacked, f"a chunk of {size} bytes cannot be unpacked beyond {len(unpacked)}"


def _lz4(data: bytes, size: int) -> tuple[bytes, bool]:
    import lz4.frame  # type: ignore[import-untyped]

    try:  # in one call if it is whole
        decompressor = lz4.frame.LZ4FrameDecompressor()
        unpacked = decompressor.decompress(data, max_length=size)
        if decompressor.eof or len(unpacked) == size:
            return unpacked, True
    except (RuntimeError, EOFError, ValueError):
        pass
    decompressor, parts, left = lz4.frame.LZ4FrameDecompressor(), [], size
    try:
        for at in range(0, len(data), _PIECE):
            part = decompressor.decompress(data[at : at + _PIECE], max_length=left)
            parts.append(part)
            left -= len(part)
            if decompressor.eof or left <= 0:
                break
    except (RuntimeError, EOFError, ValueError):
        pass
    return b"".join(parts), False


def _zstd(data: bytes, size: int) -> tuple[bytes, bool]:
    import zstandard

    parts, left = list[bytes](), size
    try:
        reader = zstandard.ZstdDecompressor(max_window_size=1 << 30).stream_reader(io.BytesIO(data))
        while left > 0:
            part = reader.read(min(left, 1 << 20))
            if not part:
                return b"".join(parts), True
            parts.append(part)
            left -= len(part)
    except (zstandard.ZstdError, MemoryError):
        return b"".join(parts), False
    return b"".join(parts), True


MESSAGE_OVERHEAD = MESSAGE_HEAD.size
_IN_CHUNKS = (SCHEMA, CHANNEL, MESSAGE)
_ROWS_AT_ONCE = 100_000
_HEAD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)


@dataclass(slots=True)
class ChunkContent:
    """Content of a chunk."""

    rows: MessageRows
    schemas: list[SchemaRecord] = field(default_factory=list)
    channels: list[ChannelRecord] = field(default_factory=list)
    lost: list[tuple[int, int]] = field(default_factory=list)
    """Offset and size of bytes that are no record."""
    cut: int = 0
    """Bytes of an unfinished last record."""


Fits = Callable[[int, int], bool]
"""Whether a message of this channel and log time is possible at this position."""


def stamps(times: NDArray[np.uint64]) -> NDArray[np.int64]:
    """Log times; larger values are clipped to the largest int64."""
    return np.minimum(times, np.uint64(LATEST_NS)).astype(np.int64)


def messages_at(data: bytes, offsets: NDArray[np.int64]) -> tuple[MessageRows, NDArray[np.bool_]]:
    """Messages with records that begin at `offsets`, and which of them are valid messages."""
    last = len(data) - MESSAGE_OVERHEAD
    inside = (offsets >= 0) & (offsets <= last)
    if last < 0 or not len(offsets):
        none = np.zeros(len(offsets), dtype=np.int64)
        return MessageRows(none.astype(np.uint16), none, none, none), inside
    heads = np.ndarray((last + 1,), dtype=_HEAD, buffer=data, strides=(1,))[np.where(inside, offsets, 0)]
    length = heads["length"]
    room = (len(data) - 9 - offsets).clip(0).astype(np.uint64)
    whole = inside & (heads["opcode"] == MESSAGE) & (length >= 22) & (length <= room)
    size = np.where(whole, length - np.uint64(22), np.uint64(0)).astype(np.int64)
    return MessageRows(heads["channel"], offsets + MESSAGE_OVERHEAD, size, stamps(heads["log"])), whole


def read_by_index(data: bytes, offsets: NDArray[np.int64]) -> ChunkContent | None:
    """All records of the chunk if its message indexes list all its messages, else None."""
    offsets = np.unique(offsets)
    rows, whole = messages_at(data, offsets)
    if not whole.all():
        return None
    ends = rows.offset + rows.size
    begins = np.append(offsets, len(data))
    free = np.append(0, ends)
    if np.any(free > begins):
        return None
    content = ChunkContent(rows)
    for gap in np.flatnonzero(free < begins).tolist():
        between = scan(data, int(free[gap]), int(begins[gap]), None)
        if len(between.rows.size) or between.lost or between.cut:
            return None
        content.schemas += between.schemas
        content.channels += between.channels
    return content


def scan(data: bytes, begin: int, end: int, fits: Fits | None, *, loose: bool = False) -> ChunkContent:
    """Read record after record. fits: check of a message at which to resume after damage; None: do not resume.

    loose: end at records that do not belong in a chunk.
    """
    found, blocks = list[tuple[int, int, int, int]](), list[NDArray[np.uint64]]()
    content = ChunkContent(_rows(blocks))
    head, message = HEAD.unpack_from, MESSAGE_HEAD.unpack_from
    at = begin
    while end - at >= 9:
        opcode, length = head(data, at)
        stop = at + 9 + length
        if opcode == MESSAGE and length >= 22 and stop <= end:
            _, _, channel, _, stamp_ns, _ = message(data, at)
            found.append((channel, at + MESSAGE_OVERHEAD, length - 22, stamp_ns))
            at = stop
            if len(found) >= _ROWS_AT_ONCE:
                blocks.append(np.array(found, dtype=np.uint64))
                found.clear()
        elif opcode and stop <= end and (opcode in _IN_CHUNKS or not loose) and (opcode != MESSAGE or length >= 22):
            try:
                if opcode == SCHEMA:
                    content.schemas.append(SchemaRecord.parse(data[at + 9 : stop]))
                elif opcode == CHANNEL:
                    content.channels.append(ChannelRecord.parse(data[at + 9 : stop]))
            except MalformedError:
                content.lost.append((at, stop - at))
            at = stop
        else:
            following = None if fits is None else _next_message(data, at + 1, end, fits)
            if following is None:
                break
            content.lost.append((at, following - at))
            at = following
    content.cut = end - at
    if found:
        blocks.append(np.array(found, dtype=np.uint64))
    content.rows = _rows(blocks)
    return content


def _rows(blocks: list[NDArray[np.uint64]]) -> MessageRows:
    table = np.concatenate(blocks) if blocks else np.zeros((0, 4), dtype=np.uint64)
    return MessageRows(
        table[:, 0].astype(np.uint16), table[:, 1].astype(np.int64), table[:, 2].astype(np.int64), stamps(table[:, 3])
    )


def _next_message(data: bytes, begin: int, end: int, fits: Fits) -> int | None:
    """Offset of the next message that is followed by another record, or by the end."""
    block = 1 << 20
    while begin <= end - MESSAGE_OVERHEAD:
        upto = min(begin + block, end - MESSAGE_OVERHEAD + 1)
        heads = np.ndarray((upto - begin,), dtype=_HEAD, buffer=data, offset=begin, strides=(1,))
        for at in (np.flatnonzero(heads["opcode"] == MESSAGE) + begin).tolist():
            _, length, channel, _, stamp_ns, _ = MESSAGE_HEAD.unpack_from(data, at)
            stop = at + 9 + length
            if length >= 22 and stop <= end and fits(channel, stamp_ns) and _begins(data, stop, end):
                return int(at)
        begin = upto
    return None


def _begins(data: bytes, at: int, end: int) -> bool:
    if at == end:
        return True
    if end - at < 9:
        return False
    opcode, length = HEAD.unpack_from(data, at)
    return opcode in (SCHEMA, CHANNEL, MESSAGE) and at + 9 + length <= end


_KEPT_BYTES = 48 << 20
_KEPT_ROWS = 4_000_000
_FEW_BYTES = 4096


class Chunks:
    """Reads chunks of `index`; adds damage to its `losses`, once."""

    def __init__(self, source: FileReader, index: RecordingIndex) -> None:
        self._source = source
        self._index = index
        self._losses = index.losses
        self._kept: OrderedDict[int, bytes] = OrderedDict()
        self._kept_bytes = 0
        self._kept_rows = 0
        self._scanned_places: set[int] = set()
        self._sound: dict[int, bool] = {}
        self._distrusted: set[int] = set()
        self._misled: set[tuple[int, int]] = set()
        self._alone: set[tuple[int, int]] = set()

    def distrust(self, channels: Iterable[int]) -> bool:
        """From now on, find the messages of these channels without message indexes. False if this was so already."""
        before = len(self._distrusted)
        self._distrusted.update(channels)
        return len(self._distrusted) > before

    def unpacked(self, chunk: Chunk) -> bytes:
        """Records in a chunk; the readable part if it is damaged."""
        kept = self._kept.get(chunk.place)
        if kept is not None:
            self._kept.move_to_end(chunk.place)
            return kept
        if chunk.refused:
            return b""
        if chunk.loose:
            data, why = self._source.read(chunk.data_place, chunk.data_size), ""
        else:
            before = chunk.data_place - chunk.place
            record = self._source.read(chunk.place, before + chunk.data_size)
            data, why = unpack(record[before:], chunk.compression, chunk.unpacked_size)
            if not why and not chunk.headless and not self._checksum_holds(chunk, record[:before], data):
                why = "the checksum of a chunk does not match"
        if chunk.place not in self._sound:
            self._sound[chunk.place] = not why
            if why and not chunk.cut:
                self._losses.note(chunk.place, 0 if data else chunk.size, why)
        self._keep(chunk, data)
        return data

    def content(self, chunk: Chunk, offsets: NDArray[np.int64] | None) -> ChunkContent:
        """All records of a chunk, found by the `offsets` of its message indexes if these are correct."""
        data = self.unpacked(chunk)
        if offsets is not None and self._sound.get(chunk.place, True):
            found = read_by_index(data, offsets)
            if found is not None:
                return found
        found = self._scanned(chunk, data)
        if chunk.rows is None and self._kept_rows + len(found.rows.size) <= _KEPT_ROWS:
            self._kept_rows += len(found.rows.size)
            chunk.rows = found.rows
        if offsets is not None:
            chunk.index_places = b""
        return found

    def rows(self, chunk: Chunk, channel: int) -> MessageRows | None:
        """Messages of one channel in a chunk, with positions in `unpacked`; None if it certainly has none.

        The result is the same at every call, whatever is known about other channels, because surveys rely on it.
        """
        if chunk.refused or (chunk.holds is not None and channel not in chunk.holds):
            return None
        if self._is_indexed(chunk, channel):
            places = chunk.index()
            if channel not in places:
                return None
            offsets = self._offsets(chunk, channel, places)
            data = self.unpacked(chunk)
            sound = self._sound.get(chunk.place, True) or (chunk.place, channel) in self._alone
            if offsets is not None and sound:
                rows, whole = messages_at(data, offsets)
                if whole.all() and (rows.channel == channel).all():
                    return rows
                self._losses.note(chunk.place, 0, "a message index names places where no such message is")
            self._misled.add((chunk.place, channel))
        rows = self.content(chunk, None).rows if chunk.rows is None else chunk.rows
        return rows.of_channel(channel)

    def is_sound(self, chunk: Chunk) -> bool:
        """Whether the chunk is complete and its checksum is correct, once it was decompressed."""
        return self._sound.get(chunk.place, False)

    def indexed_offsets(self, chunk: Chunk) -> NDArray[np.int64] | None:
        """Increasing offsets of messages according to the message indexes; None if one of these is damaged."""
        found = [np.zeros(0, dtype=np.int64)]
        places = chunk.index()
        for channel in places:
            offsets = self._offsets(chunk, channel, places)
            if offsets is None:
                return None
            found.append(offsets)
        return np.sort(np.concatenate(found))

    def _is_indexed(self, chunk: Chunk, channel: int) -> bool:
        trusted = channel not in self._distrusted and (chunk.place, channel) not in self._misled
        return bool(chunk.index_places) and trusted

    def lone_payloads(self, chunk: Chunk, channel: int) -> tuple[MessageRows, list[bytes]] | None:
        """Messages of a channel read one by one, if that avoids reading most of a chunk; None otherwise."""
        if chunk.compression or chunk.loose or chunk.place in self._kept or chunk.headless:
            return None
        if not (self._is_indexed(chunk, channel) and self._sound.get(chunk.place, True)):
            return None
        places = chunk.index()
        offsets = self._offsets(chunk, channel, places) if channel in places else None
        if offsets is None or chunk.refused or len(offsets) * 2 * _FEW_BYTES > chunk.data_size:
            return None
        sizes, stamps, payloads = list[int](), list[int](), list[bytes]()
        for offset in offsets.tolist():
            room = chunk.data_size - offset
            record = self._source.read(chunk.data_place + offset, min(_FEW_BYTES, room)) if 0 <= offset < room else b""
            if len(record) < MESSAGE_OVERHEAD:
                return None
            opcode, length, number, _, stamp_ns, _ = MESSAGE_HEAD.unpack_from(record)
            if opcode != MESSAGE or number != channel or not 22 <= length <= room - 9:
                return None
            if 9 + length > len(record):
                record += self._source.read(chunk.data_place + offset + len(record), 9 + length - len(record))
            payload = record[MESSAGE_OVERHEAD : 9 + length]
            sizes.append(len(payload))
            stamps.append(min(stamp_ns, LATEST_NS))
            payloads.append(payload)
        self._alone.add((chunk.place, channel))
        rows = MessageRows(
            np.full(len(sizes), channel, dtype=np.uint16),
            offsets + MESSAGE_OVERHEAD,
            np.array(sizes, dtype=np.int64),
            np.array(stamps, dtype=np.int64),
        )
        return rows, payloads

    def _scanned(self, chunk: Chunk, data: bytes) -> ChunkContent:
        if chunk.loose:
            known = self._index.channels
            found = scan(data, 0, len(data), lambda channel, _: channel in known)
        else:
            found = scan(data, 0, len(data), lambda _, stamp_ns: chunk.start_ns <= stamp_ns <= chunk.end_ns)
        if chunk.place not in self._scanned_places:
            self._scanned_places.add(chunk.place)
            for offset, lost in found.lost:
                self._losses.note(chunk.unpacked_from + offset, lost, "no record begins here inside a chunk")
            if found.cut and not chunk.cut:
                self._losses.note(chunk.place, found.cut, "the last record of a chunk is cut off")
            if not self._sound.get(chunk.place, True) and not chunk.cut:
                self._losses.suspect += len(found.rows.size)
        return found

    def _offsets(self, chunk: Chunk, channel: int, places: dict[int, int]) -> NDArray[np.int64] | None:
        begin = places[channel]
        end = min((place for place in places.values() if place > begin), default=chunk.place + chunk.size)
        if begin < chunk.data_place + chunk.data_size or end > chunk.place + chunk.size:
            return None
        return message_index(self._source.read(begin, end - begin), channel)

    def _checksum_holds(self, chunk: Chunk, before: bytes, data: bytes) -> bool:
        try:
            crc = ChunkHead.parse(before, chunk.data_place - chunk.place - 9 + chunk.data_size).crc
        except MalformedError:
            return False
        return crc == 0 or chunk.place in self._sound or zlib.crc32(data) == crc

    def _keep(self, chunk: Chunk, data: bytes) -> None:
        if len(data) > _KEPT_BYTES // 2:
            return
        self._kept[chunk.place] = data
        self._kept_bytes += len(data)
        while self._kept_bytes > _KEPT_BYTES:
            _, dropped = self._kept.popitem(last=False)
            self._kept_bytes -= len(dropped)


def message_index(record: bytes, channel: int) -> NDArray[np.int64] | None:
    """Offsets in the order of the chunk; None if the record is no index of the channel."""
    if len(record) < 15:
        return None
    opcode, length, number, size = struct.unpack_from("<BQHI", record)
    if opcode != MESSAGE_INDEX or number != channel or length < 6 + size or size % 16 or 15 + size > len(record):
        return None
    pairs = np.frombuffer(record, dtype="<u8", offset=15, count=size // 8).reshape(-1, 2)
    return np.unique(stamps(pairs[:, 1]))


BATCH_BYTES = 16 << 20
_I64 = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class PayloadBatch:
    """Payloads of a batch: payload i is data[start[i] : start[i] + size[i]]."""

    data: bytes
    start: NDArray[np.int64]
    size: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    place: NDArray[np.int64]
    """Offset of its record in the uncompressed file."""

    def __len__(self) -> int:
        return len(self.start)

    def payload(self, row: int) -> bytes:
        begin = int(self.start[row])
        return self.data[begin : begin + int(self.size[row])]

    def rows(self, kept: NDArray[np.bool_]) -> PayloadBatch:
        """A selection of payloads, not copied."""
        return PayloadBatch(self.data, self.start[kept], self.size[kept], self.stamp_ns[kept], self.place[kept])


def batches(chunks: Chunks, where: Sequence[Chunk], channels: Sequence[int]) -> Iterator[PayloadBatch]:
    """All messages of the channels in the order of the file."""
    return join_payloads(found for chunk in where for found in _of_chunk(chunks, chunk, channels))


def join_payloads(found: Iterable[tuple[_I64, _I64, _I64, Sequence[bytes | memoryview]]]) -> Iterator[PayloadBatch]:
    """Join messages, given as sizes, stamps (ns), offsets and payloads, to batches. A batch ends after BATCH_BYTES."""
    payloads, sizes, stamps, places = list[bytes | memoryview](), list[_I64](), list[_I64](), list[_I64]()
    held = 0
    for size, stamp_ns, place, data in found:
        payloads.extend(data)
        sizes.append(size)
        stamps.append(stamp_ns)
        places.append(place)
        held += int(size.sum())
        if held >= BATCH_BYTES:
            yield _batch(payloads, sizes, stamps, places)
            payloads, sizes, stamps, places, held = [], [], [], [], 0
    if sizes:
        yield _batch(payloads, sizes, stamps, places)


def _of_chunk(
    chunks: Chunks, chunk: Chunk, channels: Sequence[int]
) -> Iterator[tuple[_I64, _I64, _I64, Sequence[bytes | memoryview]]]:
    if len(channels) == 1 and (alone := chunks.lone_payloads(chunk, channels[0])) is not None:
        rows, lone = alone
        yield rows.size, rows.stamp_ns, chunk.unpacked_from + rows.offset - MESSAGE_OVERHEAD, lone
        return
    each = (chunks.rows(chunk, channel) for channel in channels)
    found = [some for some in each if some is not None and len(some.size)]
    if not found:
        return
    offset, size, stamp_ns = (
        np.concatenate([getattr(some, name) for some in found]) for name in ("offset", "size", "stamp_ns")
    )
    if len(found) > 1:
        order = np.argsort(offset, kind="stable")
        offset, size, stamp_ns = offset[order], size[order], stamp_ns[order]
    view = memoryview(chunks.unpacked(chunk))
    ends = (offset + size).tolist()
    data = [view[begin:end] for begin, end in zip(offset.tolist(), ends, strict=True)]
    yield size, stamp_ns, chunk.unpacked_from + offset - MESSAGE_OVERHEAD, data


def _batch(
    payloads: Sequence[bytes | memoryview], sizes: list[_I64], stamps: list[_I64], places: list[_I64]
) -> PayloadBatch:
    size = np.concatenate(sizes)
    return PayloadBatch(
        b"".join(payloads), np.cumsum(size) - size, size, np.concatenate(stamps), np.concatenate(places)
    )


# Index built from the records, for a file without a valid summary and for the bytes between indexed chunks.
#
# Untrusted records are judged by their opcode, length and content. After damage, the reader searches the next
# record.

_SHORTEST = {
    HEADER: 8,
    FOOTER: 20,
    SCHEMA: 14,
    CHANNEL: 16,
    MESSAGE: 22,
    CHUNK: CHUNK_FIXED,
    MESSAGE_INDEX: 6,
    CHUNK_INDEX: 60,
    ATTACHMENT: 36,
    ATTACHMENT_INDEX: 48,
    STATISTICS: 46,
    METADATA: 8,
    METADATA_INDEX: 20,
    SUMMARY_OFFSET: 17,
    DATA_END: 4,
}
_EXACT = (FOOTER, DATA_END)
"""Records that later versions of MCAP cannot extend; all others may get further fields."""

_PRIVATE = 0x80
_MOST_OTHERS = 100_000
_CHAIN = 3
_RECORD = np.dtype([("opcode", "u1"), ("length", "<u8")])


def chunk_at(source: FileReader, place: int) -> ChunkHead | None:
    """Chunk that begins at `place`, judged only by its fields, not by the opcode and length of its record."""
    try:
        head = ChunkHead.parse(source.peek(place, 9 + CHUNK_FIXED + 32), 1 << 62)
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
    if opcode == CHUNK:
        try:
            head = ChunkHead.parse(source.peek(place, 9 + CHUNK_FIXED + 32), length)
        except MalformedError:
            return False
        return head.data_at + head.data_size <= 9 + length
    if opcode == MESSAGE_INDEX:
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
        likely = (heads["opcode"] >= SCHEMA) & (heads["opcode"] <= DATA_END)
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
        opcode, length = HEAD.unpack(head)
        if opcode >= _PRIVATE or not plausible_record(source, place, opcode, length, end):
            return False
        if opcode == CHUNK and chunk_at(source, place) is not None:
            return True
        if opcode == FOOTER:
            return True
        place += 9 + length
    return True


_BLOCK = 4 << 20
_LARGEST_RECORD = 1 << 28


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
        opcode, length = HEAD.unpack(head)
        if plausible_record(self._source, at, opcode, length, end):
            try:
                return self._read(at, opcode, length, end)
            except MalformedError:
                self._losses.note(at, 9 + length, "a record has invalid content")
                return at + 9 + int(length)
        stop = at + 9 + int(length)
        if opcode and opcode not in _SHORTEST and stop <= end and (stop == end or self._follows(stop, end)):
            self._finish_chunk()  # from a later version of the format
            return stop
        return self._damaged(at, opcode, length, end)

    def _read(self, at: int, opcode: int, length: int, end: int) -> int:
        stop = at + 9 + length
        if opcode == MESSAGE_INDEX:
            self._add_message_index(at, length)
            return stop
        self._finish_chunk()
        if opcode == CHUNK:
            head = ChunkHead.parse(self._source.peek(at, 9 + CHUNK_FIXED + 32), length)
            self._add_chunk(at, stop - at, head, head.data_size)
        elif opcode in _IN_CHUNKS:
            # Records outside chunks: consecutive records form an uncompressed chunk.
            data = self._source.read(at, max(min(_BLOCK, end - at), 9 + length))
            found = scan(data, 0, len(data), None, loose=True)
            size = len(data) - found.cut
            self._describe(found.schemas, found.channels)
            for schema in found.schemas:
                self._index.loose_schemas.setdefault(schema.id, at)
            for channel in found.channels:
                self._index.loose_channels.setdefault(channel.id, at)
            if len(found.rows.size) and len(self._index.chunks) < MOST_CHUNKS:
                chunk = Chunk(at, size, at, size, size, "", 0, 2**63 - 1, loose=True)
                self._index.chunks.append(chunk)
                self._index.settle_last(self._source.size)
                self._count(chunk, found.rows)
            for offset, lost in found.lost:
                self._losses.note(at + offset, lost, "a record has invalid content")
            return at + size
        elif opcode == HEADER:
            self._index.profile, self._index.library = parse_header(self._body(at, length))
        elif opcode == ATTACHMENT:
            begin = self._source.peek(at + 9, min(length, 4096))
            self._index.attachments.append(AttachmentRecord.parse(begin, at + 9, length))
        elif opcode == METADATA and len(self._index.others) < _MOST_OTHERS:
            name, values = parse_metadata(self._body(at, length))
            self._index.metadata.setdefault(name, values)
            self._index.others.append(OtherRecord(at, stop - at, name))
        elif opcode >= _PRIVATE and len(self._index.others) < _MOST_OTHERS:
            self._index.others.append(OtherRecord(at, stop - at, None))
        elif opcode == FOOTER and self._source.peek(stop, len(MAGIC) + 1) == MAGIC:
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
        if head is not None and opcode == CHUNK:
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
        opcode, length = HEAD.unpack(head)
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
