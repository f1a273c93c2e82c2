"""The picture of a radar's turn as a display shows it: bow up, grey levels, encoded as PNG (RFC 2083)."""

from __future__ import annotations

import math
import struct
import zlib

import numpy as np
from numpy import uint8
from numpy.typing import NDArray

from sim_core.sensors.radar import FIRST_ANGLE_RAD, MarineRadar

_FASTEST = 1  # speckle compresses badly anyway


class RadarPicture:
    """Pictures of size_px by size_px pixels. The vessel is in the middle, and the range is half of the size."""

    def __init__(self, radar: MarineRadar, size_px: int) -> None:
        self._size_px = size_px
        across = np.arange(size_px) + 0.5 - 0.5 * size_px
        right, ahead = across[None, :], -across[:, None]
        number = np.hypot(right, ahead) / (0.5 * size_px) * radar.spec.bins
        spoke = np.rint((np.arctan2(right, ahead) - FIRST_ANGLE_RAD) % math.tau / radar.step_rad)
        self._outside = number >= radar.spec.bins
        self._number = np.where(self._outside, 0, number).astype(np.intp)
        self._spoke = spoke.astype(np.intp) % radar.spec.spokes

    def png(self, intensity: NDArray[uint8]) -> bytes:
        """Return the file of a turn with intensities (spokes, bins)."""
        pixels = np.where(self._outside, uint8(0), intensity[self._spoke, self._number])
        rows = np.pad(pixels, ((0, 0), (1, 0)))  # filter 0 before each row
        header = struct.pack(">IIBBBBB", self._size_px, self._size_px, 8, 0, 0, 0, 0)
        data = zlib.compress(rows.astype(uint8).tobytes(), _FASTEST)
        return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
