"""Every place of a log where a record could begin: A3 95, and room for a type number behind it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]
Forget = Callable[[int, int], None]
"""Told from where to where the bytes of a log were read and are not needed at once."""

_BLOCK = 512 << 10
"""Bytes compared at a time: what is made of them stays in the processor's cache."""
_ONE = np.uint64(1)


@dataclass(frozen=True, slots=True)
class Heads:
    """place: (H,) rising. type_id: (H,) the byte behind A3 95."""

    place: Places
    type_id: Bytes

    def are_at(self, places: Places, end: int) -> NDArray[np.bool_]:
        """Whether a head is at each of these places, or the log's end."""
        if not len(self.place):
            return np.asarray(places == end)
        at = np.minimum(np.searchsorted(self.place, places), len(self.place) - 1)
        return np.asarray((self.place[at] == places) | (places == end))


def find_heads(data: Bytes, forget: Forget) -> Heads:
    """All of them, also those that stand in a payload by chance.

    One thread: a second one waits for the interpreter as often as it saves time.
    """
    last = max(len(data) - 2, 0)
    first, second = np.empty(_BLOCK, np.bool_), np.empty(_BLOCK, np.bool_)
    places, type_ids = [np.empty(0, np.int64)], [np.empty(0, np.uint8)]
    for at in range(0, last, _BLOCK):
        count = min(_BLOCK, last - at)
        a, b = first[:count], second[:count]
        np.equal(data[at : at + count], 0xA3, out=a)
        np.equal(data[at + 1 : at + 1 + count], 0x95, out=b)
        np.logical_and(a, b, out=a)
        first[count:] = False
        place = _true(first)
        place += at
        places.append(place)
        type_ids.append(data[place + 2])
        forget(at, at + _BLOCK)
    return Heads(np.concatenate(places), np.concatenate(type_ids))


def _true(mask: NDArray[np.bool_]) -> Places:
    """Where a mask of few is true, eight at a time: its length is a multiple of 8."""
    eights = mask.view("<u8")
    groups = np.flatnonzero(eights != 0)
    bits = eights[groups]
    below = bits - _ONE
    rest = bits & below
    found = [(groups << 3) + (np.bitwise_count(below & ~bits) >> 3)]
    while rest.any():
        several = np.flatnonzero(rest)
        groups, bits = groups[several], rest[several]
        below = bits - _ONE
        rest = bits & below
        found.append((groups << 3) + (np.bitwise_count(below & ~bits) >> 3))
    return np.asarray(found[0], np.int64) if len(found) == 1 else np.sort(np.concatenate(found))


def u64_at(data: Bytes, places: Places) -> NDArray[np.uint64]:
    """Little-endian numbers of 8 bytes that begin at these places."""
    if not len(places):
        return np.empty(0, np.uint64)
    every = np.lib.stride_tricks.as_strided(data[: len(data) // 8 * 8].view("<u8"), (len(data) - 7,), (1,))
    return every[places]
