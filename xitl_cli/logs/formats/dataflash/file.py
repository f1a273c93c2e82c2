"""A DataFlash log (.bin) as tables, one per name of record."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cached_property, partial
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.dataflash.records import (
    Bytes,
    ColumnUnit,
    Meaning,
    RecordDefinition,
    RecordIndex,
    index_records,
    measures,
)
from xitl_cli.logs.formats.dataflash.table import (
    DataFlashTable,
    DefinitionRows,
    RecordCopies,
    Times,
    decode_text,
    read_columns,
    read_field,
    times_in_columns,
    times_in_heads,
)
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.file_bytes import FileBytes
from xitl_cli.logs.model.log import Base, Format, Log, LogHealth

_SEARCHES = 8
"""Number of types with rows that are searched type by type."""
_HUGE = 512 << 20
"""Size of a log in bytes from which searched parts do not stay mapped, although they are read again."""


class DataFlashLog(Log):
    """Implements `Log`. Opening finds all records; columns are read on first use.

    Raises LogError if the file cannot be read or holds no complete record.
    """

    format: Format = "dataflash"

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = path = Path(path)
        self._bytes = FileBytes(path)
        self._data = self._bytes.data
        if not len(self._data):
            raise LogError(f"{path}: is not a DataFlash log, because it is empty; choose a .bin file of ArduPilot")
        self._index: RecordIndex = index_records(self._data, self._forget_huge)
        self._looked_for = 0
        self._copies = RecordCopies(self._data)
        if len(self._index.found.place) <= self._index.found.losses.suspect:  # all of them are doubtful
            self.close()
            if self._index.found.unknown:
                raise LogError(f"{path}: describes none of its records (no FMT); choose a log with its beginning")
            raise LogError(f"{path}: is not a DataFlash log; choose a .bin file of ArduPilot")

    def _forget_huge(self, start: int, stop: int) -> None:
        """Release the memory of these bytes if the file may exceed the memory."""
        if len(self._data) > _HUGE:
            self._bytes.forget(start, stop)

    @property
    def base(self) -> Base:
        return "boot"

    @cached_property
    def tables(self) -> Mapping[str, DataFlashTable]:
        parts: dict[str, list[DefinitionRows]] = {}
        for part in self._parts:
            if part.definition.fields:
                parts.setdefault(part.definition.name, []).append(part)
        meaning = meanings(self._data, parts)
        return MappingProxyType(
            {
                name: DataFlashTable(name, parts[name], meaning, lambda: self._times, self._copies)
                for name in sorted(parts)
            }
        )

    @property
    def rowless(self) -> Collection[str]:
        every = (version for versions in self._index.described.versions.values() for version in versions)
        return {version.name for version in every} - self.tables.keys()

    @cached_property
    def _parts(self) -> list[DefinitionRows]:
        """Rows by type, each with the definition in force."""
        found = self._index.found
        parts = []
        for type_id, count in enumerate(np.bincount(found.type_id, minlength=256).tolist()):
            versions = self._index.described.versions.get(type_id, ())
            if not count or not versions:
                continue
            if len(versions) == 1:
                parts.append(DefinitionRows(versions[0], count, partial(self._find, type_id)))
                continue
            rows = self._find(type_id)
            cuts = [0, *(int(np.searchsorted(rows, version.place)) for version in versions[1:]), len(rows)]
            for version, start, stop in zip(versions, cuts, cuts[1:], strict=False):
                if stop > start:
                    parts.append(DefinitionRows(version, stop - start, partial(np.copy, rows[start:stop])))
        return parts

    def _find(self, type_id: int) -> NDArray[np.int64]:
        """Offsets of a type's rows: searched for the first few types, then taken from an order of all records."""
        found = self._index.found
        self._looked_for += 1
        if self._looked_for <= _SEARCHES:
            return found.place[np.flatnonzero(found.type_id == type_id)]  # faster than indexing with the mask
        return found.place.take(self._sorted_records[type_id])

    @cached_property
    def _sorted_records(self) -> list[NDArray[np.intp]]:
        """Numbers of the records by type number."""
        type_id = self._index.found.type_id
        ends = np.cumsum(np.bincount(type_id, minlength=256))
        return np.split(np.argsort(type_id, kind="stable"), ends[:-1])

    def read(self, *, raw: bool = False) -> dict[str, dict[str, NDArray[Any]]]:
        """Every column of every table, by name of table and of column."""
        jobs = {name: table.jobs(raw=raw) for name, table in self.tables.items()}
        read_columns(self._data, [job for some in jobs.values() for job in some], self._bytes.forget)
        return {name: self.tables[name].filled(some) for name, some in jobs.items()}

    @cached_property
    def _times(self) -> Times:
        every = [version for versions in self._index.described.versions.values() for version in versions]
        timed = self._index.described.types().timed
        if all((own.time is not None) == own.begins_with_time == timed[own.type_id] for own in every):
            return times_in_heads(self._data, self._index.found.place, self._index.found.type_id, timed)
        return times_in_columns([table for table in self.tables.values() if table.timed])

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self._times.span_ns

    @cached_property
    def health(self) -> LogHealth:
        found = self._index.found
        # Undecodable rows by type, or by type and column if only a column cannot be read.
        rows = []
        for part in self._parts:
            own = part.definition
            names = [f"{own.name}.{column}" for column in own.unread] if own.fields else [own.name]
            rows += [(name, len(part), own.why) for name in names]
        for type_id in self._index.described.assumed:
            count = int(np.count_nonzero(found.type_id == type_id))
            rows.append((f"type {type_id}", count, "no FMT record describes it"))
        undecoded: dict[str, tuple[int, str]] = {}
        for name, count, why in rows:
            if count:
                undecoded[name] = undecoded.get(name, (0, why))[0] + count, why
        return found.losses.health(
            len(self._data),
            len(found.place),
            back_in_time=self._times.back_in_time,
            replaced_stamps=self._times.replaced,
            redefined=self._index.described.redefined,
            undecoded=MappingProxyType(undecoded),
        )

    @property
    def facts(self) -> Mapping[str, str]:
        described = sum(len(versions) for versions in self._index.described.versions.values())
        return MappingProxyType({"types described": str(described), "types with rows": str(len(self.tables))})

    def close(self) -> None:
        for name in ("tables", "_parts", "_sorted_records", "_times", "results"):
            self.__dict__.pop(name, None)
        self._copies.clear()
        self._data = np.empty(0, np.uint8)
        self._bytes.close()


_NUMBER, _TEXT = "bBM", "nNZ"


def meanings(data: Bytes, parts: Mapping[str, Sequence[DefinitionRows]]) -> Meaning:
    """Return the meaning of a definition's columns: the last FMTU record of its type with as many columns."""
    labels = _by_character(data, parts.get("UNIT", ()), "Label", _TEXT)
    factors = _by_character(data, parts.get("MULT", ()), "Mult", "dfg")
    described: dict[int, list[tuple[str, str]]] = {}
    for part in parts.get("FMTU", ()):
        columns = [
            _column(data, part, name, letters)
            for name, letters in (("FmtType", _NUMBER), ("UnitIds", _TEXT), ("MultIds", _TEXT))
        ]
        for type_id, units, multipliers in zip(*(column.tolist() for column in columns), strict=False):
            described.setdefault(type_id, []).append((units, multipliers))

    def meaning(definition: RecordDefinition) -> Mapping[str, ColumnUnit]:
        fitting = [pair for pair in described.get(definition.type_id, ()) if len(pair[0]) == len(definition.letters)]
        units, multipliers = fitting[-1] if fitting else ("", "")
        return measures(definition, units, multipliers, labels, factors)

    return meaning


def _by_character(data: Bytes, parts: Sequence[DefinitionRows], column: str, letters: str) -> dict[str, Any]:
    meanings_by_character: dict[str, Any] = {}
    for part in parts:
        numbers = _column(data, part, "Id", _NUMBER).tolist()
        for number, value in zip(numbers, _column(data, part, column, letters).tolist(), strict=False):
            meanings_by_character[chr(number & 0xFF)] = value
    return meanings_by_character


def _column(data: Bytes, part: DefinitionRows, name: str, letters: str) -> NDArray[Any]:
    """Column of this name. Empty if there is none with one of these letters."""
    field = next((field for field in part.definition.fields if field.name == name and field.letter in letters), None)
    if field is None:
        return np.empty(0, np.int64)
    values = read_field(data, part.place, field)
    return decode_text(values) if values.dtype.kind == "S" else values
