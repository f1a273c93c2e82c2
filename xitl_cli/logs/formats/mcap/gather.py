"""The payloads of one topic, chunk by chunk, put together to batches that a decoder can take at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap.chunks import Chunks
from xitl_cli.logs.formats.mcap.content import MESSAGE_OVERHEAD
from xitl_cli.logs.formats.mcap.index import Chunk

BATCH_BYTES = 16 << 20


@dataclass(frozen=True, slots=True)
class Batch:
    """Payload i is data[start[i] : start[i] + size[i]]. place: of its record in the file, were nothing packed."""

    data: bytes
    start: NDArray[np.int64]
    size: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    place: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.start)

    def payload(self, row: int) -> bytes:
        begin = int(self.start[row])
        return self.data[begin : begin + int(self.size[row])]

    def rows(self, kept: NDArray[np.bool_]) -> Batch:
        """Some of them, the payloads where they are."""
        return Batch(self.data, self.start[kept], self.size[kept], self.stamp_ns[kept], self.place[kept])


def batches(chunks: Chunks, where: Sequence[Chunk], channels: Sequence[int]) -> Iterator[Batch]:
    """All messages of the channels in the order of the file; a batch ends behind BATCH_BYTES, at the end of a chunk."""
    payloads, sizes, stamps, places = list[bytes | memoryview](), list[_I64](), list[_I64](), list[_I64]()
    held = 0
    for chunk in where:
        for size, stamp_ns, place, data in _of_chunk(chunks, chunk, channels):
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


_I64 = NDArray[np.int64]


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


def _batch(payloads: Sequence[bytes | memoryview], sizes: list[_I64], stamps: list[_I64], places: list[_I64]) -> Batch:
    size = np.concatenate(sizes)
    return Batch(b"".join(payloads), np.cumsum(size) - size, size, np.concatenate(stamps), np.concatenate(places))
