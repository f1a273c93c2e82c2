"""The tables of a ULog: rows of a message as strided views on the file, and other records as tables in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.dataflash.table import decode_text
from xitl_cli.logs.formats.ulog.definitions import FieldUnit, RowField, RowLayout, measure_of
from xitl_cli.logs.formats.ulog.records import ROW_HEAD_BYTES, Bytes, Places
from xitl_cli.logs.model.table import ALL, Column, Rows, Stamps, Table

INSTANCE = "multi_id"


@dataclass(frozen=True, slots=True)
class RowPart:
    """Rows of one layout."""

    layout: RowLayout
    place: Places
    """(n,) first bytes."""
    number: NDArray[np.int64]
    """(n,) indices of these rows among all rows of the log."""
    multi_id: NDArray[np.uint8]
    """(n,)"""


class UlogTable(Table):
    """Implements `Table`: the rows of all instances of a message.

    It has a column `multi_id` if there are several instances. The first layout defines the columns. A column that
    another layout lacks is NaN or empty there.
    """

    def __init__(self, name: str, data: Bytes, parts: Sequence[RowPart], stamps: Callable[[], Stamps]) -> None:
        self.name = name
        self._data, self._parts, self._stamps = data, parts, stamps
        ids = np.unique(np.concatenate([np.unique(part.multi_id) for part in parts]))
        self.instance = INSTANCE if len(ids) > 1 or ids.any() else None

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        columns = {INSTANCE: Column(INSTANCE)} if self.instance else {}
        for part in self._parts:
            for field in part.layout.fields:
                columns.setdefault(field.name, _column(self.name, field))
        return MappingProxyType(columns)

    def __len__(self) -> int:
        return sum(len(part.place) for part in self._parts)

    @cached_property
    def _order(self) -> NDArray[np.intp] | None:
        """Order of the concatenated rows of all parts; None if there is one part."""
        if len(self._parts) == 1:
            return None
        return np.argsort(np.concatenate([part.place for part in self._parts]), kind="stable")

    def _joined(self, parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
        return parts[0] if self._order is None else np.concatenate(parts)[self._order]

    @cached_property
    def file_offset(self) -> Places:
        return self._joined([part.place for part in self._parts])

    @cached_property
    def stamp_ns(self) -> Stamps:
        stamps: Stamps = self._stamps()[self._joined([part.number for part in self._parts])]
        stamps.flags.writeable = False
        return stamps

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        known = self.columns[column]
        if column == INSTANCE and self.instance:
            return self._joined([part.multi_id for part in self._parts])[rows]
        if self._order is None:
            return self._values(self._parts[0], self._parts[0].place[rows], known, raw=raw)
        parts = [self._values(part, part.place, known, raw=raw) for part in self._parts]
        return np.concatenate(parts)[self._order][rows]

    def _values(self, part: RowPart, place: Places, known: Column, *, raw: bool) -> NDArray[Any]:
        field = next((field for field in part.layout.fields if field.name == known.name), None)
        if field is None or (column := _column(self.name, field)).shape != known.shape or column.kind != known.kind:
            return _missing(known, len(place))
        items = field.dtype.itemsize * field.items
        stored = np.ndarray((max(len(self._data) - items + 1, 0),), f"V{items}", self._data, strides=(1,))
        return self._scaled(_finished(stored[place + ROW_HEAD_BYTES + field.at], field), field, raw=raw)

    def _scaled(self, values: NDArray[Any], field: RowField, *, raw: bool) -> NDArray[Any]:
        divisor = _measure(self.name, field).divisor
        return values if raw or divisor == 1.0 else np.asarray(values / divisor)

    def read(self, *, raw: bool = False) -> dict[str, NDArray[Any]]:
        """Read all columns row by row, which is faster than column by column."""
        read: dict[str, list[NDArray[Any]]] = {name: [] for name in self.columns}
        for part in self._parts:
            # All rows as a structured array, with their fields by name.
            layout = part.layout
            view = np.ndarray((len(self._data) - layout.shortest + 1,), f"V{layout.shortest}", self._data, strides=(1,))
            packed = {
                "names": [field.name for field in layout.fields],
                "formats": [(field.dtype, field.items) if field.items > 1 else field.dtype for field in layout.fields],
                "offsets": [field.at for field in layout.fields],
                "itemsize": layout.shortest,
            }
            stored: NDArray[np.void] = view[part.place + ROW_HEAD_BYTES].view(np.dtype(packed))  # type: ignore[call-overload]
            fields = {field.name: field for field in layout.fields}
            for name, known in self.columns.items():
                if name == INSTANCE and self.instance:
                    read[name].append(part.multi_id)
                elif name in fields and _column(self.name, fields[name]) == known:
                    values = _finished(np.ascontiguousarray(stored[name]), fields[name])
                    read[name].append(self._scaled(values, fields[name], raw=raw))
                else:
                    read[name].append(_missing(known, len(part.place)))
        return {name: self._joined(parts) for name, parts in read.items()}


def _measure(message: str, field: RowField) -> FieldUnit:
    return measure_of(message, field.name, whole=field.dtype.kind in "iu")


def _column(message: str, field: RowField) -> Column:
    if field.is_text:
        return Column(field.name, kind="text")
    measure = _measure(message, field)
    return Column(field.name, measure.unit, measure.raw_unit, shape=(field.items,) if field.array else ())


def _finished(stored: NDArray[Any], field: RowField) -> NDArray[Any]:
    """Values of stored bytes (n,), with the type and shape of the column."""
    count = len(stored)
    if field.is_text:
        return decode_text(np.ascontiguousarray(stored).view(f"S{field.items}").reshape(count))
    values = np.ascontiguousarray(stored).view(field.dtype)
    return values.reshape((count, field.items) if field.array else (count,))


def _missing(column: Column, count: int) -> NDArray[Any]:
    return np.full(count, "", "U1") if column.kind == "text" else np.full((count, *column.shape), np.nan)


class MadeTable(Table):
    """Implements `Table` with columns in memory. place: (n,) of the records in the file."""

    def __init__(self, name: str, stamp_ns: Stamps, place: Places, values: Mapping[str, NDArray[Any]]) -> None:
        self.name = name
        self._stamp_ns, self._place, self._values = stamp_ns, place, values

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        columns = {}
        for name, values in self._values.items():
            unit = measure_of(self.name, name).unit
            columns[name] = Column(name, kind="text") if values.dtype.kind == "U" else Column(name, unit, unit)
        return MappingProxyType(columns)

    def __len__(self) -> int:
        return len(self._place)

    @property
    def stamp_ns(self) -> Stamps:
        return self._stamp_ns

    @property
    def file_offset(self) -> Places:
        return self._place

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        return self._values[column][rows]
