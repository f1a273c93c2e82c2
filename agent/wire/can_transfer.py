"""Chunks of bytes as CAN frames: segmentation, reassembly, and the duration of a frame. This module uses no bus.

A chunk of up to 510 bytes is one transfer: two bytes of length, little endian, then the chunk. It is split into parts
of 8 bytes (classic CAN) or 64 (CAN FD, with the last part padded to a valid length). Identifier, 29 bits, high first:

    priority 2 | tag 4 | sender 6 | destination 6 | transfer 5 | index 6

Priority 0 is for urgent messages, 2 for the others, so that bus arbitration prefers urgent ones. The tag marks frames
of this protocol. Transfers count up modulo 32 for each priority. The index is the number of the part, so the order on
the bus does not matter.

A chunk is reassembled correctly and once under two conditions. Frames are displaced by fewer than 16 transfers of their
priority. After an incomplete transfer, not all of 16 consecutive transfers within `OPEN_S` are lost completely. Beyond
that, the transfer number is ambiguous. A wrongly reassembled chunk then fails the checksum of its frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

CLASSIC_BYTES = 8
FD_BYTES = 64
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
HEADER_BYTES = 2  # of a transfer: its length


@dataclass(frozen=True)
class CanLine:
    """Bit rates of a bus."""

    bitrate: int
    fd: bool = False
    data_bitrate: int = 0
    """For the data of CAN FD frames."""

    @property
    def part_bytes(self) -> int:
        """Largest data size of a frame."""
        return FD_BYTES if self.fd else CLASSIC_BYTES

    @property
    def capacity_bps(self) -> float:
        """Bytes of data per second in full frames."""
        return self.part_bytes / self.frame_s(self.part_bytes)

    def frame_s(self, data_bytes: int) -> float:
        """Duration of one frame, in seconds."""
        if not self.fd:
            stuffed = 54 + 8 * data_bytes  # start of frame to checksum
            return (stuffed + (stuffed - 1) // 4 + 13) / self.bitrate
        arbitration = 36  # start of frame to bit rate switch
        data = 5 + 8 * padded(data_bytes)
        checksum = 4 + 17 + 6 if data_bytes <= 16 else 4 + 21 + 7  # stuff count, checksum, fixed stuff bits
        slow = arbitration + (arbitration - 1) // 4 + 13
        fast = data + (data + 3) // 4 + checksum
        return slow / self.bitrate + fast / (self.data_bitrate or self.bitrate)

    def transfer_s(self, chunk_bytes: int) -> float:
        """Duration of all frames of a chunk, in seconds."""
        whole, rest = divmod(HEADER_BYTES + chunk_bytes, self.part_bytes)
        return whole * self.frame_s(self.part_bytes) + (self.frame_s(rest) if rest else 0.0)


def padded(data_bytes: int) -> int:
    """Return the shortest valid CAN FD length for this number of bytes."""
    return next(length for length in FD_LENGTHS if length >= data_bytes)


LARGEST_CHUNK = 510
NODES = 64
TRANSFERS = 32
URGENT, NORMAL = 0, 2
MOST_OPEN = 8
OPEN_S = SILENCE_S = 2.0  # a busy machine may pause an end for less without losses
_TAG = 0xA
_WINDOW = TRANSFERS // 2


class CanFrame(NamedTuple):
    """Identifier (29 bits) and data."""

    identifier: int
    data: bytes


class Segmenter:
    """Splits the chunks of one sender for one destination."""

    def __init__(self, sender: int, destination: int, fd: bool) -> None:
        self._fixed = _TAG << 23 | sender << 17 | destination << 11
        self._part_bytes = FD_BYTES if fd else CLASSIC_BYTES
        self._fd = fd
        self._next = {URGENT: 0, NORMAL: 0}

    def cut(self, chunk: bytes, priority: int = NORMAL) -> list[CanFrame]:
        """Return the frames of the next transfer. Raises ValueError above 510 bytes."""
        if len(chunk) > LARGEST_CHUNK:
            raise ValueError(f"a chunk of {len(chunk)} bytes does not fit a CAN transfer; use at most {LARGEST_CHUNK}")
        transfer = self._next[priority]
        self._next[priority] = (transfer + 1) % TRANSFERS
        identifier = priority << 27 | self._fixed | transfer << 6
        data, size = len(chunk).to_bytes(HEADER_BYTES, "little") + chunk, self._part_bytes
        parts = [data[at : at + size] for at in range(0, len(data), size)]
        if self._fd:
            parts[-1] = parts[-1].ljust(padded(len(parts[-1])), b"\0")
        return [CanFrame(identifier | index, part) for index, part in enumerate(parts)]


class _Open:
    """A transfer with missing parts."""

    def __init__(self, fd: bool, since_s: float) -> None:
        self.fd = fd
        self.since_s = since_s
        self.parts: dict[int, bytes] = {}


class _Transfers:
    """State of the transfers of one priority."""

    def __init__(self) -> None:
        self.newest = 0
        self.heard_s: float | None = None
        self.open: dict[int, _Open] = {}
        self.done: dict[int, bytes] = {}


class Reassembler:
    """Reassembles the chunks from `sender` to `destination`. Memory is bounded: 8 open transfers per priority.

    incomplete: abandoned transfers with missing parts.
    malformed: transfers with inconsistent parts.
    repeated: repeated frames.
    foreign: frames of other nodes, for other nodes, or of another protocol.

    Own frames that a bus echoes are ignored.
    """

    def __init__(self, sender: int, destination: int) -> None:
        self._expected = _TAG << 12 | sender << 6 | destination
        self._own = _TAG << 12 | destination << 6 | sender
        self._priorities = {URGENT: _Transfers(), NORMAL: _Transfers()}
        self.incomplete = self.malformed = self.repeated = self.foreign = 0

    def add(self, identifier: int, data: bytes, fd: bool, now_s: float) -> bytes | None:
        """Return the chunk that this frame completes, if any. now_s: instant on any monotonic clock."""
        transfers = self._priorities.get(identifier >> 27)
        size = FD_BYTES if fd else CLASSIC_BYTES
        if transfers is None or identifier >> 11 & 0xFFFF != self._expected or not 0 < len(data) <= size:
            self.foreign += identifier >> 11 & 0xFFFF != self._own
            return None
        number, index = identifier >> 6 & TRANSFERS - 1, identifier & 0x3F
        # Drop transfers that are too old to belong to transfer `number`
        heard_s, transfers.heard_s = transfers.heard_s, now_s
        if heard_s is None or now_s - heard_s > SILENCE_S:
            self.incomplete += len(transfers.open)
            transfers.open.clear()
            transfers.done.clear()
            transfers.newest = number
        elif (transfers.newest - number) % TRANSFERS >= _WINDOW:
            self._restart_at(transfers, number)
        payload = transfers.done.get(number)
        if payload is not None:
            if payload[index * size : index * size + len(data)] == data:
                self.repeated += 1
                return None
            self._restart_at(transfers, number)  # the number is reused
        return self._store(transfers, number, index, data, fd, now_s)

    def _restart_at(self, transfers: _Transfers, number: int) -> None:
        transfers.newest = number
        transfers.done.pop(number, None)
        for old in [old for old in transfers.done if (number - old) % TRANSFERS >= _WINDOW]:
            del transfers.done[old]
        for old in [old for old in transfers.open if (number - old) % TRANSFERS >= _WINDOW]:
            self._abandon(transfers, old)

    def _abandon(self, transfers: _Transfers, number: int) -> None:
        del transfers.open[number]
        self.incomplete += 1

    def _store(
        self, transfers: _Transfers, number: int, index: int, data: bytes, fd: bool, now_s: float
    ) -> bytes | None:
        """Store a part of transfer `number`. Return the chunk that it completes, if any."""
        open_ = transfers.open.get(number)
        if open_ is not None:
            known = open_.parts.get(index)
            if known == data:
                self.repeated += 1
                return None
            if known is not None or open_.fd != fd or now_s - open_.since_s > OPEN_S:  # the number is reused
                self._abandon(transfers, number)
                open_ = None
        if open_ is None:
            if len(transfers.open) >= MOST_OPEN:
                self._abandon(transfers, next(iter(transfers.open)))
            open_ = transfers.open[number] = _Open(fd, now_s)
        open_.parts[index] = data
        return self._completed(transfers, number, open_)

    def _completed(self, transfers: _Transfers, number: int, open_: _Open) -> bytes | None:
        first = open_.parts.get(0)
        if first is None:
            return None
        size = FD_BYTES if open_.fd else CLASSIC_BYTES
        length = int.from_bytes(first[:HEADER_BYTES], "little")
        total = HEADER_BYTES + length
        count = -(-total // size)
        fits = len(first) >= HEADER_BYTES and length <= LARGEST_CHUNK and max(open_.parts) < count
        if fits and len(open_.parts) < count:
            return None
        del transfers.open[number]
        payload = b"".join(open_.parts[index] for index in sorted(open_.parts))
        last = open_.parts[max(open_.parts)]
        before_last = (count - 1) * size
        last_bytes = padded(total - before_last) if open_.fd else total - before_last
        if not fits or len(payload) != before_last + len(last) or len(last) != last_bytes:
            self.malformed += 1
            return None
        transfers.done[number] = payload
        return payload[HEADER_BYTES:total]
