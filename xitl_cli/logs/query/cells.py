"""Values of a table as text and as what JSON can hold."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray


def texts(values: NDArray[Any]) -> list[str]:
    """One a row: the shortest digits that give the same number; arrays in brackets; bytes as hexadecimal digits."""
    if values.ndim > 1:
        flat = texts(values.ravel())
        count = values.size // len(values) if len(values) else 0
        return ["[" + " ".join(flat[row * count : (row + 1) * count]) + "]" for row in range(len(values))]
    if values.dtype.kind == "f":
        return [_shortest(value) for value in values]
    if values.dtype.kind == "O":
        return [value.hex() if isinstance(value, bytes) else str(value) for value in values]
    return [str(value) for value in values.tolist()]


def plain(values: NDArray[Any]) -> list[Any]:
    """One a row: numbers, texts, lists; None for what is no finite number; bytes as hexadecimal digits."""
    if values.ndim > 1:
        return [plain(row) for row in values]
    if values.dtype.kind == "f":
        # As many digits as the stored precision has, not those of a double made of it.
        return [float(_shortest(value)) if math.isfinite(value) else None for value in values]
    if values.dtype.kind == "O":
        return [value.hex() if isinstance(value, bytes) else str(value) for value in values]
    return list(values.tolist())


def _shortest(value: np.floating[Any]) -> str:
    return str(value).removesuffix(".0")
