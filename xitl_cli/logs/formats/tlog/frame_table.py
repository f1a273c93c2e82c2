"""All frames of one message as a table; fields are read out of the frames when they are asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.tlog.dialects import Definition, Field
from xitl_cli.logs.formats.tlog.headers import MAGIC_2
from xitl_cli.logs.table import ALL, Column, Rows

_FROM_HEADER = {"_sysid": (5, 3), "_compid": (6, 4), "_seq": (4, 2)}
"""Where the byte is in a frame of MAVLink 2 and 1."""


class FrameTable:
    """Frames of one message, each beginning at `start` of `data`; fields, then `_sysid`, `_compid` and `_seq`.

    Bytes that a frame does not carry are 0: MAVLink 2 cuts them off, and fields may be newer than the sender.
    A value that stands for "not known" is NaN unless `raw`.
    """

    def __init__(
        self,
        name: str,
        definition: Definition,
        data: NDArray[np.uint8],
        start: NDArray[np.int64],
        stamp_ns: NDArray[np.int64],
        place: NDArray[np.int64],
    ) -> None:
        self.name = name
        self.instance = definition.instance
        self.stamp_ns, self.place = stamp_ns, place
        self.stamp_ns.flags.writeable = self.place.flags.writeable = False
        self._definition, self._data, self._start = definition, data, start
        self.columns: Mapping[str, Column] = {
            **{name: field.column for name, field in definition.fields.items()},
            **{name: Column(name) for name in _FROM_HEADER},
        }

    def __len__(self) -> int:
        return len(self._start)

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        start = self._start[rows]
        second = self._data[start] == MAGIC_2
        if column in _FROM_HEADER:
            in_second, in_first = _FROM_HEADER[column]
            return self._data[start + np.where(second, in_second, in_first)]
        field = self._definition.fields[column]
        payload = start + np.where(second, 10, 6)
        stored = self._stored(field, payload, self._data[start + 1].astype(np.int64))
        if field.text:
            return _text(stored)
        return stored if raw else _scaled(field, stored)

    def _stored(self, field: Field, payload: NDArray[np.int64], length: NDArray[np.int64]) -> NDArray[Any]:
        count, item = max(field.count, 1), field.dtype.itemsize
        result = np.zeros((len(payload), count), field.dtype)
        carried = length >= field.end
        if carried.any():
            at_any_byte: NDArray[Any] = np.ndarray((len(self._data) - item + 1,), field.dtype, self._data, strides=(1,))
            begin = payload + field.offset
            steps = np.arange(count) * item
            if carried.all():
                result[:] = at_any_byte[begin[:, None] + steps]
            else:
                result[carried] = at_any_byte[begin[carried, None] + steps]
        cut = np.flatnonzero(~carried & (length > field.offset))
        if len(cut):
            offsets = field.offset + np.arange(count * item)
            inside = offsets < length[cut, None]
            found = self._data[np.where(inside, payload[cut, None] + offsets, 0)] * inside
            result[cut] = np.ascontiguousarray(found, dtype=np.uint8).view(field.dtype)
        return result if field.count else result[:, 0]


def _text(characters: NDArray[np.uint8]) -> NDArray[np.str_]:
    """Up to the first NUL."""
    if not characters.size:
        return np.zeros(len(characters), dtype="U1")
    texts = np.ascontiguousarray(characters).view(f"S{characters.shape[1]}")[:, 0]
    shown = [text.split(b"\0", 1)[0].decode("ascii", errors="replace") for text in texts.tolist()]
    return np.array(shown, dtype=np.str_)


def _scaled(field: Field, stored: NDArray[Any]) -> NDArray[Any]:
    values = stored
    if field.scale is not None:
        number = field.scale.number
        values = stored / number if field.scale.how == "over" else stored * number
    if field.unknown is not None:
        values = np.where(stored == field.unknown, np.nan, values)
    return values
