"""The index as the file itself has it, behind its data."""

from __future__ import annotations

import zlib

from xitl_cli.logs.formats.mcap import records
from xitl_cli.logs.formats.mcap.index import MOST_CHUNKS, Chunk, Index, Tally
from xitl_cli.logs.formats.mcap.records import ChunkIndex, MalformedError, Statistics
from xitl_cli.logs.formats.mcap.source import Source

_FOOTER_SIZE = 9 + 20
_LARGEST = 1 << 30


def closed(source: Source) -> bool:
    """Whether the file ends as a finished one does."""
    return _footer(source) is not None


def from_summary(source: Source, tally: Tally) -> Index | None:
    """The index, None when there is none that holds. Chunks are not settled, what lies between them is not read."""
    found = _footer(source)
    if found is None:
        return None
    start, crc, end = found
    if not len(records.MAGIC) < start < end or end - start > _LARGEST:
        return None
    data = source.read(start, end - start)
    if crc and zlib.crc32(source.read(end, 9 + 16), zlib.crc32(data)) != crc:
        tally.note(start, 0, "the checksum of the summary does not match")
        return None
    index, entries, statistics = Index(closed=True), list[ChunkIndex](), list[Statistics]()
    try:
        _read(data, index, entries, statistics, source, tally)
    except MalformedError:
        return None
    if not statistics or not _agree(index, entries, statistics[-1]):
        return None
    index.counts = {channel: count for channel, count in statistics[-1].counts.items() if count}
    if statistics[-1].messages:
        index.span_ns = statistics[-1].start_ns, statistics[-1].end_ns
    return index if _place(index, entries, source, start, bool(crc), tally) else None


def _footer(source: Source) -> tuple[int, int, int] | None:
    """Begin of the summary, its checksum, and where it ends."""
    place = source.size - len(records.MAGIC) - _FOOTER_SIZE
    tail = source.read(place, _FOOTER_SIZE + len(records.MAGIC))
    if place <= 0 or len(tail) != _FOOTER_SIZE + len(records.MAGIC) or not tail.endswith(records.MAGIC):
        return None
    if records.HEAD.unpack_from(tail) != (records.FOOTER, 20):
        return None
    start, crc = records.footer(tail[9:])
    return start, crc, place


def _read(
    data: bytes, index: Index, entries: list[ChunkIndex], statistics: list[Statistics], source: Source, tally: Tally
) -> None:
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
            index.add_schema(records.schema(body), tally)
        elif opcode == records.CHANNEL:
            index.add_channel(records.channel(body), tally)
        elif opcode == records.CHUNK_INDEX:
            entries.append(records.chunk_index(body))
        elif opcode == records.STATISTICS:
            statistics.append(records.statistics(body))


def _agree(index: Index, entries: list[ChunkIndex], statistics: Statistics) -> bool:
    """Whether the parts of the summary tell the same story."""
    counts = statistics.counts
    return (
        len(entries) == statistics.chunks
        and len(entries) <= MOST_CHUNKS
        and sum(counts.values()) == statistics.messages
        and all(channel in index.channels for channel, count in counts.items() if count)
        and all(channel.schema_id in (0, *index.schemas) for channel in index.channels.values())
        and statistics.start_ns <= statistics.end_ns < 2**63
    )


def _place(index: Index, entries: list[ChunkIndex], source: Source, end: int, sure: bool, tally: Tally) -> bool:
    """Turn chunk indexes to chunks; False when they are not where the summary says. sure: it has a checksum."""
    entries.sort(key=lambda entry: entry.place)
    free, wrong = len(records.MAGIC), list[ChunkIndex]()
    for entry in entries:
        data_place = entry.place + 9 + records.CHUNK_FIXED + len(entry.compression)
        if (
            entry.place < free
            or data_place + entry.data_size != entry.place + entry.length
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
        tally.note(entry.place, 0, "a chunk does not begin where the summary says it does")
    return True
