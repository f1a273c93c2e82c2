"""Rows of batches: select the vessel of a row of a state, and replace the vessels of some rows.

state = with_rows(state, [row], row_of(state, row))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
Rows = Sequence[int] | NDArray[np.intp]
"""Numbers of K rows, all different."""


def row_of(now: T, row: int) -> T:
    """Return the dataclass `now` of N vessels with one of its rows, (1, ...).

    Arrays of one row, which all vessels share, stay as they are, as does everything but arrays and dataclasses inside.
    """
    if not is_dataclass(now) or isinstance(now, type):
        return now
    changed: dict[str, Any] = {}
    for field in fields(now):
        value = getattr(now, field.name)
        if isinstance(value, np.ndarray):
            changed[field.name] = value if len(value) == 1 else value[row : row + 1]
        elif is_dataclass(value):
            changed[field.name] = row_of(value, row)
    return replace(now, **changed)


def with_rows(now: T, rows: Rows, fresh: T) -> T:
    """Return the dataclass `now` of N vessels with these K rows replaced by the K vessels of `fresh`.

    Arrays are replaced by rows, and dataclasses inside by their arrays. Everything else stays as in `now`: times, text,
    None, and parts that both share.
    """
    if not is_dataclass(now) or isinstance(now, type) or now is fresh:
        return now
    changed: dict[str, Any] = {}
    for field in fields(now):
        before, after = getattr(now, field.name), getattr(fresh, field.name)
        if isinstance(before, np.ndarray) and isinstance(after, np.ndarray):
            mixed = before.copy()
            mixed[rows] = after
            changed[field.name] = mixed
        elif is_dataclass(before) and type(before) is type(after):
            changed[field.name] = with_rows(before, rows, after)
    return replace(now, **changed)
