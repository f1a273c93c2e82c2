"""The chain of records of a ULog: a header of three bytes (size of the content and type), then the content.

A record ends at the beginning of the next, and there is no checksum. Rows (`D`) are recognised by the number of their
subscription and its length, all rows of a window of the file at once. The chain follows them, and every other record is
parsed on the way. If it breaks, it resumes at the next record that is followed by another.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.ulog.definitions import TYPES, MessageFormat, RowLayout, parse_format, row_layout
from xitl_cli.logs.model.log import Losses

# Contents of the records that are no rows: information, parameters, texts, subscriptions.

_KEY = re.compile(rb"([a-z][a-z0-9_]*(?:\[\d{1,5}\])?) (\S+)")
_TOPIC = re.compile(rb"[A-Za-z_]\w*")
_NO_TEXT = re.compile(rb"[\x00-\x06\x0e-\x1a\x1c-\x1f]")
SYNC = bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12))
INCOMPATIBLE_APPENDED = 1

Value = int | float | str | bytes


@dataclass(frozen=True, slots=True)
class Information:
    """A named value of an I, M, P or Q record."""

    key: str
    value: Value


@dataclass(frozen=True, slots=True)
class Subscription:
    """From this record on, rows with the number `msg_id` belong to instance `multi_id` of the message `name`."""

    multi_id: int
    msg_id: int
    name: str


@dataclass(frozen=True, slots=True)
class LoggedText:
    """A logged text."""

    level: int
    """MAVLink severity, 0 emergency to 7 debug."""
    tag: int | None
    """Source; None if there is none."""
    stamp_us: int
    text: str


@dataclass(frozen=True, slots=True)
class Flags:
    """Flags of the file."""

    compatible: bytes
    incompatible: bytes
    appended: tuple[int, ...]
    """Offsets of data that was appended after the end, for example by a crash handler."""

    @property
    def unknown(self) -> bool:
        """Whether a bit marks an incompatible version of the format."""
        return bool(self.incompatible[0] & ~INCOMPATIBLE_APPENDED) or any(self.incompatible[1:])


def parse_information(content: bytes) -> Information | None:
    """Parse an I or P record; None if the content is invalid."""
    if not content or len(content) < 1 + content[0]:
        return None
    match = _KEY.fullmatch(content[1 : 1 + content[0]])
    if match is None:
        return None
    type_name, key = match[1].decode(), match[2].decode("utf-8", "replace")
    stored = content[1 + content[0] :]
    if type_name.startswith("char["):
        return Information(key, decoded(stored))
    code = TYPES.get(type_name)
    if code is None:
        return Information(key, stored)
    dtype = np.dtype(code)
    return Information(key, np.frombuffer(stored, dtype)[0].item()) if len(stored) == dtype.itemsize else None


def parse_parameter(content: bytes) -> Information | None:
    parameter = parse_information(content)
    return parameter if parameter is not None and isinstance(parameter.value, int | float) else None


def parse_subscription(content: bytes) -> Subscription | None:
    if len(content) < 4 or not _TOPIC.fullmatch(content[3:]):
        return None
    return Subscription(content[0], int.from_bytes(content[1:3], "little"), content[3:].decode())


def parse_text(content: bytes, *, tagged: bool) -> LoggedText | None:
    head = 11 if tagged else 9
    if len(content) < head or not 0x30 <= content[0] <= 0x37 or _NO_TEXT.search(content[head:].rstrip(b"\0")):
        return None
    tag = int.from_bytes(content[1:3], "little") if tagged else None
    return LoggedText(
        content[0] - 0x30, tag, int.from_bytes(content[head - 8 : head], "little"), decoded(content[head:])
    )


def parse_flags(content: bytes) -> Flags | None:
    if len(content) < 40:
        return None
    offsets = (int.from_bytes(content[at : at + 8], "little") for at in (16, 24, 32))
    return Flags(content[:8], content[8:16], tuple(place for place in offsets if place))


def decoded(stored: bytes) -> str:
    """Text up to the zeros at its end, as UTF-8; invalid bytes are omitted."""
    return stored.decode("utf-8", "ignore").rstrip("\0")


# The chain of records.

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]

MAGIC = b"ULog\x01\x12\x35"
FILE_HEAD_BYTES = 16
HEAD_BYTES = 3
ROW_HEAD_BYTES = 5
"""Header of a record and number of the subscription."""

_ROW = ord("D")
_WINDOW = 1 << 20
_SEARCHED_BYTES = 1 << 15
_NUMBERS = 1 << 16
_NO_SIZE = _NUMBERS


@dataclass(frozen=True, slots=True)
class RowKind:
    """Rows of one subscription. layout: by the formats known at the beginning of the subscription."""

    subscription: Subscription
    layout: RowLayout


@dataclass(frozen=True, slots=True)
class Placed:
    """Parsed content of a record that is no row."""

    place: int
    """Offset in the file."""
    rows: int
    """Number of rows before it."""
    content: Any


@dataclass(slots=True)
class UlogRecords:
    """All records of a log."""

    place: Places
    """(N,) first byte of each row, in the order of the file."""
    kind: NDArray[np.int32]
    """(N,) index of each row in `kinds`."""
    kinds: list[RowKind]
    formats: dict[str, MessageFormat]
    start_us: int = 0
    version: int = 0
    flags: Flags | None = None
    information: list[Placed] = field(default_factory=list)
    """By record."""
    continued: list[tuple[bool, Information]] = field(default_factory=list)
    """With the first byte of the content, which gives the kind of the record."""
    parameters: list[Placed] = field(default_factory=list)
    """By record."""
    defaults: list[tuple[int, Information]] = field(default_factory=list)
    """With the first byte of the content, which gives the kind of the record."""
    texts: list[Placed] = field(default_factory=list)
    """By record."""
    dropouts: list[Placed] = field(default_factory=list)
    """By record."""
    unknown: dict[int, int] = field(default_factory=dict)
    """Rows of subscriptions without a description, by number."""
    foreign: dict[str, int] = field(default_factory=dict)
    redefined: int = 0
    others: int = 0
    losses: Losses = field(default_factory=Losses)


def read_records(data: Bytes) -> UlogRecords:
    """Find all records. Never raises on the content of the file; `losses` reports unreadable parts."""
    return _Chain(data).read()


@dataclass(frozen=True, slots=True)
class _Rows:
    """Rows that begin before byte `until`, even if the chain does not reach them."""

    place: Places
    """(n,) sorted; `number` and `end` have the same order."""
    number: NDArray[np.int64]
    end: Places
    last: NDArray[np.intp]
    """Indices of rows that are not directly followed by another."""
    until: int


class _Chain:
    def __init__(self, data: Bytes) -> None:
        self._data = data
        self._shortest = np.full(_NUMBERS, _NO_SIZE, np.int64)
        self._longest = np.full(_NUMBERS, -1, np.int64)
        self._kind_of = np.full(_NUMBERS, -1, np.int32)
        self._places: list[Places] = []
        self._kinds: list[NDArray[np.int32]] = []
        self._row_count = 0
        self._found = UlogRecords(np.empty(0, np.int64), np.empty(0, np.int32), [], {})
        self._window: _Rows | None = None
        self._in_data = False
        parsers: Mapping[str, tuple[Callable[[bytes], Any], Callable[[int, Any], None]]] = {
            "B": (parse_flags, self._on_flags),
            "F": (parse_format, self._on_format),
            "I": (parse_information, self._on_information),
            "M": (_parse_led(parse_information, (0, 1)), self._on_continued),
            "P": (parse_parameter, self._on_parameter),
            "Q": (_parse_led(parse_parameter, (1, 2, 3)), self._on_default),
            "A": (parse_subscription, self._on_subscription),
            "R": (lambda content: content if len(content) == 2 else None, lambda *_: None),
            "L": (partial(parse_text, tagged=False), self._on_text),
            "C": (partial(parse_text, tagged=True), self._on_text),
            "S": (lambda content: content if content == SYNC else None, lambda *_: None),
            "O": (lambda content: int.from_bytes(content, "little") if len(content) == 2 else None, self._on_dropout),
        }
        self._parsers = {ord(letter): parser for letter, parser in parsers.items()}

    def read(self) -> UlogRecords:
        found = self._found
        head = self._data[:FILE_HEAD_BYTES].tobytes().ljust(FILE_HEAD_BYTES, b"\0")
        found.version, found.start_us = head[7], int.from_bytes(head[8:16], "little")
        place = FILE_HEAD_BYTES
        first = self._parsed(place, len(self._data))
        if first is not None and self._data[place + 2] == ord("B"):
            place = first[0]
            self._on_flags(FILE_HEAD_BYTES, first[1])
            found.others += 1
        for end in self._section_ends(place):
            while place < end:
                after = self._take_rows(place, end)
                place = self._take_other(place, end) if after == place else after
        if self._places:
            found.place, found.kind = np.concatenate(self._places), np.concatenate(self._kinds)
        return found

    def _section_ends(self, begin: int) -> list[int]:
        flags, size = self._found.flags, len(self._data)
        if flags is None or not flags.incompatible[0] & INCOMPATIBLE_APPENDED:
            return [size]
        ends = list(flags.appended)
        if sorted(set(ends)) != ends or any(not begin < end <= size for end in ends):
            self._found.losses.note(FILE_HEAD_BYTES, 0, "its offsets of appended data are outside the file")
            return [size]
        return [*ends, size]

    def _take_rows(self, place: int, end: int) -> int:
        """Take consecutive rows from `place` on. Return the end of the last, or `place` if there is none."""
        if place + HEAD_BYTES > end or self._data[place + 2] != _ROW:
            return place
        window = self._window
        if window is None or place >= window.until:
            window = self._window = self._find_rows(place, end, min(place + _WINDOW, end))
        at = int(np.searchsorted(window.place, place))
        if at >= len(window.place) or window.place[at] != place:
            return place
        last = int(window.last[np.searchsorted(window.last, at)])
        rows = slice(at, last + 1)
        self._in_data = True
        self._places.append(window.place[rows])
        self._kinds.append(self._kind_of[window.number[rows]])
        self._row_count += last + 1 - at
        return int(window.end[last])

    def _find_rows(self, begin: int, end: int, until: int) -> _Rows:
        """Rows that begin between two places and end before `end`."""
        data = self._data
        place = begin + np.flatnonzero(data[begin + 2 : min(until + 2, end)] == _ROW)
        place = place[place + ROW_HEAD_BYTES <= end]
        number = data[place + 3].astype(np.int64) | data[place + 4].astype(np.int64) << 8
        size = data[place].astype(np.int64) | data[place + 1].astype(np.int64) << 8
        there = (size - 2 >= self._shortest[number]) & (size - 2 <= self._longest[number])
        there &= place + HEAD_BYTES + size <= end
        place, number, size = place[there], number[there], size[there]
        after = place + HEAD_BYTES + size
        broken = np.append(after[:-1] != place[1:], [True] if len(place) else [])
        return _Rows(place, number, after, np.flatnonzero(broken), until)

    def _take_other(self, place: int, end: int) -> int:
        """Take the record at `place`, or skip bytes that cannot be a record. Return the offset of the next."""
        parsed = self._parsed(place, end)
        if parsed is not None:
            after, content = parsed
            self._in_data |= self._data[place + 2] in b"ALC"
            self._parsers[int(self._data[place + 2])][1](place, content)
            self._found.others += 1
            return after
        behind = self._end_of(place, end)
        if behind is not None and self._is_head(behind, end):
            self._skip(place, behind)
            return behind
        if self._is_cut_off(place, end):
            self._found.losses.truncated_bytes += end - place
            return end
        after = self._resume(place + 1, end)
        self._found.losses.note(place, after - place, "no record begins here")
        return after

    def _end_of(self, place: int, end: int) -> int | None:
        """End of the record at `place` by its size; None if that is beyond `end`."""
        if place + HEAD_BYTES > end:
            return None
        size = int(self._data[place]) | int(self._data[place + 1]) << 8
        after = place + HEAD_BYTES + size
        return after if size and after <= end else None

    def _parsed(self, place: int, end: int) -> tuple[int, Any] | None:
        """End and content of a record that is no row; None if its type is another one or its content is wrong."""
        after = self._end_of(place, end)
        if after is None or (parser := self._parsers.get(int(self._data[place + 2]))) is None:
            return None
        content = parser[0](self._data[place + HEAD_BYTES : after].tobytes())
        return None if content is None else (after, content)

    def _is_row(self, place: int, end: int) -> bool:
        after = self._end_of(place, end)
        if after is None or self._data[place + 2] != _ROW or after - place < ROW_HEAD_BYTES:
            return False
        number, size = self._number(place), after - place - ROW_HEAD_BYTES
        return bool(self._shortest[number] <= size <= self._longest[number])

    def _number(self, place: int) -> int:
        return int(self._data[place + 3]) | int(self._data[place + 4]) << 8

    def _is_head(self, place: int, end: int) -> bool:
        """Whether a known record begins at `place`, or the data ends there."""
        return place == end or self._is_row(place, end) or self._parsed(place, end) is not None

    def _skip(self, place: int, after: int) -> None:
        """Count an unreadable record behind which the chain continues."""
        letter = int(self._data[place + 2])
        if letter == _ROW and after - place >= ROW_HEAD_BYTES and self._kind_of[self._number(place)] < 0:
            number = self._number(place)
            self._found.unknown[number] = self._found.unknown.get(number, 0) + 1
            self._found.others += 1
        elif chr(letter).isascii() and chr(letter).isalpha() and letter != _ROW and letter not in self._parsers:
            name = f"record type {chr(letter)!r}"
            self._found.foreign[name] = self._found.foreign.get(name, 0) + 1
            self._found.others += 1
        else:
            self._found.losses.note(place, after - place, "the content of this record is damaged")

    def _is_cut_off(self, place: int, end: int) -> bool:
        """Whether the record at `place` may have been incomplete when writing stopped."""
        if end - place < HEAD_BYTES:
            return True
        if self._end_of(place, end) is not None or not int(self._data[place]) | int(self._data[place + 1]) << 8:
            return False
        letter = int(self._data[place + 2])
        if letter != _ROW:
            return letter in self._parsers and self._resume(place + 1, end) >= end
        if end - place < ROW_HEAD_BYTES:
            return True
        number = self._number(place)
        size = (int(self._data[place]) | int(self._data[place + 1]) << 8) - 2
        return bool(self._shortest[number] <= size <= self._longest[number])

    def _resume(self, place: int, end: int) -> int:
        """Next offset from `place` with a record that is followed by another; else `end`."""
        while place < end:
            # Offsets with a known type and, for rows, a known number with its length.
            until = min(place + _SEARCHED_BYTES, end)
            letters = self._data[place + 2 : min(until + 2, end)]
            rows = self._find_rows(place, end, until).place
            others = place + np.flatnonzero(np.isin(letters, list(self._parsers)))
            for candidate in np.sort(np.concatenate((rows, others))).tolist():
                after = self._end_of(candidate, end)
                known = self._is_row(candidate, end) or self._parsed(candidate, end) is not None
                if known and after is not None and self._is_head(after, end):
                    return int(candidate)
            place = until
        return end

    def _on_flags(self, place: int, content: Flags) -> None:
        if self._found.flags is None and place == FILE_HEAD_BYTES:
            self._found.flags = content
            if content.unknown:
                self._found.losses.note(place, 0, "a flag says that this is a later version of the format")

    def _on_format(self, _: int, content: MessageFormat) -> None:
        known = self._found.formats.get(content.name)
        self._found.redefined += known is not None and known != content
        self._found.formats[content.name] = content

    def _on_information(self, place: int, content: Information) -> None:
        self._found.information.append(Placed(place, self._row_count, content))

    def _on_continued(self, _: int, content: tuple[int, Information]) -> None:
        self._found.continued.append((bool(content[0]), content[1]))

    def _on_parameter(self, place: int, content: Information) -> None:
        self._found.parameters.append(Placed(place, self._row_count if self._in_data else -1, content))

    def _on_default(self, _: int, content: tuple[int, Information]) -> None:
        self._found.defaults.append(content)

    def _on_text(self, place: int, content: LoggedText) -> None:
        self._found.texts.append(Placed(place, self._row_count, content))

    def _on_dropout(self, place: int, content: int) -> None:
        self._found.dropouts.append(Placed(place, self._row_count, content))

    def _on_subscription(self, _: int, content: Subscription) -> None:
        if len(self._found.kinds) >= _NUMBERS:
            return
        layout = row_layout(content.name, self._found.formats)
        self._kind_of[content.msg_id] = len(self._found.kinds)
        self._found.kinds.append(RowKind(content, layout))
        self._shortest[content.msg_id], self._longest[content.msg_id] = layout.shortest, layout.longest
        self._window = None


def _parse_led(
    parse: Callable[[bytes], Information | None], first: tuple[int, ...]
) -> Callable[[bytes], tuple[int, Information] | None]:
    """Parser of a content that follows one byte. The byte must be one of `first`."""

    def parsed(content: bytes) -> tuple[int, Information] | None:
        if not content or content[0] not in first:
            return None
        information = parse(content[1:])
        return None if information is None else (content[0], information)

    return parsed
