"""Columns out of the bytes of a log: one by a strided view on it, many by whole rows that are then taken apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.dataflash.formats import Field
from xitl_cli.logs.formats.dataflash.heads import Bytes, Forget, Places
from xitl_cli.logs.table import Column

_WINDOW = 8 << 20
"""Bytes of the file whose rows of all types are taken before the next: they stay in the processor's cache."""
_ROWS = 16_384
"""Rows taken at a time."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """Rows at these places, each of `length` bytes; of each field, what to divide and multiply by, and where it goes.

    A field that is neither divided nor multiplied goes to an array of its own kind, else to one of float64.
    layout: of a row, its columns named by their number.
    """

    place: Places
    length: int
    fields: Sequence[tuple[Field, float, float, NDArray[Any]]]
    layout: np.dtype[np.void]


def stored(data: Bytes, place: Places, field: Field) -> NDArray[Any]:
    """(n,) or (n, items) of a field as it is in the file."""
    shape = (len(place), field.items) if field.items > 1 else (len(place),)
    width = field.dtype.itemsize * field.items
    if not len(place):
        return np.empty(shape, field.dtype)
    found: NDArray[Any] = _every(data, width)[place + field.at].view(field.dtype).reshape(shape)
    return found


def wanted(place: Places, length: int, fields: Sequence[tuple[Field, float, float]]) -> Wanted:
    """With an array for each of these fields, divided and multiplied by the two numbers behind it."""
    count, listed = len(place), []
    for field, divisor, multiplier in fields:
        plain = divisor == multiplier == 1.0
        shape = (count, field.items) if field.items > 1 else (count,)
        listed.append((field, divisor, multiplier, np.empty(shape, field.dtype if plain else np.float64)))
    layout = np.dtype(
        {
            "names": [str(number) for number in range(len(fields))],
            "formats": [(field.dtype, field.items) if field.items > 1 else field.dtype for field, *_ in fields],
            "offsets": [field.at for field, *_ in fields],
            "itemsize": length,
        }
    )
    return Wanted(place, length, listed, layout)


def fill(data: Bytes, many: Sequence[Wanted], forget: Forget | None = None) -> None:
    """Fill the arrays of all. `forget` is told what was read.

    One thread: what Python does between the copies would hold up a second.
    """
    edges = np.arange(0, len(data) + _WINDOW, _WINDOW)
    if len(many) == 1:  # rows of one type are so far apart that no window helps
        edges = np.array([0, len(data)])
    cuts = [np.searchsorted(one.place, edges).tolist() for one in many]

    for at in range(len(edges) - 1):
        for one, cut in zip(many, cuts, strict=True):
            for start in range(cut[at], cut[at + 1], _ROWS):
                _take(data, one, start, min(start + _ROWS, cut[at + 1]))
        if forget is not None:
            forget(int(edges[at]), int(edges[at + 1]))


def _take(data: Bytes, one: Wanted, start: int, stop: int) -> None:
    table = _every(data, one.length)[one.place[start:stop]].view(one.layout)
    for number, (_, divisor, multiplier, out) in enumerate(one.fields):
        column = table[str(number)]
        if divisor != 1.0:
            np.divide(column, divisor, out=out[start:stop])
        elif multiplier != 1.0:
            np.multiply(column, multiplier, out=out[start:stop])
        else:
            out[start:stop] = column


def _every(data: Bytes, width: int) -> NDArray[np.void]:
    """As many bytes from every place of the file on."""
    return np.ndarray((len(data) - width + 1,), f"V{width}", data, strides=(1,))


def shown(values: NDArray[Any], column: Column) -> NDArray[Any]:
    """Text as str, bytes as objects; numbers unchanged."""
    if column.kind == "number":
        return values
    return text(values) if column.kind == "text" else _objects(values)


def text(values: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Cut at the first NUL. Bytes that are no UTF-8 are read as ISO-8859-1."""
    count, width = len(values), values.dtype.itemsize
    if not count:
        return np.empty(0, "U1")
    characters = np.ascontiguousarray(values).view(np.uint8).reshape(count, width)
    ended = np.logical_or.accumulate(characters == 0, axis=1)
    foreign = np.flatnonzero((characters >= 0x80).any(axis=1))
    longest = max(int(width - ended.sum(axis=1).min()), 1)
    plain = np.where(ended | (characters >= 0x80), 0, characters)[:, :longest]
    found = np.ascontiguousarray(plain, dtype=np.uint8).view(f"S{longest}").ravel().astype(f"U{longest}")
    for row in foreign.tolist():
        found[row] = _decoded(characters[row].tobytes())
    return found


def _decoded(whole: bytes) -> str:
    try:
        found = whole.decode()
    except UnicodeDecodeError:
        found = whole.decode("latin-1")
    return found.partition("\0")[0]


def _objects(values: NDArray[Any]) -> NDArray[np.object_]:
    width = values.dtype.itemsize
    whole = np.ascontiguousarray(values).tobytes()
    found = np.empty(len(values), object)
    found[:] = [whole[at : at + width] for at in range(0, len(whole), width)]
    return found
