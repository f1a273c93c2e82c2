"""A ROS 1 bag (format 2.0): a file of records, mostly chunks of messages with their indexes behind them.

Source: ROS wiki, "Bags/Format/2.0". The reader goes through the records from first to last. It skips the content of
chunks by the indexes that follow them. Thus it also reads a bag that was not closed (.bag.active) or is cut off, but it
must decompress the last chunks.
"""

from __future__ import annotations

import bz2
import struct
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.bag.bag import BagLog, BagTopic
from xitl_cli.logs.formats.mcap.container import PayloadBatch, join_payloads
from xitl_cli.logs.formats.mcap.container import unpack as unpack_frames
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.file_bytes import FileReader
from xitl_cli.logs.model.log import Format

MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG_HEADER, _INDEX, _CHUNK, _CONNECTION = 2, 3, 4, 5, 7
_MOST_HEADER = 1 << 16
_MOST_DEFINITION = 16 << 20
_MOST_CHUNK = 1 << 30
_MOST_CONNECTIONS = 100_000
_KEPT_BYTES = 48 << 20
_U32 = struct.Struct("<I")
_TIME = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])

Fields = Mapping[bytes, bytes]


@dataclass(frozen=True, slots=True)
class BagRows:
    """Messages of a connection in a chunk."""

    stamp_ns: NDArray[np.int64]
    """(n,)"""
    offset: NDArray[np.int64]
    """(n,) positions of their records in the chunk."""


@dataclass(slots=True)
class BagChunk:
    """One chunk of a bag."""

    place: int
    """Offset of its data in the file."""
    size: int
    """Bytes of its data in the file."""
    compression: str
    unpacked_size: int
    unpacked_from: int
    """Offset of its data in the uncompressed file."""
    rows: dict[int, BagRows] = field(default_factory=dict)
    """Messages by connection."""
    indexed: bool = False
    """Whether `rows` is from the index behind the chunk."""


@dataclass(frozen=True, slots=True)
class BagConnection:
    """One publisher on a topic, as described in the bag."""

    topic: str
    type_name: str
    definition: str


class Ros1Bag(BagLog):
    """A ROS 1 bag. Raises LogError if the file cannot be read."""

    format: Format = "rosbag1"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._source = FileReader(path)
        self._size = self._source.size
        self._kept: OrderedDict[int, bytes] = OrderedDict()
        self._chunks: list[BagChunk] = []
        self._connections: dict[int, BagConnection] = {}
        try:
            self._open()
        except BaseException:
            self._source.close()
            raise

    def _open(self) -> None:
        self._closed = False
        self._walk()
        if not (self._chunks or self._connections or self._closed):
            raise LogError(f"{self.path}: is a ROS 1 bag without a readable record; record it again")
        unpacked_from = len(MAGIC)
        for chunk in self._chunks:
            chunk.unpacked_from = unpacked_from
            unpacked_from += chunk.unpacked_size
            if not chunk.indexed or not chunk.rows.keys() <= self._connections.keys():
                self._scan(chunk)
        groups: dict[BagConnection, list[int]] = {}
        for number, connection in self._connections.items():
            groups.setdefault(connection, []).append(number)
        ends = [rows.stamp_ns for chunk in self._chunks for rows in chunk.rows.values() if len(rows.stamp_ns)]
        stamps = np.concatenate(ends) if ends else np.empty(0, np.int64)
        topics = []
        for connection, ids in groups.items():
            rows = [chunk.rows[number] for chunk in self._chunks for number in ids if number in chunk.rows]
            count, read = sum(len(part.offset) for part in rows), partial(self._batches, ids)
            topics.append(BagTopic(connection.topic, connection.type_name, connection.definition, "ros1", count, read))
        self._settle(topics, (int(stamps.min()), int(stamps.max())) if len(stamps) else None)

    def _walk(self) -> None:
        """Read all records of the file without opening chunks."""
        at, end = len(MAGIC), self._source.size
        while at < end:
            record = self._record(at)
            if record is None:
                following = self._next_chunk(at + 1)
                if following is None:
                    self._losses.truncated_bytes += end - at
                    self._closed = False
                    return
                self._losses.note(at, following - at, "no record of a bag begins here")
                at = following
                continue
            fields, place, size = record
            kind = fields.get(b"op", b"\0")[0]
            if kind == _CHUNK:
                compression = fields.get(b"compression", b"").decode("ascii", "replace")
                unpacked_size = _whole(fields.get(b"size", b""))
                if compression not in ("none", "lz4", "bz2") or unpacked_size > _MOST_CHUNK:
                    why = (
                        f"compressed with {compression[:32]!r}" if unpacked_size <= _MOST_CHUNK else "larger than 1 GiB"
                    )
                    self._losses.note(place, size, f"a chunk is {why}, which is not supported")
                else:
                    self._chunks.append(BagChunk(place, size, compression, unpacked_size, 0))
            elif kind == _INDEX:
                # Add an index record to the chunk before it.
                data = self._source.read(place, size)
                if self._chunks and _whole(fields.get(b"ver", b"")) == 1 and b"conn" in fields:
                    entries = np.frombuffer(data[: len(data) - len(data) % _TIME.itemsize], dtype=_TIME)
                    entries = entries[np.argsort(entries["offset"], kind="stable")]
                    stamp_ns = entries["sec"].astype(np.int64) * 1_000_000_000 + entries["nsec"]
                    chunk = self._chunks[-1]
                    chunk.rows[_whole(fields[b"conn"])] = BagRows(stamp_ns, entries["offset"].astype(np.int64))
                    chunk.indexed = True
            elif kind == _CONNECTION and size <= _MOST_DEFINITION:
                self._add_connection(fields, self._source.read(place, size))
            elif kind == _BAG_HEADER:
                self._closed = b"index_pos" in fields and 0 < _whole(fields[b"index_pos"]) <= end
            at = place + size

    def _record(self, at: int) -> tuple[Fields, int, int] | None:
        """Fields of the record at `at`, offset and size of its data; None if there is no record. Only a chunk may be
        cut off."""
        length = self._source.read(at, 4)
        if len(length) < 4 or not 0 < (size := _U32.unpack(length)[0]) <= _MOST_HEADER:
            return None
        fields = parse_fields(self._source.read(at + 4, size), size)
        length = self._source.read(at + 4 + size, 4)
        if fields is None or len(fields.get(b"op", b"")) != 1 or len(length) < 4:
            return None
        place, data_size = at + 8 + size, _U32.unpack(length)[0]
        left = self._source.size - place
        if data_size > left:
            if fields[b"op"][0] != _CHUNK or not left:
                return None
            self._closed = False
            self._losses.truncated_bytes += left
            data_size = left
        return fields, place, data_size

    def _next_chunk(self, begin: int) -> int | None:
        """Find the next record of a chunk behind damage."""
        step = 1 << 20
        for low in range(begin, self._source.size, step):
            data = self._source.read(low, step + 64)
            field = data.find(b"compression=")
            while 0 <= field < step + 32:
                for before in (8, 16, 21, 29):  # its fields in any order
                    record = self._record(low + field - before) if low + field - before >= begin else None
                    if record is not None and record[0][b"op"][0] == _CHUNK:
                        return low + field - before
                field = data.find(b"compression=", field + 1)
        return None

    def _add_connection(self, fields: Fields, data: bytes) -> None:
        number, about = _whole(fields.get(b"conn", b"")), parse_fields(data, len(data))
        if about is None or number in self._connections or len(self._connections) >= _MOST_CONNECTIONS:
            return
        topic, kind, text = (
            source.get(key, b"").decode("utf-8", "replace")
            for source, key in ((fields, b"topic"), (about, b"type"), (about, b"message_definition"))
        )
        if topic:
            self._connections[number] = BagConnection(topic, kind, text)

    def _scan(self, chunk: BagChunk) -> None:
        """Find the messages of a chunk without its index."""
        data, at = self._unpacked(chunk), 0
        found_rows: dict[int, list[tuple[int, int]]] = {}
        while at + 8 <= len(data):
            size = _U32.unpack_from(data, at)[0]
            fields = parse_fields(data[at + 4 : at + 4 + size], size) if size <= _MOST_HEADER else None
            if fields is None or at + 8 + size > len(data):
                break
            place = at + 8 + size
            length = _U32.unpack_from(data, at + 4 + size)[0]
            if place + length > len(data):
                break
            kind = fields.get(b"op", b"\0")[:1]
            if kind == bytes([_CONNECTION]):
                self._add_connection(fields, data[place : place + length])
            elif kind == bytes([_MESSAGE]) and len(fields.get(b"time", b"")) == 8:
                sec, nsec = struct.unpack("<II", fields[b"time"])
                number = _whole(fields.get(b"conn", b""))
                found_rows.setdefault(number, []).append((sec * 1_000_000_000 + nsec, at))
            at = place + length
        chunk.rows = {}
        for number, rows in found_rows.items():
            table = np.array(rows, dtype=np.int64)
            chunk.rows[number] = BagRows(table[:, 0], table[:, 1])

    def _unpacked(self, chunk: BagChunk) -> bytes:
        if chunk.place in self._kept:
            self._kept.move_to_end(chunk.place)
            return self._kept[chunk.place]
        data, why = _unpack(self._source.read(chunk.place, chunk.size), chunk.compression, chunk.unpacked_size)
        if why and chunk.place + chunk.size < self._source.size:
            self._losses.note(chunk.place, 0 if data else chunk.size, why)
        self._kept[chunk.place] = data
        while len(self._kept) > 1 and sum(map(len, self._kept.values())) > _KEPT_BYTES:
            self._kept.popitem(last=False)
        return data

    def _batches(self, connections: list[int]) -> Iterator[PayloadBatch]:
        return join_payloads(piece for chunk in self._chunks for piece in self._pieces(chunk, connections))

    def _pieces(
        self, chunk: BagChunk, connections: list[int]
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], list[memoryview]]]:
        """Sizes, stamps, offsets and payloads. Incomplete messages are omitted."""
        rows = [chunk.rows[number] for number in connections if number in chunk.rows]
        if not rows:
            return
        offset = np.concatenate([some.offset for some in rows])
        order = np.argsort(offset, kind="stable")
        offset, stamp_ns = offset[order], np.concatenate([some.stamp_ns for some in rows])[order]
        data = self._unpacked(chunk)
        place, size, whole = payload_places(data, offset)
        if not whole.any():
            return
        view = memoryview(data)
        place, size = place[whole], size[whole]
        payloads = [view[at : at + length] for at, length in zip(place.tolist(), size.tolist(), strict=True)]
        yield size, stamp_ns[whole], chunk.unpacked_from + offset[whole], payloads

    @property
    def facts(self) -> Mapping[str, str]:
        packed = sorted({chunk.compression for chunk in self._chunks})
        return {"compression": ", ".join(packed), "chunks": str(len(self._chunks))} if packed else {}

    def close(self) -> None:
        self._source.close()


def parse_fields(data: bytes, size: int) -> Fields | None:
    """Fields of a record header, name and value. None unless they fill it."""
    fields, at = dict[bytes, bytes](), 0
    if len(data) != size:
        return None
    while at < size:
        length = _U32.unpack_from(data, at)[0] if at + 4 <= size else size
        name, equals, value = data[at + 4 : at + 4 + length].partition(b"=")
        if at + 4 + length > size or not equals:
            return None
        fields[name] = value
        at += 4 + length
    return fields


def payload_places(
    data: bytes, offset: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Offsets and sizes of the payloads of the message records at `offset` (n,), and which of them `data` contains
    fully."""
    if len(data) < 8:
        nothing = np.zeros(len(offset), dtype=np.int64)
        return nothing, nothing, nothing.astype(np.bool_)
    word = np.ndarray((len(data) - 3,), "<u4", data, strides=(1,))
    whole = offset <= len(data) - 8
    behind = np.where(whole, offset, 0) + 4 + word[np.where(whole, offset, 0)].astype(np.int64)
    whole &= behind <= len(data) - 4
    place = np.where(whole, behind, 0) + 4
    size = word[np.where(whole, behind, 0)].astype(np.int64)
    return place, size, whole & (place + size <= len(data))


def _unpack(data: bytes, compression: str, size: int) -> tuple[bytes, str]:
    """Decompress at most `size` bytes. Return them and the reason why some are missing ("" if none are)."""
    if compression != "bz2":
        return unpack_frames(data, "" if compression == "none" else compression, size)
    decompressor, parts, left = bz2.BZ2Decompressor(), list[bytes](), size
    try:
        for at in range(0, len(data), 1 << 16):
            parts.append(decompressor.decompress(data[at : at + (1 << 16)], max_length=left))
            left -= len(parts[-1])
            if left <= 0 or decompressor.eof:
                break
    except (OSError, EOFError):
        pass
    unpacked = b"".join(parts)
    return unpacked, "" if left <= 0 else f"a chunk of {size} bytes cannot be unpacked beyond {len(unpacked)}"


def _whole(value: bytes) -> int:
    """Number in a field, 0 if it is invalid."""
    return int.from_bytes(value, "little") if len(value) in (1, 4, 8) else 0


def refuse_other_version(path: Path, head: bytes) -> None:
    """Raise LogError for a bag of another version of the format."""
    if not head.startswith(MAGIC):
        version = head[8:13].decode("ascii", "replace").strip()
        raise LogError(f"{path}: is a ROS 1 bag of format {version}; rewrite it with `rosbag fix OLD.bag NEW.bag`")
