"""The records of a DataFlash log: their descriptions, their places in the file, and the FMT of each row.

FMT gives letters and columns; FMTU, UNIT and MULT give units. Letters: ArduPilot's libraries/AP_Logger/LogStructure.h.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.model.log import Losses

HEAD_BYTES = 3
FMT_ID = 0x80
FMT_LENGTH = 89

_LETTERS = {
    **{"i1": "b", "u1": "BM", "<i2": "hc", "<u2": "HC", "<i4": "ieL", "<u4": "IE", "<i8": "q", "<u8": "Q"},
    **{"<f2": "g", "<f4": "f", "<f8": "d", "S4": "n", "S16": "N", "S64": "Z"},
}
_SHAPES: Mapping[str, tuple[str, int]] = {
    "a": ("<i2", 32),
    **{letter: (code, 1) for code, letters in _LETTERS.items() for letter in letters},
}
"""By letter: numpy's code of an item, and the number of items."""
_DIVISORS: Mapping[str, float] = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
TEXT = frozenset("nNZ")
WIDTHS: Mapping[str, int] = {letter: np.dtype(code).itemsize * count for letter, (code, count) in _SHAPES.items()}

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_NOT_IN_A_NAME = re.compile(r"[^A-Za-z0-9_]")
_PREFIXES = {1e-1: "d", 1e-2: "c", 1e-3: "m", 1e-6: "u", 1e-9: "n", 1e3: "k"}
_UNITS = {"deglatitude": "deg", "deglongitude": "deg", "degheading": "deg", "UNKNOWN": "", "instance": ""}


@dataclass(frozen=True, slots=True)
class RecordField:
    """One column of a record."""

    name: str
    letter: str
    """Empty if unknown."""
    at: int
    """Offset of its first byte in the record."""

    @property
    def dtype(self) -> np.dtype[np.void]:
        return np.dtype(_SHAPES[self.letter][0])

    @property
    def items(self) -> int:
        return _SHAPES[self.letter][1]

    @property
    def divisor(self) -> float | None:
        return _DIVISORS.get(self.letter)

    def conversion(self, measure: ColumnUnit, *, raw: bool) -> tuple[float, float]:
        """Divisor and multiplier of a stored number: the letter's divisor, else the factor of its measure.

        A tenth, a hundredth and so on become divisors, because the decimal number is the rounded result of the
        division.
        """
        if self.divisor is not None:
            return self.divisor, 1.0
        factor = 1.0 if raw else measure.factor
        inverse = round(1.0 / factor) if 1e-15 < abs(factor) < 1.0 else 0
        return (float(inverse), 1.0) if inverse and abs(factor * inverse - 1.0) < 1e-12 else (1.0, factor)


@dataclass(frozen=True, slots=True)
class RecordDefinition:
    """A type as described by one FMT record at byte `place`."""

    place: int
    type_id: int
    length: int
    """Length of a record with its header, as described; 0 if impossible."""
    name: str
    letters: str
    names: tuple[str, ...]
    fields: tuple[RecordField, ...]
    """Columns that can be read."""
    unread: tuple[str, ...] = ()
    """Columns that cannot be read."""
    why: str = ""
    """Reason why `unread` columns, or whole rows if there are no fields, cannot be read."""

    @property
    def letters_length(self) -> int | None:
        """Length of a record by its letters, with the header; None if a letter is unknown."""
        if any(letter not in WIDTHS for letter in self.letters):
            return None
        return HEAD_BYTES + sum(WIDTHS[letter] for letter in self.letters)

    def same_layout(self, other: RecordDefinition) -> bool:
        """Whether rows of both have the same layout."""
        mine, theirs = ((one.length, one.name, one.letters, one.names) for one in (self, other))
        return mine == theirs

    def with_type_id(self, type_id: int) -> RecordDefinition:
        """Copy with another type number, which was damaged."""
        return replace(self, type_id=type_id)

    def with_length(self, length: int) -> RecordDefinition:
        """Copy with another length, which was damaged."""
        return definition(self.place, self.type_id, length, self.name, self.letters, self.names)

    @property
    def begins_with_time(self) -> bool:
        """Whether microseconds in 8 bytes follow the header, as in every log since about 2015."""
        time = self.time
        return time is not None and (time[0].at, time[0].letter) == (HEAD_BYTES, "Q")

    @property
    def time(self) -> tuple[RecordField, int] | None:
        """Column of the time stamp, and its unit in nanoseconds."""
        for place, column in enumerate(self.fields):
            if column.name == "TimeUS" and column.letter in "QqIi":
                return column, 1_000
            old_gps = column.name == "T" and self.name in ("GPS", "GPS2")
            if column.letter in "QqIi" and (old_gps or (column.name == "TimeMS" and place == 0)):
                return column, 1_000_000
        return None


def definition(
    place: int, type_id: int, length: int, name: str, letters: str, names: tuple[str, ...]
) -> RecordDefinition:
    """Build a definition. Never raises; `why` gives the reason for unreadable columns."""
    fields, unread, why = _fields(length, letters, names)
    if not name:
        name = f"type {type_id}"
    return RecordDefinition(
        place, type_id, length if length >= HEAD_BYTES else 0, name, letters, names, fields, unread, why
    )


@lru_cache(4096)  # a damaged log needs the same ones again
def parse_fmt(payload: bytes, place: int) -> RecordDefinition:
    """Definition from the 86 bytes behind the header of an FMT record. Never raises."""
    type_id, length = payload[0], payload[1]
    name, columns = _cut(payload[2:6]), _cut(payload[22:86])
    letters = payload[6:22].partition(b"\0")[0].decode("latin-1")
    return definition(place, type_id, length, name, letters, tuple(columns.split(",")) if columns else ())


def _fields(length: int, letters: str, names: tuple[str, ...]) -> tuple[tuple[RecordField, ...], tuple[str, ...], str]:
    """Columns that can be read, names of the others, and the reason."""
    if length < HEAD_BYTES:
        return (), (), f"FMT gives it a length of {length} bytes, less than its head"
    if not letters:
        return (), (), "FMT gives it no columns"
    unknown = [place for place, letter in enumerate(letters) if letter not in WIDTHS]
    rest = length - HEAD_BYTES - sum(WIDTHS.get(letter, 0) for letter in letters)
    if len(letters) == len(names) + 1 and rest == -WIDTHS.get(letters[-1], 0):  # the byte that ends them is damaged
        letters, unknown, rest = letters[:-1], [place for place in unknown if place < len(names)], 0
    if names[:1] == ("TimeUS",) and letters[0] != "Q" and rest and rest + WIDTHS.get(letters[0], 0) == WIDTHS["Q"]:
        letters, unknown, rest = "Q" + letters[1:], [place for place in unknown if place], 0
    why = ""
    first, last = len(letters), len(letters) - 1
    if unknown:
        why = f"FMT gives it unknown letters: {letters!r}"
        first, last = unknown[0], unknown[-1]
    elif rest:
        why = f"FMT gives it {length} bytes and letters for {length - rest}"
        # Indices of letters that can be wrong if one letter is, and the correct one is `rest` bytes wider.
        widths = set(WIDTHS.values())
        doubtful = [place for place, letter in enumerate(letters) if WIDTHS[letter] + rest in widths]
        if doubtful[:1] == [0] and letters[0] == "Q" and names[:1] == ("TimeUS",):
            del doubtful[0]
        if doubtful:
            first, last = doubtful[0], doubtful[-1]
        else:
            first, last = 0, len(letters) - 1
    before = sum(WIDTHS[letter] for letter in letters[:first])
    after = sum(WIDTHS[letter] for letter in letters[last + 1 :])
    if HEAD_BYTES + before + after > length:
        return (), (), why
    fields, unread = [], []
    at = HEAD_BYTES
    for place, (name, letter) in enumerate(zip(_distinct(names, len(letters)), letters, strict=True)):
        if first <= place <= last:
            unread.append(name)
            at = length - after
        else:
            fields.append(RecordField(name, letter, at))
            at += WIDTHS[letter]
    return tuple(fields), tuple(unread) if fields else (), why


def _distinct(names: tuple[str, ...], count: int) -> list[str]:
    """A name for each letter. Missing, empty and duplicate names are replaced by names from their index."""
    if len(names) != count:
        parted = [part for name in names for part in _NOT_IN_A_NAME.split(name)]
        names = tuple(parted) if len(parted) == count else (names[0] if names else "", *[""] * (count - 1))
    distinct: list[str] = []
    for place, name in enumerate(names, start=1):
        if not name or name in distinct:
            name = f"{name}_{place}" if name else f"column_{place}"
        while name in distinct:
            name += "_"
        distinct.append(name)
    return distinct


def plausible_fmt(payload: bytes) -> bool:
    """Whether these 86 bytes are a plausible FMT record: text in text fields, letters that add up to the length."""
    described = parse_fmt(payload, 0)
    return (
        _NAME.fullmatch(described.name) is not None
        and bool(described.letters)
        and described.letters_length == described.length
        and len(described.names) == len(described.letters)
    )


def _cut(text: bytes) -> str:
    return text.partition(b"\0")[0].decode("utf-8", "backslashreplace")


@dataclass(frozen=True, slots=True)
class ColumnUnit:
    """Unit of a column."""

    unit: str = ""
    raw_unit: str = ""
    factor: float = 1.0
    """From the stored number, after the letter's conversion, to `unit`; 1: none."""
    instance: bool = False
    """Whether the column distinguishes instances."""


NOTHING = ColumnUnit()

Meaning = Callable[[RecordDefinition], Mapping[str, ColumnUnit]]
"""Measures of the columns of a type, by name."""


def measures(
    definition: RecordDefinition, units: str, multipliers: str, labels: Mapping[str, str], factors: Mapping[str, float]
) -> dict[str, ColumnUnit]:
    """Measures by column, from FMTU's characters. labels, factors: by character, from UNIT and MULT."""
    by_column = {}
    names = _distinct(definition.names, len(definition.letters))
    fields = {field.name: field for field in definition.fields}
    for place, name in enumerate(names):
        if name not in fields:
            continue
        character = units[place : place + 1]
        label = "" if character in ("", "-", "?", "#") else labels.get(character, "")
        # MULT holds single-precision numbers in double precision.
        multiplier = multipliers[place : place + 1]
        factor = 1.0 if multiplier in ("", "-", "?") else factors.get(multiplier, 1.0)
        factor = float(f"{factor:.7g}") if np.isfinite(factor) and factor != 0.0 else 1.0
        by_column[name] = _measure(fields[name], _UNITS.get(label, label), factor, character == "#")
    return by_column


def _measure(field: RecordField, unit: str, factor: float, instance: bool) -> ColumnUnit:
    if field.letter in TEXT or field.divisor is not None or factor == 1.0:
        return ColumnUnit(unit, unit, 1.0, instance)
    prefix = _PREFIXES.get(factor)
    raw_unit = "" if not unit else f"{prefix}{unit}" if prefix else f"{factor:g} {unit}"
    if unit == "s" and factor < 1.0 and prefix and field.letter not in "fdg":
        return ColumnUnit(raw_unit, raw_unit, 1.0, instance)
    return ColumnUnit(unit, raw_unit, factor, instance)


FMT = definition(0, FMT_ID, FMT_LENGTH, "FMT", "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))


# The records of a DataFlash log: from headers (A3 95) to a chain in which each record ends at the next header.
#
# A record in line begins at the end of the previous record; it is accepted. Elsewhere, a header is accepted if its
# record ends at another header or at the end of the file. Other records are kept, and counted as suspect, if their
# length fits and their time lies between the times of their neighbours. The remaining bytes are damage, and are
# skipped.

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
        # All but a few are in order: only a stable sort makes use of that.
        place = np.asarray(found[0], np.int64) if len(found) == 1 else np.sort(np.concatenate(found), kind="stable")
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
        sensible = []
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
            for head in (np.flatnonzero(likely) + at).tolist():
                if self._makes_sense(head, place, until, low_us, high_us):
                    sensible.append(head)
        return sensible

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
            for earlier in range(min(stop, head) - 1, max(start, stop - 64) - 1, -1):
                if self._types.timed[self._type_id[earlier]]:
                    return self._time_us(int(self._place[earlier]))
        return None

    def _time_from(self, head: int) -> int | None:
        """Time of the first timed record from this sound header on."""
        for later in range(head, min(head + 64, self._count)):
            if self._sound[later] and self._types.timed[self._type_id[later]]:
                return self._time_us(int(self._place[later]))
        return None


# Offsets of the records of a DataFlash log, and the assignment of FMT records to rows.
#
# A damaged byte of an FMT record must not lose the rows of its type, and a type may be described again. Therefore
# the content of an FMT record is checked against the positions of the headers of its rows.

_MOST_VERSIONS = 64
"""Different descriptions of one type; no log has as many."""
_MOST_CHANGES = 16_384
_SAMPLE = 512
"""Headers sampled to measure the length of the records of a type."""
_ASSUMED_FROM = 3
"""Number of rows from which the length of a type without FMT is accepted."""

Versions = dict[int, list[RecordDefinition]]


@dataclass(frozen=True, slots=True)
class DescribedTypes:
    """Types as described by a log."""

    versions: Versions
    """By type number. Each version holds from its place on; the first also holds before."""
    redefined: int
    """Number of descriptions that differ from the previous one."""
    assumed: Mapping[int, int]
    """Length of types without an FMT record."""

    def types(self) -> RecordTypes:
        length = np.zeros(256, np.uint8)
        timed = np.zeros(256, np.bool_)
        changes = []
        for type_id, assumed_length in self.assumed.items():
            length[type_id] = assumed_length
        for type_id, versions in self.versions.items():
            length[type_id] = versions[0].length
            timed[type_id] = all(version.begins_with_time for version in versions)
            changes += [(version.place, type_id, version.length) for version in versions[1:]]
        return RecordTypes(length, timed, tuple(sorted(changes)))


def likely_fmt(data: Bytes, heads: Heads, place: Places) -> Places:
    """Offsets of FMT records that end at a header, or have plausible content."""
    place = place[place + FMT_LENGTH <= len(data)]
    followed = heads.are_at(place + FMT_LENGTH, len(data))
    first = data[place + HEAD_BYTES + 2]
    for row in np.flatnonzero(~followed & (first >= ord("A")) & (first <= ord("Z"))).tolist():
        followed[row] = plausible_fmt(payload_at(data, int(place[row])))
    return place[followed]


def payload_at(data: Bytes, place: int) -> bytes:
    return data[place + HEAD_BYTES : place + FMT_LENGTH].tobytes()


def describe(
    data: Bytes, heads: Heads, fmt_places: Sequence[int], unknown: Sequence[tuple[int, int, int]] = ()
) -> DescribedTypes:
    """Types described by the FMT records at these offsets.

    unknown: header, type number and length of records in line without an FMT record.
    """
    settling = _DefinitionSearch(data, heads)
    settling.add(fmt_places)
    assumed = settling.assign_undescribed(unknown)
    versions = settling.versions
    return DescribedTypes(versions, settling.ignored + sum(len(some) - 1 for some in versions.values()), assumed)


class _DefinitionSearch:
    def __init__(self, data: Bytes, heads: Heads) -> None:
        self._data = data
        self._heads = heads
        self._heads_of: dict[int, Places] = {}
        self.versions: Versions = {FMT_ID: [FMT]}
        self._refused: list[RecordDefinition] = []
        self.ignored = 0

    def add(self, fmt_places: Sequence[int]) -> None:
        for place in self._changes(np.array(fmt_places, dtype=np.int64)):
            payload = payload_at(self._data, place)
            new = self._sized(parse_fmt(payload, place))
            if new.type_id == FMT_ID:
                if new.name != FMT.name:
                    self._refused.append(new)
                continue
            versions = self.versions.setdefault(new.type_id, [])
            if not versions:
                versions.append(new)
            elif not versions[-1].same_layout(new):
                if len(versions) < _MOST_VERSIONS and self._holds(versions[-1], new):
                    versions.append(new)
                else:
                    self._refused.append(new)

    def _changes(self, places: Places) -> list[int]:
        """FMT records without repetitions of the last description of a type."""
        if not len(places):
            return []
        rows = np.lib.stride_tricks.sliding_window_view(self._data, FMT_LENGTH)[places, HEAD_BYTES:]
        order = np.argsort(rows[:, 0], kind="stable")
        new = np.ones(len(places), np.bool_)
        new[order[1:]] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
        changes = np.flatnonzero(new)
        self.ignored = max(0, len(changes) - _MOST_CHANGES)
        return [int(place) for place in places[changes[:_MOST_CHANGES]]]

    def _sized(self, new: RecordDefinition) -> RecordDefinition:
        """The definition with the length from its letters, if the distance of rows agrees with it."""
        length = new.letters_length
        if length is None or length in (new.length, HEAD_BYTES) or length > 255:
            return new
        declared = self._fit(new.type_id, new.length) if new.length > HEAD_BYTES else 0.0
        return new.with_length(length) if self._fit(new.type_id, length) > declared else new

    def _holds(self, old: RecordDefinition, new: RecordDefinition) -> bool:
        """Whether a new description is valid: rows behind it have its length rather than the old length."""
        if new.length == old.length:
            return True
        return self._fit(new.type_id, new.length, new.place) >= self._fit(new.type_id, old.length, new.place)

    def _fit(self, type_id: int, length: int, start: int = 0) -> float:
        """Share of the type's headers, from an offset on, at which another header follows after `length` bytes."""
        if type_id not in self._heads_of:
            self._heads_of[type_id] = self._heads.place[self._heads.type_id == type_id]
        place = self._heads_of[type_id]
        place = place[np.searchsorted(place, start) :][:_SAMPLE]
        if not len(place):
            return 0.0
        return float(np.count_nonzero(self._heads.are_at(place + length, len(self._data)))) / len(place)

    def assign_undescribed(self, unknown: Sequence[tuple[int, int, int]]) -> dict[int, int]:
        """Find the description meant for each type that has none. Return the lengths of types that remain without."""
        lengths: dict[int, Counter[int]] = {}
        for _, type_id, length in unknown:
            lengths.setdefault(type_id, Counter())[length] += 1
        assumed = {}
        for type_id, counts in sorted(lengths.items()):
            length, times = counts.most_common(1)[0]
            if type_id in self.versions or length <= HEAD_BYTES or length > 255:
                continue
            meant = self._behind_another_head(type_id, length) or self._meant_for(type_id, length)
            if meant is not None:
                self.versions[type_id] = [meant.with_type_id(type_id)]
            elif times >= _ASSUMED_FROM:
                assumed[type_id] = length
        return assumed

    def _behind_another_head(self, type_id: int, length: int) -> RecordDefinition | None:
        """Find the FMT record of a type if the type number in its own header is damaged."""
        place = self._heads.place
        place = place[place + FMT_LENGTH <= len(self._data)]
        likely = place[(self._data[place + 3] == type_id) & (self._data[place + 4] == length)]
        for fmt_place in likely[:_SAMPLE].tolist():
            payload = payload_at(self._data, fmt_place)
            if plausible_fmt(payload):
                return parse_fmt(payload, fmt_place)
        return None

    def _meant_for(self, type_id: int, length: int) -> RecordDefinition | None:
        """Find the FMT record of a type if the described type number is damaged.

        Its apparent type then has another description, or no rows. None also if several records are possible.
        """
        # Number of columns in the FMTU record, by type.
        columns: dict[int, int] = {}
        for versions in self.versions.values():
            if versions[0].name == "FMTU":
                columns |= self._spoken_of(versions[0])
        several = [one for versions in self.versions.values() if len(versions) > 1 for one in versions]
        likely = [one for one in (*self._refused, *several) if one.length == length]
        if not likely:
            idle = [
                versions[0]
                for known, versions in self.versions.items()
                if versions[0].length == length and self._fit(known, length) == 0.0
            ]
            speaking = [one for one in idle if one.name == "FMTU" and self._speaks_of_types(one.with_type_id(type_id))]
            if speaking:
                likely = speaking
            elif columns:
                likely = [one for one in idle if one.type_id not in columns and type_id in columns]
            else:
                likely = idle
        likely = [one for one in likely if columns.get(type_id) in (None, len(one.letters))]
        if len(likely) != 1:
            return None
        meant = likely[0]
        if meant in self._refused:
            self._refused.remove(meant)
        else:
            versions = self.versions[meant.type_id]
            versions.remove(meant)
            if not versions:
                del self.versions[meant.type_id]
        return meant

    def _speaks_of_types(self, units: RecordDefinition) -> bool:
        """Whether rows of this FMTU description refer to described types."""
        spoken = self._spoken_of(units)
        return len(spoken) > 1 and sum(one in self.versions for one in spoken) > 0.8 * len(spoken)

    def _spoken_of(self, units: RecordDefinition) -> dict[int, int]:
        types, columns = (
            next((field for field in units.fields if (field.name, field.letter) == wanted), None)
            for wanted in (("FmtType", "B"), ("UnitIds", "N"))
        )
        if types is None or columns is None:
            return {}
        place = self._heads.place[self._heads.type_id == units.type_id]
        place = place[place + units.length <= len(self._data)]
        place = place[self._heads.are_at(place + units.length, len(self._data))][:_MOST_CHANGES]
        counts = np.count_nonzero(self._data[place[:, None] + columns.at + np.arange(16)], axis=1)
        return dict(zip(self._data[place + types.at].tolist(), counts.tolist(), strict=True))


def in_line_lengths(heads: Heads, unknown: NDArray[np.int64]) -> list[tuple[int, int, int]]:
    """Index, type number and distance to the next header, for each of these headers."""
    unknown = unknown[unknown + 1 < len(heads.place)]
    gaps = heads.place[unknown + 1] - heads.place[unknown]
    return list(zip(unknown.tolist(), heads.type_id[unknown].tolist(), gaps.tolist(), strict=True))


_PASSES = 4
"""Each level of damage in the description of types needs another pass."""


@dataclass(frozen=True, slots=True)
class RecordIndex:
    found: FoundRecords
    described: DescribedTypes


def index_records(data: Bytes, forget: Forget) -> RecordIndex:
    """Index a log with any content. forget: called with ranges that were read and are not needed soon."""
    heads = find_heads(data, forget)
    places = likely_fmt(data, heads, heads.place[heads.type_id == FMT_ID]).tolist()
    unknown: list[tuple[int, int, int]] = []
    described = describe(data, heads, places)
    found = chain(data, heads, described.types())
    for _ in range(_PASSES):
        records = found.place[found.type_id == FMT_ID]
        again = sorted({*likely_fmt(data, heads, records).tolist(), *found.repaired_fmt})
        more = [*dict.fromkeys([*unknown, *in_line_lengths(heads, np.array(found.unknown, dtype=np.int64))])]
        if again == places and len(more) == len(unknown):
            break
        places, unknown = again, more
        described = describe(data, heads, places, unknown)
        found = chain(data, heads, described.types())
    return RecordIndex(found, described)
