"""Fields that were decoded message by message."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap.decoded import Index, Leaf
from xitl_cli.logs.table import Kind

_LARGEST = 2**63


class NumberList(Leaf):
    """One number a message; whole numbers stay whole as long as none is missing (None)."""

    def __init__(self, values: Sequence[Any], unit: str = "", dtype: np.dtype[Any] | None = None) -> None:
        self.unit = unit
        self._values = numbers(values, dtype)
        self.dtype = self._values.dtype

    def take(self, rows: Index) -> NDArray[Any]:
        return self._values[rows]


class ArrayList(Leaf):
    """Numbers in an array a message."""

    def __init__(self, values: Sequence[Sequence[Any]], dtype: np.dtype[Any] | None = None) -> None:
        self._values = [numbers(value, dtype) for value in values]
        counts = [len(value) for value in values]
        self.lengths = (min(counts, default=0), max(counts, default=0))
        self.dtype = dtype or np.result_type(np.int64, *{value.dtype for value in self._values if len(value)})

    def take(self, rows: Index) -> list[Any]:
        return [self._values[row].tolist() for row in rows.tolist()]

    def arrays(self, rows: Index, width: int) -> NDArray[Any]:
        if self.lengths == (width, width):
            stacked = [self._values[row] for row in rows.tolist()]
            return np.array(stacked, dtype=self.dtype).reshape(len(rows), width)
        padded = np.full((len(rows), width), np.nan)
        for number, row in enumerate(rows.tolist()):
            padded[number, : len(self._values[row])] = self._values[row]
        return padded

    def packed(self, rows: Index) -> list[bytes]:
        return [self._values[row].astype(self.dtype).tobytes() for row in rows.tolist()]


class ObjectList(Leaf):
    """Texts or bytes."""

    def __init__(self, values: Sequence[Any], kind: Kind) -> None:
        self.kind = kind
        self.dtype = np.dtype(np.str_ if kind == "text" else object)
        self._values = values

    def take(self, rows: Index) -> list[Any]:
        return [self._values[row] for row in rows.tolist()]


def numbers(values: Sequence[Any], dtype: np.dtype[Any] | None) -> NDArray[Any]:
    """None becomes NaN; whole numbers that 64 bits cannot hold become the nearest that a float can."""
    if dtype is not None and None not in values:
        return np.array(values, dtype=dtype)
    if dtype is None and all(isinstance(value, int) and -_LARGEST <= value < _LARGEST for value in values):
        return np.array(values, dtype=np.int64)
    return np.array([_as_float(value) for value in values], dtype=np.float64)


def _as_float(value: Any) -> float:
    if value is None:
        return float("nan")
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")
