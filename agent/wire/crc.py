"""The MAVLink checksum, CRC-16/MCRF4XX, at the speed of the standard library's C code."""

from __future__ import annotations

from binascii import crc_hqx

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def checksum(data: bytes) -> bytes:
    """Return the checksum of all bytes, as the two bytes that end a frame."""
    reflected = crc_hqx(data.translate(_REVERSED), 0xFFFF)  # same result as x25crc, without the object
    return bytes((_REVERSED[reflected >> 8], _REVERSED[reflected & 0xFF]))


class x25crc:  # noqa: N801  the name the generated codec asks for
    """Running checksum over bytes, in `crc`.

    `binascii.crc_hqx` has the same polynomial (0x1021) with reversed bits. Reflecting each input byte and the 16-bit
    result converts one into the other.
    """

    def __init__(self, buf: bytes | bytearray | None = None) -> None:
        self._reflected = 0xFFFF
        if buf is not None:
            self.accumulate(buf)

    def accumulate(self, buf: bytes | bytearray) -> None:
        """Add bytes."""
        self._reflected = crc_hqx(buf.translate(_REVERSED), self._reflected)

    @property
    def crc(self) -> int:
        """Checksum of all bytes so far, 0 to 65535."""
        return _REVERSED[self._reflected >> 8] | _REVERSED[self._reflected & 0xFF] << 8
