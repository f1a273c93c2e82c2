"""Chunks: decompressed to no more than their stated size, split into messages and cached; payloads by topic."""

from __future__ import annotations

import io
import struct
import zlib
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap import records
from xitl_cli.logs.formats.mcap.index import LATEST_NS, Chunk, MessageRows, RecordingIndex
from xitl_cli.logs.formats.mcap.records import ChannelRecord, ChunkHead, MalformedError, SchemaRecord
from xitl_cli.logs.model.file_bytes import FileReader

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
        return b"", f"a chunk is packed with {compression[:32]!r}, which cannot be unpacked"
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


MESSAGE_OVERHEAD = records.MESSAGE_HEAD.size
_IN_CHUNKS = (records.SCHEMA, records.CHANNEL, records.MESSAGE)
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
    whole = inside & (heads["opcode"] == records.MESSAGE) & (length >= 22) & (length <= room)
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
    head, message = records.HEAD.unpack_from, records.MESSAGE_HEAD.unpack_from
    at = begin
    while end - at >= 9:
        opcode, length = head(data, at)
        stop = at + 9 + length
        if opcode == records.MESSAGE and length >= 22 and stop <= end:
            _, _, channel, _, stamp_ns, _ = message(data, at)
            found.append((channel, at + MESSAGE_OVERHEAD, length - 22, stamp_ns))
            at = stop
            if len(found) >= _ROWS_AT_ONCE:
                blocks.append(np.array(found, dtype=np.uint64))
                found.clear()
        elif (
            opcode
            and stop <= end
            and (opcode in _IN_CHUNKS or not loose)
            and (opcode != records.MESSAGE or length >= 22)
        ):
            try:
                if opcode == records.SCHEMA:
                    content.schemas.append(SchemaRecord.parse(data[at + 9 : stop]))
                elif opcode == records.CHANNEL:
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
        for at in (np.flatnonzero(heads["opcode"] == records.MESSAGE) + begin).tolist():
            _, length, channel, _, stamp_ns, _ = records.MESSAGE_HEAD.unpack_from(data, at)
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
    opcode, length = records.HEAD.unpack_from(data, at)
    return opcode in (records.SCHEMA, records.CHANNEL, records.MESSAGE) and at + 9 + length <= end


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
            opcode, length, number, _, stamp_ns, _ = records.MESSAGE_HEAD.unpack_from(record)
            if opcode != records.MESSAGE or number != channel or not 22 <= length <= room - 9:
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
    if (
        opcode != records.MESSAGE_INDEX
        or number != channel
        or length < 6 + size
        or size % 16
        or 15 + size > len(record)
    ):
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
