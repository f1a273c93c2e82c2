"""The records of a DataFlash log: from headers (A3 95) to a chain in which each record ends at the next header.

A record in line begins at the end of the previous record; it is accepted. Elsewhere, a header is accepted if its record
ends at another header or at the end of the file. Other records are kept, and counted as suspect, if their length fits
and their time lies between the times of their neighbours. The remaining bytes are damage, and are skipped.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.dataflash.definitions import FMT_ID, FMT_LENGTH, HEAD_BYTES, plausible_fmt
from xitl_cli.logs.model.log import Losses

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]
Forget = Callable[[int, int], None]
"""Called with a range of bytes that was read and is not needed soon."""

_BLOCK = 512 << 10
"""Bytes compared at a time: intermediate arrays stay in the processor's cache."""
_ONE = np.uint64(1)


@dataclass(frozen=True, slots=True)
class Heads:
    """Possible headers of records."""

    place: Places
    """(H,) rising."""
    type_id: Bytes
    """(H,) the byte behind A3 95."""

    def are_at(self, places: Places, end: int) -> NDArray[np.bool_]:
        """Whether a header, or the end of the log, is at each of these offsets."""
        if not len(self.place):
            return np.asarray(places == end)
        at = np.minimum(np.searchsorted(self.place, places), len(self.place) - 1)
        return np.asarray((self.place[at] == places) | (places == end))


def find_heads(data: Bytes, forget: Forget) -> Heads:
    """All headers, including accidental ones within a payload.

    One thread: a second thread waits for the interpreter as often as it saves time.
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
        # Indices of True in a sparse mask, found eight at a time. Its length is a multiple of 8.
        eights = first.view("<u8")
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
        place = np.asarray(found[0], np.int64) if len(found) == 1 else np.sort(np.concatenate(found))
        place += at
        places.append(place)
        type_ids.append(data[place + 2])
        forget(at, at + _BLOCK)
    return Heads(np.concatenate(places), np.concatenate(type_ids))


def u64_at(data: Bytes, places: Places) -> NDArray[np.uint64]:
    """Little-endian uint64 at these offsets."""
    if not len(places):
        return np.empty(0, np.uint64)
    every = np.lib.stride_tricks.as_strided(data[: len(data) // 8 * 8].view("<u8"), (len(data) - 7,), (1,))
    return every[places]


_MOST_UNKNOWN = 100_000
_STEP = 1 << 16
"""Headers processed at a time."""
_REACH = 128
"""Maximum number of headers within the longest record."""
_FEW = 32
"""Number of headers up to which they are checked one by one instead of together."""
_NEAR_US = 5_000_000
"""Largest distance of the time of a doubtful record from the times of the accepted records around it."""


@dataclass(frozen=True, slots=True)
class RecordTypes:
    """Known properties of record types."""

    length: NDArray[np.uint8]
    """(256,), 0: no description."""
    timed: NDArray[np.bool_]
    """(256,) whether a record begins with its time in microseconds."""
    changes: tuple[tuple[int, int, int], ...] = ()
    """Changes of a length within the file: (place, type number, length), sorted by place."""

    def lengths_of(self, heads: Heads) -> NDArray[np.uint8]:
        lengths = self.length[heads.type_id]
        for type_id in {changed for _, changed, _ in self.changes}:
            mine = np.flatnonzero(heads.type_id == type_id)
            steps = [(place, length) for place, changed, length in self.changes if changed == type_id]
            since = np.searchsorted([place for place, _ in steps], heads.place[mine], side="right")
            lengths[mine] = np.array([self.length[type_id], *(length for _, length in steps)], np.uint8)[since]
        return lengths

    def length_at(self, place: int, type_id: int) -> int:
        length = int(self.length[type_id])
        for _, changed, changed_length in self.changes[: bisect_right(self.changes, (place, 256, 256))]:
            if changed == type_id:
                length = changed_length
        return length


@dataclass(slots=True)
class FoundRecords:
    """Records of a log."""

    place: Places
    """(R,) rising."""
    type_id: Bytes
    """(R,) in the order of `place`."""
    losses: Losses = field(default_factory=Losses)
    unknown: list[int] = field(default_factory=list)
    """Headers in line with types that have no description, at most 100 000."""
    repaired_fmt: list[int] = field(default_factory=list)
    """Offsets of FMT records with one damaged byte in the header."""


def chain(data: Bytes, heads: Heads, types: RecordTypes) -> FoundRecords:
    """Find the records of a log, in time proportional to its size."""
    return _RecordChain(data, heads, types).run()


class _RecordChain:
    def __init__(self, data: Bytes, heads: Heads, types: RecordTypes) -> None:
        self._data, self._size, self._types = data, len(data), types
        self._place, self._type_id = heads.place, heads.type_id
        self._count = len(heads.place)
        self._length = types.lengths_of(heads)
        # One byte per header: whether its record ends at the very next header, and whether at any. The
        # file's end counts as one.
        place, length, count = self._place, self._length, self._count
        linked, sound = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
        for at in range(0, count, _STEP):
            until = min(at + _STEP, count)
            end = place[at:until] + length[at:until]
            following = place[at + 1 : until + 1]
            if until == count:
                following = np.append(following, self._size)
            linked[at:until] = here = (end == following) & (length[at:until] != 0)
            rest = np.flatnonzero(~here & (length[at:until] != 0))
            target = np.searchsorted(place, end[rest])
            ends_at_head = place[np.minimum(target, count - 1)] == end[rest]
            here[rest] = ends_at_head | (end[rest] == self._size)
            sound[at:until] = here
        self._linked, self._sound = linked.tobytes(), sound.tobytes()
        self._spans: list[tuple[int, int]] = []
        self._repaired: list[tuple[int, int]] = []
        self._found = FoundRecords(heads.place, heads.type_id)

    def run(self) -> FoundRecords:
        count, sound = self._count, self._sound
        now = self._resume(0, 0) if not count or self._place[0] > 0 else 0
        while now < count:
            stop = self._linked.find(b"\0", now)
            stop = count if stop < 0 else stop
            self._keep(now, stop)
            now = stop
            if now == count:
                break
            if not sound[now]:
                now = self._past_damage(now)
                continue
            end = int(self._place[now]) + int(self._length[now])
            target = now + 1 + int(np.searchsorted(self._place[now + 1 : now + _REACH], end))
            inner = self._inner(now, target, end) if target > now + 1 else None
            if inner is None:
                self._keep(now, now + 1)
                now = target
            else:
                place, until = int(self._place[now]), int(self._place[inner])
                if not self._keep_fmt(place, until):
                    self._lose(place, until, "the type number of a record is damaged")
                now = inner
        found = self._found
        if self._spans != [(0, self._count)]:
            found.place, found.type_id = (
                np.concatenate([every[:0], *(every[start:stop] for start, stop in self._spans)])
                for every in (self._place, self._type_id)
            )
        if self._repaired:
            repaired = np.array(self._repaired, dtype=np.int64)
            where = np.searchsorted(found.place, repaired[:, 0])
            found.place = np.insert(found.place, where, repaired[:, 0])
            found.type_id = np.insert(found.type_id, where, repaired[:, 1].astype(np.uint8))
        return found

    def _keep(self, start: int, stop: int) -> None:
        if stop > start:
            if self._spans and self._spans[-1][1] == start:
                self._spans[-1] = (self._spans[-1][0], stop)
            else:
                self._spans.append((start, stop))

    def _lose(self, place: int, until: int, why: str) -> None:
        if until > place:
            self._found.losses.note(place, until - place, why)

    def _inner(self, outer: int, target: int, end: int) -> int | None:
        """First header within a record from which records lead to the end of that record, if its time confirms it.

        If there is one, the outer record is invalid: its type number is damaged, or bytes of it are missing. Without
        the check of the time, accidental headers would be too frequent: every 65536th byte of any payload looks like a
        header.
        """
        ends, inner = {end}, []
        for head in range(target - 1, outer, -1):
            length = int(self._length[head])
            if length and int(self._place[head]) + length in ends:
                ends.add(int(self._place[head]))
                inner.append(head)
        if not inner:
            return None
        low_us, high_us = self._near(outer, target)
        start = int(self._place[outer]) + HEAD_BYTES
        return next((head for head in reversed(inner) if self._makes_sense(head, start, end, low_us, high_us)), None)

    def _past_damage(self, head: int) -> int:
        """Continue behind a record in line that does not end at a header, and keep the record if it is possible."""
        place, length = int(self._place[head]), int(self._length[head])
        resumed, until = self._next_sound(head + 1)
        if self._type_id[head] != FMT_ID and self._keep_fmt(place, until):
            return self._resume(place + FMT_LENGTH, head + 1)
        if not length:
            if len(self._found.unknown) < _MOST_UNKNOWN:
                self._found.unknown.append(head)
            return self._resume(place, head + 1, "no FMT record describes its type")
        if place + length <= until:
            self._found.losses.suspect += 1
            self._keep(head, head + 1)
            return self._resume(place + length, head + 1)
        if until == self._size and not self._sensible(head + 1, resumed, place + HEAD_BYTES, until):
            self._found.losses.truncated_bytes += self._size - place
            return resumed
        return self._resume(place, head + 1, "a record is cut short")

    def _next_sound(self, head: int) -> tuple[int, int]:
        """First header from here with a record that ends at a header, and its offset; the end of the file if there is
        none."""
        sound = self._sound.find(b"\1", head)
        return (self._count, self._size) if sound < 0 else (sound, int(self._place[sound]))

    def _resume(self, place: int, head: int, why: str = "no record begins here") -> int:
        """Return the header at which to resume. Before it, keep plausible rows from `place` and `head` on; the rest is
        lost."""
        resumed, until = self._next_sound(head)
        sensible = self._sensible(head, resumed, place, until)
        place = self._past_damaged_head(place, until)
        for candidate in sensible:
            start = int(self._place[candidate])
            if start < place:
                continue
            self._lose(place, start, why)
            self._found.losses.suspect += 1
            self._keep(candidate, candidate + 1)
            place = self._past_damaged_head(start + int(self._length[candidate]), until)
            why = "no record begins here"
        self._lose(place, until, why)
        return resumed

    def _past_damaged_head(self, place: int, until: int) -> int:
        """Keep records in line that have one damaged byte in A3 95. Return the offset behind them."""
        while place + HEAD_BYTES < until:
            first, second, type_id = self._data[place : place + HEAD_BYTES].tolist()
            end = place + self._types.length_at(place, type_id)
            if (first == 0xA3) == (second == 0x95) or end == place or end > until:
                break
            if end < until and not self._is_head(end):
                break
            self._repair(place, type_id, "the head of a record is damaged")
            place = end
        return place

    def _repair(self, place: int, type_id: int, why: str) -> None:
        self._repaired.append((place, type_id))
        self._found.losses.suspect += 1
        self._found.losses.note(place, 0, why)
        if type_id == FMT_ID:
            self._found.repaired_fmt.append(place)

    def _keep_fmt(self, place: int, until: int) -> bool:
        """Keep an FMT record in line if its own type number is damaged, because all records of a type depend on it."""
        end = place + FMT_LENGTH
        if end > until or (end != until and not self._is_head(end)):
            return False
        if not plausible_fmt(self._data[place + HEAD_BYTES : end].tobytes()):
            return False
        self._repair(place, FMT_ID, "the type number of a record is damaged")
        return True

    def _is_head(self, place: int) -> bool:
        at = int(np.searchsorted(self._place, place))
        return at < self._count and int(self._place[at]) == place

    def _sensible(self, start: int, stop: int, place: int, until: int) -> list[int]:
        """Headers from `start` to before `stop` with records that lie between two offsets and are plausible there."""
        if stop <= start:
            return []
        low_us, high_us = self._near(start, stop)
        if stop - start <= _FEW:
            return [head for head in range(start, stop) if self._makes_sense(head, place, until, low_us, high_us)]
        found = []
        for at in range(start, stop, _STEP):
            places, lengths = self._place[at : min(at + _STEP, stop)], self._length[at : min(at + _STEP, stop)]
            type_ids = self._type_id[at : min(at + _STEP, stop)]
            fits = (lengths > 0) & (places >= place) & (places + lengths <= until)
            likely = fits & self._types.timed[type_ids]
            timed = np.flatnonzero(likely & (lengths >= HEAD_BYTES + 8))
            time_us = u64_at(self._data, places[timed] + HEAD_BYTES)
            likely[timed] = (time_us >= low_us) & (time_us <= high_us)
            named = np.flatnonzero(fits & (type_ids == FMT_ID))
            first = self._data[places[named] + HEAD_BYTES + 2]
            likely[named] = (first >= ord("A")) & (first <= ord("Z"))
            for one in (np.flatnonzero(likely) + at).tolist():
                if self._makes_sense(one, place, until, low_us, high_us):
                    found.append(one)
        return found

    def _makes_sense(self, head: int, place: int, until: int, low_us: int, high_us: int) -> bool:
        start, length, type_id = int(self._place[head]), int(self._length[head]), int(self._type_id[head])
        if not length or start < place or start + length > until:
            return False
        if self._types.timed[type_id] and length >= HEAD_BYTES + 8:
            return low_us <= self._time_us(start) <= high_us
        return type_id == FMT_ID and plausible_fmt(self._data[start + HEAD_BYTES : start + FMT_LENGTH].tobytes())

    def _time_us(self, place: int) -> int:
        return int.from_bytes(self._data[place + HEAD_BYTES : place + HEAD_BYTES + 8].tobytes(), "little")

    def _near(self, start: int, stop: int) -> tuple[int, int]:
        """Possible times of a record between two headers; an empty range if no time around it is known."""
        before, after = self._time_before(start), self._time_from(stop)
        known = [time_us for time_us in (before, after) if time_us is not None]
        return (min(known) - _NEAR_US, max(known) + _NEAR_US) if known else (1, 0)

    def _time_before(self, head: int) -> int | None:
        """Time of the last timed record that was kept before this header."""
        for start, stop in reversed(self._spans[-64:]):
            for kept in range(min(stop, head) - 1, max(start, stop - 64) - 1, -1):
                if self._types.timed[self._type_id[kept]]:
                    return self._time_us(int(self._place[kept]))
        return None

    def _time_from(self, head: int) -> int | None:
        """Time of the first timed record from this sound header on."""
        for later in range(head, min(head + 64, self._count)):
            if self._sound[later] and self._types.timed[self._type_id[later]]:
                return self._time_us(int(self._place[later]))
        return None
