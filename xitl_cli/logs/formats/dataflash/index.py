"""Offsets of the records of a DataFlash log, and the assignment of FMT records to rows.

A damaged byte of an FMT record must not lose the rows of its type, and a type may be described again. Therefore the
content of an FMT record is checked against the positions of the headers of its rows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.dataflash.definitions import (
    FMT,
    FMT_ID,
    FMT_LENGTH,
    HEAD_BYTES,
    RecordDefinition,
    parse_fmt,
    plausible_fmt,
)
from xitl_cli.logs.formats.dataflash.records import (
    Bytes,
    Forget,
    FoundRecords,
    Heads,
    Places,
    RecordTypes,
    chain,
    find_heads,
)

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
        for type_id, one in self.assumed.items():
            length[type_id] = one
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
    for one in np.flatnonzero(~followed & (first >= ord("A")) & (first <= ord("Z"))).tolist():
        followed[one] = plausible_fmt(payload_at(data, int(place[one])))
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
        for one in likely[:_SAMPLE].tolist():
            payload = payload_at(self._data, one)
            if plausible_fmt(payload):
                return parse_fmt(payload, one)
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
