"""The records inside a chunk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap import records
from xitl_cli.logs.formats.mcap.records import Channel, MalformedError, Schema

MESSAGE_OVERHEAD = records.MESSAGE_HEAD.size
_IN_CHUNKS = (records.SCHEMA, records.CHANNEL, records.MESSAGE)
_ROWS_AT_ONCE = 100_000
_LATEST_NS = np.uint64(2**63 - 1)
_HEAD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)


@dataclass(frozen=True, slots=True)
class Rows:
    """Messages of a chunk: channel, position of the payload, its size, log time; each (n,), in the chunk's order."""

    channel: NDArray[np.uint16]
    offset: NDArray[np.int64]
    size: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]

    def of(self, channel: int) -> Rows:
        mine = self.channel == channel
        return Rows(self.channel[mine], self.offset[mine], self.size[mine], self.stamp_ns[mine])


@dataclass(slots=True)
class Content:
    """All there is in a chunk. lost: offset and size of what is no record; cut: bytes of an unfinished last one."""

    rows: Rows
    schemas: list[Schema] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)
    lost: list[tuple[int, int]] = field(default_factory=list)
    cut: int = 0


Fits = Callable[[int, int], bool]
"""Whether a message of this channel and log time can be there."""


def stamps(times: NDArray[np.uint64]) -> NDArray[np.int64]:
    """Log times, the latest that 64 bits with a sign can hold for those beyond."""
    return np.minimum(times, _LATEST_NS).astype(np.int64)


def at_offsets(data: bytes, offsets: NDArray[np.int64]) -> tuple[Rows, NDArray[np.bool_]]:
    """The messages whose records begin at `offsets`, and which of them are messages at all."""
    last = len(data) - MESSAGE_OVERHEAD
    inside = (offsets >= 0) & (offsets <= last)
    if last < 0 or not len(offsets):
        none = np.zeros(len(offsets), dtype=np.int64)
        return Rows(none.astype(np.uint16), none, none, none), inside
    heads = np.ndarray((last + 1,), dtype=_HEAD, buffer=data, strides=(1,))[np.where(inside, offsets, 0)]
    length = heads["length"]
    room = (len(data) - 9 - offsets).clip(0).astype(np.uint64)
    whole = inside & (heads["opcode"] == records.MESSAGE) & (length >= 22) & (length <= room)
    size = np.where(whole, length - np.uint64(22), np.uint64(0)).astype(np.int64)
    return Rows(heads["channel"], offsets + MESSAGE_OVERHEAD, size, stamps(heads["log"])), whole


def by_index(data: bytes, offsets: NDArray[np.int64]) -> Content | None:
    """Everything in the chunk when its message indexes name all its messages; None when they do not."""
    offsets = np.unique(offsets)
    rows, whole = at_offsets(data, offsets)
    if not whole.all():
        return None
    ends = rows.offset + rows.size
    begins = np.append(offsets, len(data))
    free = np.append(0, ends)
    if np.any(free > begins):
        return None
    content = Content(rows)
    for gap in np.flatnonzero(free < begins).tolist():
        between = scan(data, int(free[gap]), int(begins[gap]), None)
        if len(between.rows.size) or between.lost or between.cut:
            return None
        content.schemas += between.schemas
        content.channels += between.channels
    return content


def scan(data: bytes, begin: int, end: int, fits: Fits | None, *, loose: bool = False) -> Content:
    """Record after record. fits: what a message must be like to go on with after damage; None: do not go on.

    loose: end at records that do not belong into a chunk.
    """
    found, blocks = list[tuple[int, int, int, int]](), list[NDArray[np.uint64]]()
    content = Content(_rows(blocks))
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
        elif opcode and stop <= end and (opcode in _IN_CHUNKS or not loose) and _readable(opcode, length):
            try:
                if opcode == records.SCHEMA:
                    content.schemas.append(records.schema(data[at + 9 : stop]))
                elif opcode == records.CHANNEL:
                    content.channels.append(records.channel(data[at + 9 : stop]))
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


def _readable(opcode: int, length: int) -> bool:
    return opcode != records.MESSAGE or length >= 22


def _rows(blocks: list[NDArray[np.uint64]]) -> Rows:
    table = np.concatenate(blocks) if blocks else np.zeros((0, 4), dtype=np.uint64)
    return Rows(
        table[:, 0].astype(np.uint16), table[:, 1].astype(np.int64), table[:, 2].astype(np.int64), stamps(table[:, 3])
    )


def _next_message(data: bytes, begin: int, end: int, fits: Fits) -> int | None:
    """Where the next message begins that is followed by another record, or by the end."""
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
