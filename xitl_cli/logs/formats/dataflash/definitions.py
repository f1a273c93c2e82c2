"""Description of records in a DataFlash log: FMT gives letters and columns; FMTU, UNIT and MULT give units.

Letters: ArduPilot's libraries/AP_Logger/LogStructure.h.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

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

    def conversion(self, measure: Measure, *, raw: bool) -> tuple[float, float]:
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
        for place, field in enumerate(self.fields):
            if field.name == "TimeUS" and field.letter in "QqIi":
                return field, 1_000
            old_gps = field.name == "T" and self.name in ("GPS", "GPS2")
            if field.letter in "QqIi" and (old_gps or (field.name == "TimeMS" and place == 0)):
                return field, 1_000_000
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
        why = f"FMT gives it letters that are not known: {letters!r}"
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
    found: list[str] = []
    for place, name in enumerate(names, start=1):
        if not name or name in found:
            name = f"{name}_{place}" if name else f"column_{place}"
        while name in found:
            name += "_"
        found.append(name)
    return found


def plausible_fmt(payload: bytes) -> bool:
    """Whether these 86 bytes are a plausible FMT record: text in text fields, letters that add up to the length."""
    found = parse_fmt(payload, 0)
    return (
        _NAME.fullmatch(found.name) is not None
        and bool(found.letters)
        and found.letters_length == found.length
        and len(found.names) == len(found.letters)
    )


def _cut(text: bytes) -> str:
    return text.partition(b"\0")[0].decode("utf-8", "backslashreplace")


@dataclass(frozen=True, slots=True)
class Measure:
    """Unit of a column."""

    unit: str = ""
    raw_unit: str = ""
    factor: float = 1.0
    """From the stored number, after the letter's conversion, to `unit`; 1: none."""
    instance: bool = False
    """Whether the column distinguishes instances."""


NOTHING = Measure()

Meaning = Callable[[RecordDefinition], Mapping[str, Measure]]
"""Measures of the columns of a type, by name."""


def measures(
    definition: RecordDefinition, units: str, multipliers: str, labels: Mapping[str, str], factors: Mapping[str, float]
) -> dict[str, Measure]:
    """Measures by column, from FMTU's characters. labels, factors: by character, from UNIT and MULT."""
    found = {}
    names = _distinct(definition.names, len(definition.letters))
    fields = {field.name: field for field in definition.fields}
    for place, name in enumerate(names):
        if name not in fields:
            continue
        character = units[place : place + 1]
        label = "" if character in ("", "-", "?", "#") else labels.get(character, "")
        factor = _factor(multipliers[place : place + 1], factors)
        found[name] = _measure(fields[name], _UNITS.get(label, label), factor, character == "#")
    return found


def _measure(field: RecordField, unit: str, factor: float, instance: bool) -> Measure:
    if field.letter in TEXT or field.divisor is not None or factor == 1.0:
        return Measure(unit, unit, 1.0, instance)
    prefix = _PREFIXES.get(factor)
    raw_unit = "" if not unit else f"{prefix}{unit}" if prefix else f"{factor:g} {unit}"
    if unit == "s" and factor < 1.0 and prefix and field.letter not in "fdg":
        return Measure(raw_unit, raw_unit, 1.0, instance)
    return Measure(unit, raw_unit, factor, instance)


def _factor(character: str, factors: Mapping[str, float]) -> float:
    """Factor of a MULT character; 1: none. MULT holds single-precision numbers in double precision."""
    factor = 1.0 if character in ("", "-", "?") else factors.get(character, 1.0)
    if not np.isfinite(factor) or factor == 0.0:
        return 1.0
    return float(f"{factor:.7g}")


FMT = definition(0, FMT_ID, FMT_LENGTH, "FMT", "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))
