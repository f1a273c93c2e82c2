"""JSON payloads, with a schema or without."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from xitl_cli.logs.formats.mcap.decoded import MOST_ELEMENTS, MOST_LEAVES, Leaf, Part
from xitl_cli.logs.formats.mcap.gather import Batch
from xitl_cli.logs.formats.mcap.lists import ArrayList, NumberList, ObjectList

_DEEPEST = 8


class JsonDecoder:
    """Keys inside of keys are named "pose.position.x", of what is no object "value".

    Numbers, NaN where a message has none (null too); true and false are 1 and 0; texts, empty where a message has none.
    A key that is a number here and a text there is a text. Arrays as CdrDecoder has them, for any element that some row
    has. Keys behind the first 2000 of a topic, and those nested deeper than 8, are left out.
    """

    open_ended = True

    def decode(self, batch: Batch, wanted: str | None) -> Part:
        good = np.ones(len(batch), dtype=np.bool_)
        columns: dict[str, dict[int, Any]] = {}
        for row in range(len(batch)):
            try:
                value = json.loads(batch.payload(row))
            except (ValueError, RecursionError):
                good[row] = False
                continue
            for name, found in _flat(value, "", 0):
                if wanted is not None and name != wanted:
                    continue
                column = columns.get(name)
                if column is None:
                    if len(columns) >= MOST_LEAVES:
                        break
                    column = columns[name] = {}
                column[row] = found
        return Part(good, {name: _leaf(column, len(batch)) for name, column in columns.items()})


def _flat(value: Any, name: str, depth: int) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        if depth < _DEEPEST:
            for key, inner in value.items():
                yield from _flat(inner, f"{name}.{key}" if name else key, depth + 1)
    elif isinstance(value, list):
        if all(inner is None or isinstance(inner, int | float) for inner in value):
            yield name or "value", value
            return
        yield f"{name or 'value'}.length", len(value)
        if depth < _DEEPEST:
            for number, inner in enumerate(value[:MOST_ELEMENTS]):
                yield from _flat(inner, f"{name or 'value'}[{number}]", depth + 1)
    elif value is not None:
        yield name or "value", value


def _leaf(column: dict[int, Any], rows: int) -> Leaf:
    values = [column.get(row) for row in range(rows)]
    if any(isinstance(value, str) for value in column.values()):
        return ObjectList(["" if value is None else _text(value) for value in values], "text")
    if all(isinstance(value, list) for value in column.values()):
        return ArrayList([value or () for value in values])
    if any(isinstance(value, list) for value in column.values()):
        return ObjectList(["" if value is None else _text(value) for value in values], "text")
    return NumberList([int(value) if isinstance(value, bool) else value for value in values])


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
