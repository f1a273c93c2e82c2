"""All records of one name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.dataflash.describe import Meaning
from xitl_cli.logs.formats.dataflash.formats import NOTHING, TEXT, Definition, Field, Measure
from xitl_cli.logs.formats.dataflash.heads import Bytes, Places
from xitl_cli.logs.formats.dataflash.rows import Wanted, fill, shown, stored, wanted
from xitl_cli.logs.formats.dataflash.times import Times, stamps_ns
from xitl_cli.logs.table import ALL, Column, Kind, Rows


class Part:
    """Rows that one definition describes; their places are looked for when they are needed."""

    def __init__(self, definition: Definition, count: int, find: Callable[[], Places]) -> None:
        self.definition = definition
        self._count = count
        self._find = find

    def __len__(self) -> int:
        return self._count

    @cached_property
    def place(self) -> Places:
        return self._find()


@dataclass(frozen=True, slots=True)
class _Sense:
    """A part with what its columns are."""

    part: Part
    columns: Mapping[str, tuple[Field, Measure, Column]]


class DataFlashTable:
    """Implements `Table`. It has parts where a type was described anew, or two types have one name.

    A column is what the first part makes of it; where another part lacks it, or has another kind of it, it is NaN or
    empty.
    """

    def __init__(
        self,
        name: str,
        data: Bytes,
        parts: Sequence[Part],
        meaning: Meaning,
        times: Callable[[], Times],
    ) -> None:
        self._name = name
        self._data = data
        self._parts = [_Sense(part, _columns(name, part.definition, meaning)) for part in parts]
        self._times = times

    @property
    def name(self) -> str:
        return self._name

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        found: dict[str, Column] = {}
        for sense in self._parts:
            for name, (_, _, column) in sense.columns.items():
                found.setdefault(name, column)
        return MappingProxyType(found)

    @cached_property
    def instance(self) -> str | None:
        return next(
            (name for sense in self._parts for name, (_, measure, _) in sense.columns.items() if measure.instance), None
        )

    def __len__(self) -> int:
        return sum(len(sense.part) for sense in self._parts)

    @cached_property
    def _order(self) -> NDArray[np.intp] | None:
        """Of the rows of all parts, one behind the other; None when there is one."""
        if len(self._parts) == 1:
            return None
        return np.argsort(np.concatenate([sense.part.place for sense in self._parts]), kind="stable")

    @cached_property
    def place(self) -> Places:
        return self._whole([sense.part.place for sense in self._parts])

    @cached_property
    def stamp_ns(self) -> NDArray[np.int64]:
        return self._whole([self._stamps(sense.part, sense.part.place) for sense in self._parts])

    def told_ns(self) -> NDArray[np.int64]:
        """(N,) what the rows of a timed table tell, also where it cannot be."""
        return self._whole([self._told(sense.part, sense.part.place) for sense in self._parts])

    @property
    def ends_ns(self) -> tuple[int, int] | None:
        """Stamps of the first and the last row, without those between; None when rows do not tell."""
        if not self.timed:
            return None
        if len(self._parts) > 1:
            return int(self.stamp_ns[0]), int(self.stamp_ns[-1])
        first_ns, last_ns = self._stamps(self._parts[0].part, self.place[[0, -1]]).tolist()
        return first_ns, last_ns

    def _whole(self, parts: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
        found = parts[0] if self._order is None else np.concatenate(parts)[self._order]
        found.flags.writeable = False
        return found

    @property
    def timed(self) -> bool:
        """Whether rows say themselves when they were written."""
        return all(sense.part.definition.time is not None for sense in self._parts)

    def _stamps(self, part: Part, place: Places) -> NDArray[np.int64]:
        if part.definition.time is None:
            return self._times().last_before(place)
        return self._times().mended(place, self._told(part, place))

    def _told(self, part: Part, place: Places) -> NDArray[np.int64]:
        assert part.definition.time is not None
        field, unit_ns = part.definition.time
        return stamps_ns(stored(self._data, place, field), unit_ns)

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        known = self.columns[column]
        if self._order is None:
            return self._values(self._parts[0], self.place[rows], known, raw=raw)
        whole = [self._values(sense, sense.part.place, known, raw=raw) for sense in self._parts]
        return np.concatenate(whole)[self._order][rows]

    def _values(self, sense: _Sense, place: Places, known: Column, *, raw: bool) -> NDArray[Any]:
        field, measure, column = sense.columns.get(known.name, (None, NOTHING, known))
        if field is None or (column.kind, column.shape) != (known.kind, known.shape):
            return _missing(known, len(place))
        values = stored(self._data, place, field)
        divisor, multiplier = field.conversion(measure, raw=raw)
        if divisor != 1.0:
            return np.asarray(np.divide(values, divisor, dtype=np.float64))
        if multiplier != 1.0:
            return np.asarray(np.multiply(values, multiplier, dtype=np.float64))
        return shown(values, known)

    def read(self, *, raw: bool = False) -> dict[str, NDArray[Any]]:
        """All columns at once, which is faster than one by one."""
        jobs = self.jobs(raw=raw)
        fill(self._data, jobs)
        return self.filled(jobs)

    def jobs(self, *, raw: bool = False) -> list[Wanted]:
        """All there is to read, one a part; `filled` gives the columns of them."""
        return [
            wanted(
                sense.part.place,
                sense.part.definition.length,
                [(field, *field.conversion(measure, raw=raw)) for field, measure, _ in sense.columns.values()],
            )
            for sense in self._parts
        ]

    def filled(self, jobs: Sequence[Wanted]) -> dict[str, NDArray[Any]]:
        return {name: self._joined(known, jobs) for name, known in self.columns.items()}

    def _joined(self, known: Column, jobs: Sequence[Wanted]) -> NDArray[Any]:
        found = []
        for sense, job in zip(self._parts, jobs, strict=True):
            values = next((values for field, _, _, values in job.fields if field.name == known.name), None)
            column = sense.columns[known.name][2] if values is not None else known
            if values is None or (column.kind, column.shape) != (known.kind, known.shape):
                found.append(_missing(known, len(sense.part)))
            else:
                found.append(shown(values, known))
        return found[0] if self._order is None else np.concatenate(found)[self._order]


def _columns(name: str, definition: Definition, meaning: Meaning) -> dict[str, tuple[Field, Measure, Column]]:
    measures = meaning(definition)
    found = {}
    for field in definition.fields:
        measure = measures.get(field.name, NOTHING)
        kind: Kind = (
            "number" if field.letter not in TEXT else "bytes" if (name, field.letter) == ("FILE", "Z") else "text"
        )
        shape = (field.items,) if field.items > 1 else ()
        found[field.name] = field, measure, Column(field.name, measure.unit, measure.raw_unit, kind, shape)
    return found


def _missing(column: Column, count: int) -> NDArray[Any]:
    if column.kind == "number":
        return np.full((count, *column.shape), np.nan)
    if column.kind == "text":
        return np.full(count, "", "U1")
    found = np.empty(count, object)
    found[:] = b""
    return found
