"""A telemetry log (.tlog) as MAVProxy, Mission Planner and QGroundControl write it.

A record is 8 bytes (µs since 1970, big-endian) and a MAVLink frame. Only the length of the frame locates the next
record. The log is therefore read in blocks. In each block, all bytes that could begin a frame are parsed together, the
records are chained, and their checksums are computed together. In a damaged block, every possible frame is checked.
Reading resumes at the next valid frame that is followed by another or has a stamp near the last. Time and memory are
proportional to the log's size.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.tlog.frames import (
    LONGEST_FRAME,
    MAGIC_1,
    MAGIC_2,
    SIGNED,
    UNKNOWN,
    FrameHeaders,
    intact,
    parse_headers,
    tables_by_message,
)
from xitl_cli.logs.model.file_bytes import FileBytes
from xitl_cli.logs.model.log import Base, Format, Log, LogHealth, Losses
from xitl_cli.logs.model.table import Table, steps_back

BLOCK_BYTES = 1 << 20
STAMP_BYTES = 8
_NEAR_US = 3 * 86_400 * 1_000_000
_UNKNOWN_IN_A_ROW = 4
_DOUBLINGS = 5
_LEAVES, _BREAKS = -2, -1


@dataclass(frozen=True, slots=True)
class FrameIndex:
    """(N,) frames with correct checksums, in the order of the file."""

    start: NDArray[np.int64]
    """Offset of the frame."""
    kind: NDArray[np.int16]
    stamp_us: NDArray[np.uint64]
    """As stored; 0 if `stamped` is False."""
    stamped: NDArray[np.bool_]
    """False if damage before the frame destroyed its stamp."""
    signed: int
    unknown: dict[int, int]
    """Number of frames with a plausible length and an unknown message, by message number."""
    losses: Losses


def index_frames(data: NDArray[np.uint8]) -> FrameIndex:
    """Index the frames of `data`; never raises."""
    walk = _Walk(data)
    for low in range(0, len(data), BLOCK_BYTES):
        walk.block(low, min(low + BLOCK_BYTES, len(data)))
    return walk.result()


@dataclass
class _Block:
    """All bytes between `low` and `high` that could begin a frame."""

    low: int
    high: int
    frames: FrameHeaders
    place_of: NDArray[np.int32]
    following: NDArray[np.int32]
    """Index of the frame that would follow each."""

    def at(self, start: int) -> int:
        """Index of the frame that begins at `start`, or _BREAKS, or _LEAVES behind the block."""
        if start >= self.high:
            return _LEAVES
        return int(self.place_of[start - self.low]) if start >= self.low else _BREAKS


@dataclass
class _Walk:
    """State of reading a log."""

    data: NDArray[np.uint8]
    expected: int = 0
    """Offset at which the next record should begin."""
    gap: int | None = None
    """Begin of unreadable bytes, None outside damage."""
    stamp_us: int | None = None
    starts: list[NDArray[np.int64]] = field(default_factory=list)
    kinds: list[NDArray[np.int16]] = field(default_factory=list)
    stampless: list[int] = field(default_factory=list)
    unknown: dict[int, int] = field(default_factory=dict)
    signed: int = 0
    losses: Losses = field(default_factory=Losses)

    def block(self, low: int, high: int) -> None:
        could = np.flatnonzero((self.data[low:high] - np.uint8(MAGIC_2)) < np.uint8(2)) + low
        third = self.data[np.minimum(could + 2, len(self.data) - 1)]
        could = could[(self.data[could] == MAGIC_1) | (third <= SIGNED)]  # in MAVLink 2 they are flags
        frames = parse_headers(self.data, could)
        place_of = np.full(high - low, _BREAKS, dtype=np.int32)
        place_of[could - low] = np.arange(len(could), dtype=np.int32)
        after = could + frames.size + STAMP_BYTES
        inside = after < high
        following = np.full(len(could), _LEAVES, dtype=np.int32)
        following[inside] = place_of[after[inside] - low]
        following[~frames.readable] = _BREAKS
        block = _Block(low, high, frames, place_of, following)
        if not len(block.frames.start):
            if self.expected + STAMP_BYTES < high:
                self.gap = self.expected if self.gap is None else self.gap
                self.expected = high
            return
        if self.gap is None and self._chained(block):
            return
        self._searched(block)

    def result(self) -> FrameIndex:
        start = np.concatenate([*self.starts, np.zeros(0, np.int64)])
        kind = np.concatenate([*self.kinds, np.zeros(0, np.int16)])
        self._tail()
        stamped = ~np.isin(start, np.array(self.stampless, dtype=np.int64))
        stamp_us = np.zeros(len(start), dtype=np.uint64)
        stamp_us[stamped] = self._stamps(start[stamped])
        return FrameIndex(start, kind, stamp_us, stamped, self.signed, dict(sorted(self.unknown.items())), self.losses)

    def _stamps(self, start: NDArray[np.int64]) -> NDArray[np.uint64]:
        if not len(start):
            return np.zeros(0, dtype=np.uint64)
        anywhere: NDArray[np.uint64] = np.ndarray((len(self.data) - STAMP_BYTES + 1,), ">u8", self.data, strides=(1,))
        return anywhere[start - STAMP_BYTES].astype(np.uint64)

    def _chained(self, block: _Block) -> bool:
        """Add the frames of the block one after the other. If any is doubtful, add none and return False."""
        # `first` and all frames that follow, until they leave the block; None if the chain breaks. The
        # chain is followed in strides of 2^_DOUBLINGS, which are then filled in.
        first = block.at(self.expected + STAMP_BYTES)
        count = len(block.following)
        leaves, breaks = count, count + 1
        step = np.concatenate([block.following, np.array([leaves, breaks], dtype=np.int32)]).astype(np.intp)
        step[step == _LEAVES], step[step == _BREAKS] = leaves, breaks
        steps = [step]
        for _ in range(_DOUBLINGS):
            steps.append(steps[-1][steps[-1]])
        stride = steps.pop().tolist()
        one = {_LEAVES: leaves, _BREAKS: breaks}.get(first, first)
        strides = []
        while one < count:
            strides.append(one)
            one = stride[one]
        if one == breaks:
            taken = None
        else:
            chain = np.array(strides, dtype=np.intp)
            for step in reversed(steps):
                chain = np.stack([chain, step[chain]], axis=1).ravel()
            taken = chain[chain < count]
        if taken is None:
            return False
        frames = block.frames.select(taken)
        unknown = frames.readable & (frames.kind == UNKNOWN)
        if not bool(np.all(unknown | intact(self.data, frames))):
            return False
        self._take(frames, unknown)
        return True

    def _searched(self, block: _Block) -> None:
        good = intact(self.data, block.frames)
        unknown = block.frames.readable & (block.frames.kind == UNKNOWN)
        after = block.following
        goes_on, next_frame = after >= 0, np.maximum(after, 0)
        followed = (after == _LEAVES) | (goes_on & good[next_frame])
        for _ in range(_UNKNOWN_IN_A_ROW):
            followed |= goes_on & unknown[next_frame] & followed[next_frame]
        readable = block.frames.readable.tolist()
        sure = np.flatnonzero(good & (followed | self._near(block)))
        sure_starts = block.frames.start[sure].tolist()
        is_good, is_unknown, is_followed = good.tolist(), unknown.tolist(), followed.tolist()
        starts, sizes, following = block.frames.start.tolist(), block.frames.size.tolist(), after.tolist()
        taken: list[int] = []
        while True:
            one = block.at(self.expected + STAMP_BYTES)
            if one == _LEAVES:
                break
            if self.gap is not None or one == _BREAKS or not (is_good[one] or (is_followed[one] and readable[one])):
                # Next frame that can be trusted; notes the gap before it. _LEAVES if the block has
                # none.
                gap = self.expected if self.gap is None else self.gap
                found = bisect_left(sure_starts, max(self.expected, block.low))
                if found == len(sure_starts):
                    self.gap = gap
                    self.expected = max(self.expected, block.high)
                    one = _LEAVES
                else:
                    start = sure_starts[found]
                    if start - STAMP_BYTES < gap:
                        self.stampless.append(start)
                        self.losses.note(gap, start - gap, "its time stamp is cut short")
                    else:
                        self.losses.note(gap, start - STAMP_BYTES - gap, "no valid frame begins here")
                    self.gap = None
                    one = int(sure[found])
                if one == _LEAVES:
                    break
            elif not (is_good[one] or is_unknown[one]):
                self.losses.note(self.expected, STAMP_BYTES + sizes[one], "the checksum of its frame is wrong")
                self.expected = starts[one] + sizes[one]
                continue
            taken.append(one)
            self.expected = starts[one] + sizes[one]
            if following[one] == _LEAVES:
                break
        frames = block.frames.select(np.array(taken, dtype=np.intp))
        self._take(frames, unknown[np.array(taken, dtype=np.intp)])

    def _near(self, block: _Block) -> NDArray[np.bool_]:
        """Whether the possible stamp before each frame is within days of the last valid stamp."""
        if self.stamp_us is None:
            return np.zeros(len(block.frames.start), dtype=np.bool_)
        near = block.frames.start >= STAMP_BYTES
        stamps = self._stamps(block.frames.start[near])
        earliest, latest = max(self.stamp_us - _NEAR_US, 0), self.stamp_us + _NEAR_US
        near[near] = (stamps >= np.uint64(earliest)) & (stamps <= np.uint64(latest))
        return near

    def _take(self, frames: FrameHeaders, unknown: NDArray[np.bool_]) -> None:
        if not len(frames.start):
            return
        for number in frames.number[unknown].tolist():
            self.unknown[number] = self.unknown.get(number, 0) + 1
        known = np.flatnonzero(~unknown)
        self.starts.append(frames.start[known])
        self.kinds.append(frames.kind[known])
        self.signed += int(frames.signed.sum())
        self.expected = int(frames.start[-1] + frames.size[-1])
        if len(known) and int(frames.start[known[-1]]) >= STAMP_BYTES:
            stamp_us = int(self._stamps(frames.start[known[-1:]])[0])
            self.stamp_us = min(stamp_us, 2**62)

    def _tail(self) -> None:
        """Count a last record that was cut off. Other remaining bytes are damage."""
        begin = self.expected if self.gap is None else self.gap
        left = len(self.data) - begin
        if left <= 0:
            return
        if left < STAMP_BYTES + LONGEST_FRAME and _could_go_on(self.data[begin:]):
            self.losses.truncated_bytes = left
        else:
            self.losses.note(begin, left, "no valid frame begins here")


def _could_go_on(tail: NDArray[np.uint8]) -> bool:
    """Whether these bytes can begin a record."""
    if len(tail) <= STAMP_BYTES + 2:
        return len(tail) <= STAMP_BYTES or int(tail[STAMP_BYTES]) in (MAGIC_1, MAGIC_2)
    frames = parse_headers(tail, np.array([STAMP_BYTES]))
    return int(tail[STAMP_BYTES]) in (MAGIC_1, MAGIC_2) and int(frames.size[0]) > len(tail) - STAMP_BYTES


_FIRST_YEAR_US, _LAST_YEAR_US = 978_307_200_000_000, 4_102_444_800_000_000  # 2001 and 2100
_LISTED_UNKNOWN = 3
_DAY_US, _MINUTE_US = 86_400_000_000, 60_000_000
_LARGEST_US = 9_223_372_036_854_775


class TelemetryLog(Log):
    """Frames by message, stamped by the ground station that received them.

    A stamp that is far from its neighbours, or that damage destroyed, is replaced by the previous stamp. base is "utc",
    or "unknown" if the stamps are not from this century.
    """

    format: Format = "tlog"

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = path = Path(path)
        self._bytes = FileBytes(path)
        data = self._bytes.data
        self._found = found = index_frames(data)
        stamp_us, replaced = _trusted(found)
        self._stamp_ns = stamp_us * 1000
        self._tables: Mapping[str, Table] = tables_by_message(
            "", data, found.start, found.kind, self._stamp_ns, found.start
        )
        # Unknown messages: the most frequent by number, the others summed, because damage can produce any
        # number once.
        ordered = sorted(found.unknown.items(), key=lambda item: -item[1])
        listed, others = ordered[:_LISTED_UNKNOWN], ordered[_LISTED_UNKNOWN:]
        reasons = {f"message {number}": (count, "no known dialect has it") for number, count in listed}
        if others:
            reasons["further messages"] = (
                sum(count for _, count in others),
                f"{len(others)} other numbers that no known dialect has",
            )
        self._health = found.losses.health(
            len(data),
            len(found.start) + sum(found.unknown.values()),
            back_in_time=sum(steps_back(table.stamp_ns) for table in self._tables.values()),
            replaced_stamps=replaced,
            undecoded=reasons,
        )

    @cached_property
    def base(self) -> Base:
        stamp_us = self._stamp_ns // 1000
        in_this_century = len(stamp_us) > 0 and _FIRST_YEAR_US <= float(np.median(stamp_us)) <= _LAST_YEAR_US
        return "utc" if in_this_century else "unknown"

    @property
    def tables(self) -> Mapping[str, Table]:
        return self._tables

    @cached_property
    def span_ns(self) -> tuple[int, int] | None:
        return (int(self._stamp_ns.min()), int(self._stamp_ns.max())) if len(self._stamp_ns) else None

    @property
    def health(self) -> LogHealth:
        return self._health

    @property
    def facts(self) -> Mapping[str, str]:
        return {"signed frames": str(self._found.signed)} if self._found.signed else {}

    def close(self) -> None:
        """Close the log. Tables keep the bytes as long as they exist."""
        self._tables = {}
        self._bytes.close()


def _trusted(found: FrameIndex) -> tuple[NDArray[np.int64], int]:
    """Stamps (N,) in µs, and the number of replaced stamps."""
    doubted = ~found.stamped | (found.stamp_us > _LARGEST_US)
    stamps = np.where(doubted, 0, found.stamp_us).astype(np.int64)
    known = np.flatnonzero(~doubted)
    doubted[known[_strange(stamps[known])]] = True
    if not doubted.any():
        return stamps, 0
    trusted = np.flatnonzero(~doubted)
    if not len(trusted):
        return np.zeros_like(stamps), len(stamps)
    last = np.maximum(np.searchsorted(trusted, np.arange(len(stamps)), side="right") - 1, 0)
    return stamps[trusted[last]], int(doubted.sum())


def _strange(stamp_us: NDArray[np.int64]) -> NDArray[np.intp]:
    """Rows with a stamp a day from the median of the five around them, or a minute away and out of order.

    A clock that is set once causes no such row, and neither do long silences.
    """
    steps = np.diff(stamp_us)
    jumps = np.flatnonzero(np.abs(steps) > _MINUTE_US)
    if not len(jumps) or len(stamp_us) < 5:
        return np.zeros(0, dtype=np.intp)
    doubtful = np.unique(jumps[:, None] + np.arange(-1, 3))
    doubtful = doubtful[(doubtful >= 0) & (doubtful < len(stamp_us))]
    around = np.clip(doubtful, 2, len(stamp_us) - 3)[:, None] + np.arange(-2, 3)
    away = np.abs(stamp_us[doubtful] - np.sort(stamp_us[around], axis=1)[:, 2])
    back = np.concatenate([[False], steps < 0, [False]])
    out_of_order = back[doubtful] | back[doubtful + 1]
    strange: NDArray[np.intp] = doubtful[(away > _DAY_US) | (out_of_order & (away > _MINUTE_US))]
    return strange
