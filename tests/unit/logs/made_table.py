"""A log of made-up tables, with every kind of column."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Base, Format, Health
from xitl_cli.logs.table import ALL, Column, Rows, Table


@dataclass
class MadeTable:
    name: str
    columns: Mapping[str, Column]
    held: Mapping[str, NDArray[Any]]
    stamp_ns: NDArray[np.int64]
    place: NDArray[np.int64]
    instance: str | None = None

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        values = self.held[column][rows]
        return (values * 100).astype(np.int32) if raw and self.columns[column].raw_unit == "cdeg" else values


@dataclass
class MadeLog:
    tables: Mapping[str, Table]
    path: Path = Path("flight.bin")
    format: Format = "dataflash"
    base: Base = "boot"
    facts: Mapping[str, str] = field(default_factory=dict)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        stamps = np.concatenate([table.stamp_ns for table in self.tables.values()])
        return (int(stamps.min()), int(stamps.max())) if len(stamps) else None

    @property
    def health(self) -> Health:
        return Health(0, sum(map(len, self.tables.values())))

    def close(self) -> None: ...

    def __enter__(self) -> MadeLog:
        return self

    def __exit__(self, *_: object) -> None: ...


def made_table(name: str, columns: Mapping[str, tuple[Column, Any]], stamp_ns: Any, place: Any) -> MadeTable:
    return MadeTable(
        name,
        {key: column for key, (column, _) in columns.items()},
        {key: np.asarray(values) for key, (_, values) in columns.items()},
        np.asarray(stamp_ns, dtype=np.int64),
        np.asarray(place, dtype=np.int64),
    )


def every_kind(rows: int = 5, first_ns: int = 1_000_000_123) -> MadeTable:
    """Numbers of all sizes, a text, bytes, a fixed and a varying array."""
    steps = np.arange(rows)
    numbers = {
        f"N{np.dtype(code).str[1:]}": (Column(f"N{np.dtype(code).str[1:]}", "m", "m"), steps.astype(code) + 1)
        for code in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8")
    }
    texts = np.array([f'text, "{n}"\nend' if n % 2 else "" for n in range(rows)])
    data = np.array([bytes(range(n)) for n in range(rows)] + [None], dtype=object)[:rows]
    varying = np.array([[float(k) if k <= n % 3 else np.nan for k in range(3)] for n in range(rows)])
    further = {
        "Angle": (Column("Angle", "deg", "cdeg"), steps / 100),
        "Odd": (Column("Odd", "deg"), np.where(steps % 2, np.nan, steps * np.float32(0.1)).astype(np.float32)),
        "Text": (Column("Text", kind="text"), texts),
        "Data": (Column("Data", kind="bytes"), data),
        "Fixed": (Column("Fixed", "V", shape=(2,)), np.stack([steps, steps * 2], axis=1).astype(np.int16)),
        "pose.x": (Column("pose.x", "m", shape=(-1,)), varying),
        "_sysid": (Column("_sysid"), steps.astype(np.uint8)),
    }
    return made_table("KIND", numbers | further, first_ns + steps * 1_000_001, steps * 10)
