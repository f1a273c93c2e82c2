"""What chunks hold: unpacked, checked and kept for a while."""

from __future__ import annotations

import struct
import zlib
from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap import content, records
from xitl_cli.logs.formats.mcap.content import Content, Rows
from xitl_cli.logs.formats.mcap.index import Chunk, Index, Tally
from xitl_cli.logs.formats.mcap.records import MalformedError
from xitl_cli.logs.formats.mcap.source import Source
from xitl_cli.logs.formats.mcap.unpack import unpack

_KEPT_BYTES = 48 << 20
_KEPT_ROWS = 4_000_000
_FEW_BYTES = 4096


class Chunks:
    """Reads chunks of `index`; what it finds damaged goes to `tally`, once."""

    def __init__(self, source: Source, index: Index, tally: Tally) -> None:
        self._source = source
        self._index = index
        self._tally = tally
        self._kept: OrderedDict[int, bytes] = OrderedDict()
        self._kept_bytes = 0
        self._kept_rows = 0
        self._scanned_places: set[int] = set()
        self._sound: dict[int, bool] = {}

    def unpacked(self, chunk: Chunk) -> bytes:
        """The records in a chunk; what can be had of them when it is damaged."""
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
                self._tally.note(chunk.place, 0 if data else chunk.size, why)
        self._keep(chunk, data)
        return data

    def content(self, chunk: Chunk, offsets: NDArray[np.int64] | None) -> Content:
        """Everything in a chunk, looked for with the help of `offsets`, where its message indexes say messages are."""
        data = self.unpacked(chunk)
        if offsets is not None and self._sound.get(chunk.place, True):
            found = content.by_index(data, offsets)
            if found is not None:
                return found
        found = self._scanned(chunk, data)
        if self._kept_rows + len(found.rows.size) <= _KEPT_ROWS:
            self._kept_rows += len(found.rows.size)
            chunk.rows = found.rows
        chunk.index_places = b""
        return found

    def rows(self, chunk: Chunk, channel: int) -> Rows | None:
        """The messages of one channel in a chunk, positions in `unpacked`; None when it certainly has none."""
        if chunk.refused or (chunk.holds is not None and channel not in chunk.holds):
            return None
        if chunk.rows is None and chunk.index_places:
            places = chunk.index()
            if channel not in places:
                return None
            offsets = self._offsets(chunk, channel, places)
            data = self.unpacked(chunk)
            if offsets is not None and self._sound.get(chunk.place, True):
                rows, whole = content.at_offsets(data, offsets)
                if whole.all() and (rows.channel == channel).all():
                    return rows
                self._tally.note(chunk.place, 0, "a message index names places where no such message is")
        rows = self.content(chunk, None).rows if chunk.rows is None else chunk.rows
        return rows.of(channel)

    def lone_payloads(self, chunk: Chunk, channel: int) -> tuple[Rows, list[bytes]] | None:
        """Messages of a channel read one by one, when that saves reading most of a chunk; None otherwise."""
        if chunk.compression or chunk.loose or chunk.rows is not None or chunk.place in self._kept or chunk.headless:
            return None
        places = chunk.index()
        offsets = self._offsets(chunk, channel, places) if channel in places else None
        if offsets is None or chunk.refused or len(offsets) * 2 * _FEW_BYTES > chunk.data_size:
            return None
        sizes, stamps, payloads = list[int](), list[int](), list[bytes]()
        for offset in offsets.tolist():
            room = chunk.data_size - offset
            record = self._source.read(chunk.data_place + offset, min(_FEW_BYTES, room)) if 0 <= offset < room else b""
            if len(record) < content.MESSAGE_OVERHEAD:
                return None
            opcode, length, number, _, stamp_ns, _ = records.MESSAGE_HEAD.unpack_from(record)
            if opcode != records.MESSAGE or number != channel or not 22 <= length <= room - 9:
                return None
            if 9 + length > len(record):
                record += self._source.read(chunk.data_place + offset + len(record), 9 + length - len(record))
            payload = record[content.MESSAGE_OVERHEAD : 9 + length]
            sizes.append(len(payload))
            stamps.append(min(stamp_ns, 2**63 - 1))
            payloads.append(payload)
        rows = Rows(
            np.full(len(sizes), channel, dtype=np.uint16),
            offsets + content.MESSAGE_OVERHEAD,
            np.array(sizes, dtype=np.int64),
            np.array(stamps, dtype=np.int64),
        )
        return rows, payloads

    def _scanned(self, chunk: Chunk, data: bytes) -> Content:
        if chunk.loose:
            known = self._index.channels
            found = content.scan(data, 0, len(data), lambda channel, _: channel in known)
        else:
            found = content.scan(data, 0, len(data), lambda _, stamp_ns: chunk.start_ns <= stamp_ns <= chunk.end_ns)
        if chunk.place not in self._scanned_places:
            self._scanned_places.add(chunk.place)
            for offset, lost in found.lost:
                self._tally.note(chunk.unpacked_from + offset, lost, "no record begins here inside a chunk")
            if found.cut and not chunk.cut:
                self._tally.note(chunk.place, found.cut, "the last record of a chunk is cut off")
            if not self._sound.get(chunk.place, True) and not chunk.cut:
                self._tally.suspect += len(found.rows.size)
        return found

    def _offsets(self, chunk: Chunk, channel: int, places: dict[int, int]) -> NDArray[np.int64] | None:
        begin = places[channel]
        end = min((place for place in places.values() if place > begin), default=chunk.place + chunk.size)
        if begin < chunk.data_place + chunk.data_size or end > chunk.place + chunk.size:
            return None
        return message_index(self._source.read(begin, end - begin), channel)

    def _checksum_holds(self, chunk: Chunk, before: bytes, data: bytes) -> bool:
        try:
            crc = records.chunk_head(before, chunk.data_place - chunk.place - 9 + chunk.data_size).crc
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
    """Offsets in the order of the chunk; None when this is no index of the channel."""
    if len(record) < 15:
        return None
    opcode, length, number, size = struct.unpack_from("<BQHI", record)
    if (
        opcode != records.MESSAGE_INDEX
        or number != channel
        or length != 6 + size
        or size % 16
        or 15 + size > len(record)
    ):
        return None
    pairs = np.frombuffer(record, dtype="<u8", offset=15, count=size // 8).reshape(-1, 2)
    return np.unique(content.stamps(pairs[:, 1]))
