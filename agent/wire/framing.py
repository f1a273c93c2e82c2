"""Finds MAVLink frames in bytes. All other bytes are skipped and counted, and never raise.

Frame: 0xFD, payload length, incompatibility flags, compatibility flags, sequence, system, component, message id (3
bytes, little endian), payload, checksum (2 bytes). With incompatibility flag 1, 13 bytes of signature follow
(mavlink.io, "Packet Serialization"). MAVLink 1: 0xFE, payload length, sequence, system, component, message id (one
byte), payload, checksum.
"""

from __future__ import annotations

from dataclasses import dataclass

from agent.wire import dialect
from agent.wire.crc import checksum

MAGIC, MAGIC_1 = 0xFD, 0xFE
HEADER_BYTES, HEADER_1_BYTES = 10, 6
CHECKSUM_BYTES = 2
SIGNATURE_BYTES = 13
LARGEST_FRAME = HEADER_BYTES + 255 + CHECKSUM_BYTES + SIGNATURE_BYTES
SIGNED = 0x01
FROM_MAVLINK_1 = 0x80  # a compatibility flag, which receivers may ignore: a Framer sets it

_MAGIC_BYTE, _MAGIC_1_BYTE = bytes([MAGIC]), bytes([MAGIC_1])
_CRC_EXTRA: dict[int, bytes] = {number: bytes([kind.crc_extra]) for number, kind in dialect.mavlink_map.items()}


@dataclass(frozen=True)
class FramingCounters:
    """Classification of the received bytes.

    bytes_in = bytes_good + bytes_dropped + bytes of an unfinished frame that is still held (streams only).

    The dropped_ fields count events, not bytes. All bytes within the claimed length of a damaged frame belong to its
    event.
    """

    bytes_in: int = 0
    bytes_good: int = 0
    bytes_dropped: int = 0
    dropped_bad_crc: int = 0
    dropped_unknown: int = 0
    dropped_truncated: int = 0
    dropped_noise: int = 0

    @property
    def dropped(self) -> int:
        """Sum of all events."""
        return self.dropped_bad_crc + self.dropped_unknown + self.dropped_truncated + self.dropped_noise


def is_known(frame: bytes) -> bool:
    """Whether the dialect contains this message."""
    return frame[7] | frame[8] << 8 | frame[9] << 16 in _CRC_EXTRA


def is_mavlink1(frame: bytes) -> bool:
    """Whether a frame from a Framer arrived as MAVLink 1."""
    return bool(frame[3] & FROM_MAVLINK_1)


class Framer:
    """Finds the frames of the XITL dialect in chunks of bytes.

    stream=False: every chunk is a datagram of complete frames. A frame that is cut off at its end is dropped as
      truncated.
    stream=True: a frame may continue in the next chunk. At most `LARGEST_FRAME` bytes are held. In a stream, a damaged
      frame may claim to be long. A frame after it is then returned when the claimed bytes have arrived.

    - A wrong checksum, or a damaged length that causes one: dropped_bad_crc. The search continues at the next 0xFD,
      also inside the damaged frame, so garbage never hides a good frame.
    - An id that the dialect lacks, or an incompatibility flag other than "signed": dropped_unknown. The checksum cannot
      be verified, or the protocol forbids a guess.
    - With `mavlink1`, MAVLink 1 frames count too. Each is returned as the MAVLink 2 frame of its message, see
      `is_mavlink1`. Without it, they are bytes outside any frame, because XITL ids do not fit them.
    - Bytes outside any frame: dropped_noise, one event per run.
    - With `foreign`, the other end has messages that the dialect lacks. Their checksum cannot be verified. So such a
      frame is returned if it ends with the chunk or another frame begins after it.
    - Signed frames are accepted by their checksum. The raw frame contains the signature, which is not verified here.
    """

    def __init__(self, stream: bool, foreign: bool = False, mavlink1: bool = False) -> None:
        self._stream = stream
        self._foreign = foreign
        self._mavlink1 = mavlink1
        self._held = b""
        self._claimed = 0  # bytes before the held ones that a damaged frame claimed
        self._in_noise = False
        self._in = self._good = self._dropped = 0
        self._bad_crc = self._unknown = self._truncated = self._noise = 0

    @property
    def held_bytes(self) -> int:
        """Number of bytes of an unfinished frame."""
        return len(self._held)

    @property
    def counters(self) -> FramingCounters:
        """Counts so far."""
        return FramingCounters(
            self._in, self._good, self._dropped, self._bad_crc, self._unknown, self._truncated, self._noise
        )

    def reset_counters(self) -> None:
        """Reset the counts. An unfinished frame is kept and counts as new bytes."""
        self._in, self._good, self._dropped = len(self._held), 0, 0
        self._bad_crc = self._unknown = self._truncated = self._noise = 0

    def feed(self, chunk: bytes) -> list[bytes]:
        """Return the good frames that end in this chunk, in order."""
        self._in += len(chunk)
        data = self._held + chunk if self._held else chunk
        size = len(data)
        frames: list[bytes] = []
        at, good = 0, 0
        claimed_end = self._claimed
        while at < size:
            first = data[at]
            if first != MAGIC and (first != MAGIC_1 or not self._mavlink1):
                start = at
                at = self._next_magic(data, at)
                if at > claimed_end and not self._in_noise:
                    self._noise += 1
                    self._in_noise = True
                self._dropped += at - start
                continue
            header = HEADER_BYTES if first == MAGIC else HEADER_1_BYTES
            if size - at < header:
                if self._stream:
                    break
                self._truncated += at >= claimed_end
                claimed_end = size
            else:
                if first == MAGIC:
                    flags = data[at + 2]
                    extra = _CRC_EXTRA.get(data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16)
                else:
                    flags, extra = 0, _CRC_EXTRA.get(data[at + 5])
                payload_end = at + header + data[at + 1]
                end = payload_end + (CHECKSUM_BYTES + SIGNATURE_BYTES if flags & SIGNED else CHECKSUM_BYTES)
                if extra is None and self._foreign and first == MAGIC and not flags & ~SIGNED:
                    if end > size and self._stream:
                        break
                    if end == size or (end < size and data[end] == MAGIC):
                        frames.append(data[at:end])
                        good += end - at
                        at = claimed_end = end
                        self._in_noise = False
                        continue
                    self._unknown += at >= claimed_end
                elif extra is None or flags & ~SIGNED:
                    self._unknown += at >= claimed_end
                elif end > size:
                    if self._stream:
                        break
                    self._truncated += at >= claimed_end
                elif checksum(data[at + 1 : payload_end] + extra) == data[payload_end : payload_end + CHECKSUM_BYTES]:
                    frames.append(data[at:end] if first == MAGIC else _as_mavlink2(data[at:end]))
                    good += end - at
                    at = claimed_end = end
                    self._in_noise = False
                    continue
                else:
                    self._bad_crc += at >= claimed_end
                if at >= claimed_end:
                    claimed_end = end
            self._in_noise = False
            self._dropped += 1
            at += 1
        self._good += good
        if self._stream:
            self._held = data[at:]
            self._claimed = max(0, claimed_end - at)
        else:
            self._in_noise = False
        return frames

    def _next_magic(self, data: bytes, at: int) -> int:
        """Return the next possible start of a frame, the end of the data for none."""
        starts = [data.find(_MAGIC_BYTE, at)]
        if self._mavlink1:
            starts.append(data.find(_MAGIC_1_BYTE, at))
        return min([start for start in starts if start >= 0], default=len(data))


def _as_mavlink2(frame: bytes) -> bytes:
    """Return the MAVLink 2 frame of the same message, with its original checksum."""
    length, sequence, system, component, number = frame[1:HEADER_1_BYTES]
    head = (MAGIC, length, 0, FROM_MAVLINK_1, sequence, system, component, number, 0, 0)
    return bytes(head) + frame[HEADER_1_BYTES:]


def as_received(frame: bytes) -> bytes:
    """Return a frame from a Framer in its original bytes."""
    if not is_mavlink1(frame):
        return frame
    return bytes((MAGIC_1, frame[1], *frame[4:8])) + frame[HEADER_BYTES:]
