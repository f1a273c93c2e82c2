"""How long a frame occupies a CAN bus, at worst.

Bits of a frame with a 29-bit identifier by ISO 11898-1:2015, with the interframe space; a stuff bit follows every four
bits at worst (the first one after five). For classic CAN this is 80 + 10 n bits for n data bytes (Davis, Burns, Bril,
Lukkien: Controller Area Network schedulability analysis, Real-Time Systems 35, 2007).
"""

from __future__ import annotations

from dataclasses import dataclass

CLASSIC_BYTES = 8
FD_BYTES = 64
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
HEADER_BYTES = 2  # of a transfer: its length


@dataclass(frozen=True)
class CanLine:
    """Bit rates of a bus; data_bitrate counts for the data of CAN FD frames."""

    bitrate: int
    fd: bool = False
    data_bitrate: int = 0

    @property
    def part_bytes(self) -> int:
        """The most data a frame carries."""
        return FD_BYTES if self.fd else CLASSIC_BYTES

    @property
    def capacity_bps(self) -> float:
        """Bytes of data per second in full frames."""
        return self.part_bytes / self.frame_s(self.part_bytes)

    def frame_s(self, data_bytes: int) -> float:
        """Time of one frame, in seconds."""
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
        """Time of all frames that carry a chunk."""
        whole, rest = divmod(HEADER_BYTES + chunk_bytes, self.part_bytes)
        return whole * self.frame_s(self.part_bytes) + (self.frame_s(rest) if rest else 0.0)


def padded(data_bytes: int) -> int:
    """The shortest length that a CAN FD frame can have for so many bytes."""
    return next(length for length in FD_LENGTHS if length >= data_bytes)
