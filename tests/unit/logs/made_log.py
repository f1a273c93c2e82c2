"""A log made of arrays, for tests of what reads any log."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xitl_cli.logs.model.log import Base, Format, Log, LogHealth
from xitl_cli.logs.model.table import ALL, Column, Rows, Table


class MadeTable(Table):
    """Columns as given; `instance` names one of them. What is in cdeg as stored is given in deg.

    columns: what these are; without, their kind and shape is that of the values.
    """

    columns: Any = None
    stamp_ns: Any = None
    file_offset: Any = None

    def __init__(
        self,
        name: str,
        stamp_ns: ArrayLike,
        values: Mapping[str, ArrayLike],
        instance: str | None = None,
        units: Mapping[str, str] = MappingProxyType({}),
        place: ArrayLike | None = None,
        columns: Mapping[str, Column] | None = None,
    ) -> None:
        self.name, self.instance = name, instance
        self.stamp_ns = np.asarray(stamp_ns, dtype=np.int64)
        self.file_offset = np.arange(len(self.stamp_ns)) if place is None else np.asarray(place, dtype=np.int64)
        self._values = {column: np.asarray(each) for column, each in values.items()}
        self.columns = (
            columns
            or {
                column: Column(
                    column,
                    units.get(column, ""),
                    kind={"U": "text", "O": "bytes"}.get(each.dtype.kind, "number"),  # type: ignore[arg-type]
                    shape=each.shape[1:],
                )
                for column, each in self._values.items()
            }
        )

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        found: NDArray[Any] = self._values[column][rows]
        return (found * 100).astype(np.int32) if raw and self.columns[column].raw_unit == "cdeg" else found


class MadeLog(Log):
    base: Any = None
    tables: Any = None
    health: Any = None
    facts: Any = None
    vessel: Any = ""

    def __init__(
        self, *tables: MadeTable, kind: Format = "dataflash", base: Base = "boot", path: str = "made.bin"
    ) -> None:
        self.path, self.format, self.base = Path(path), kind, base
        self.tables = {table.name: table for table in sorted(tables, key=lambda table: table.name)}
        self.health = LogHealth(0, sum(len(table) for table in tables))
        self.facts: dict[str, str] = {}

    @property
    def span_ns(self) -> tuple[int, int] | None:
        stamps = [table.stamp_ns for table in self.tables.values() if len(table)]
        return (min(int(one.min()) for one in stamps), max(int(one.max()) for one in stamps)) if stamps else None

    def close(self) -> None: ...
