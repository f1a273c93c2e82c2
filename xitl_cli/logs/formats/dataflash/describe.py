"""UNIT, MULT and FMTU of a log: what the columns of its types measure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.dataflash.formats import Definition, Measure, measures
from xitl_cli.logs.formats.dataflash.heads import Bytes
from xitl_cli.logs.formats.dataflash.rows import stored, text

if TYPE_CHECKING:
    from xitl_cli.logs.formats.dataflash.table import Part

_NUMBER, _TEXT = "bBM", "nNZ"

Meaning = Callable[[Definition], Mapping[str, Measure]]


def meanings(data: Bytes, parts: Mapping[str, Sequence[Part]]) -> Meaning:
    """What the columns of a definition measure, as the last FMTU record of its type with as many columns says."""
    labels = _by_character(data, parts.get("UNIT", ()), "Label", _TEXT)
    factors = _by_character(data, parts.get("MULT", ()), "Mult", "dfg")
    described: dict[int, list[tuple[str, str]]] = {}
    for part in parts.get("FMTU", ()):
        columns = [
            _column(data, part, name, letters)
            for name, letters in (("FmtType", _NUMBER), ("UnitIds", _TEXT), ("MultIds", _TEXT))
        ]
        for type_id, units, multipliers in zip(*(column.tolist() for column in columns), strict=False):
            described.setdefault(type_id, []).append((units, multipliers))

    def meaning(definition: Definition) -> Mapping[str, Measure]:
        fitting = [pair for pair in described.get(definition.type_id, ()) if len(pair[0]) == len(definition.letters)]
        units, multipliers = fitting[-1] if fitting else ("", "")
        return measures(definition, units, multipliers, labels, factors)

    return meaning


def _by_character(data: Bytes, parts: Sequence[Part], column: str, letters: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for part in parts:
        numbers = _column(data, part, "Id", _NUMBER).tolist()
        values = _column(data, part, column, letters).tolist()
        found.update({chr(number & 0xFF): value for number, value in zip(numbers, values, strict=False)})
    return found


def _column(data: Bytes, part: Part, name: str, letters: str) -> NDArray[Any]:
    """Empty when there is none with such a letter."""
    field = next((field for field in part.definition.fields if field.name == name and field.letter in letters), None)
    if field is None:
        return np.empty(0, np.int64)
    values = stored(data, part.place, field)
    return text(values) if values.dtype.kind == "S" else values
