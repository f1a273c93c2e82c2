"""The MAVLink checksum (X.25: CRC-16/MCRF4XX) of many frames at once."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

_POLYNOMIAL = 0x8408


def checksums(
    data: NDArray[np.uint8], start: NDArray[np.int64], length: NDArray[np.int64], extra: NDArray[np.uint8]
) -> NDArray[np.uint16]:
    """(N,) of `length` bytes of `data` from `start`, each followed by its byte `extra`.

    The work is done two bytes at a time over all frames, the longest first, so that those still going on are the front
    of an array. Every frame must lie in `data`.
    """
    order = np.argsort(-length, kind="stable")
    place, words, last = start[order], length[order] >> 1, (length[order] & 1).astype(np.bool_)
    table, one_byte = _tables()
    crc = np.full(len(order), 0xFFFF, dtype=np.uint16)
    if len(data) >= 2:
        pairs: NDArray[np.uint16] = np.ndarray((len(data) - 1,), "<u2", data, strides=(1,))  # at any byte, odd ones too
        going_on = len(order) - np.searchsorted(words[::-1], np.arange(int(words.max(initial=0))), side="right")
        for step, count in enumerate(going_on.tolist()):
            crc[:count] = table[crc[:count] ^ pairs[place[:count] + 2 * step]]
    crc[last] = _byte(one_byte, crc[last], data[(place + 2 * words)[last]])
    crc = _byte(one_byte, crc, extra[order])
    result: NDArray[np.uint16] = np.empty_like(crc)
    result[order] = crc
    return result


def _byte(table: NDArray[np.uint16], crc: NDArray[np.uint16], byte: NDArray[np.uint8]) -> NDArray[np.uint16]:
    after: NDArray[np.uint16] = (crc >> np.uint16(8)) ^ table[(crc ^ byte) & np.uint16(0xFF)]
    return after


@cache
def _tables() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """What two bytes (65536 entries) and what one byte (256) make of a checksum."""
    one = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        one = np.where(one & 1, (one >> 1) ^ _POLYNOMIAL, one >> 1).astype(np.uint16)
    every = np.arange(65536, dtype=np.uint16)
    first = (every >> np.uint16(8)) ^ one[every & 0xFF]
    return (first >> np.uint16(8)) ^ one[first & 0xFF], one
