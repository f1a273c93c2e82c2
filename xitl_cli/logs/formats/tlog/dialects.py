"""The messages a log may hold, by number: ArduPilot's dialect and ours, from their generated classes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module

import numpy as np

from xitl_cli.logs.formats.tlog.units import Scale, scale_of, unknown_of
from xitl_cli.logs.table import Column

_MODULES = ("pymavlink.dialects.v20.ardupilotmega", "agent.wire.dialect")
"""The first that knows a number tells what it is: ours leaves extension fields of common messages out."""


@dataclass(frozen=True, slots=True)
class Field:
    """`count` numbers of `dtype` (or characters) at `offset` of the payload; count is 0 for a single number."""

    name: str
    offset: int
    dtype: np.dtype[np.generic]
    count: int
    text: bool
    scale: Scale | None
    unknown: int | None
    column: Column

    @property
    def end(self) -> int:
        return self.offset + max(self.count, 1) * self.dtype.itemsize


@dataclass(frozen=True, slots=True)
class Definition:
    """fields: in the order of the definition, not of the wire. instance: the field that tells sources apart."""

    number: int
    name: str
    crc_extra: int
    fields: Mapping[str, Field]
    instance: str | None

    @property
    def size(self) -> int:
        """Of the payload with all extension fields."""
        return max((field.end for field in self.fields.values()), default=0)


@cache
def definitions() -> Mapping[int, Definition]:
    """By message number."""
    found: dict[int, Definition] = {}
    for module in _MODULES:
        for number, generated in import_module(module).mavlink_map.items():
            if number not in found:
                found[number] = _definition(number, generated)
    return found


def _definition(number: int, generated: type) -> Definition:
    made = vars(generated)
    fields: dict[str, Field] = {}
    offset = 0
    units = made["fieldunits_by_name"]
    codes = made["native_format"].decode().lstrip("<")
    for name, code, count in zip(made["ordered_fieldnames"], codes, made["array_lengths"], strict=True):
        text = code == "c"
        dtype = np.dtype("u1") if text else np.dtype(f"<{code}")
        fields[name] = _field(made["msgname"], name, offset, dtype, count, text, units.get(name, ""))
        offset = fields[name].end
    instance = made["instance_field"]
    return Definition(
        number,
        made["msgname"],
        made["crc_extra"],
        {name: fields[name] for name in made["fieldnames"]},
        None if instance is None or fields[instance].text else instance,
    )


def _field(
    message: str, name: str, offset: int, dtype: np.dtype[np.generic], count: int, text: bool, unit: str
) -> Field:
    scale = None if text else scale_of(unit)
    column = Column(
        name,
        unit if scale is None else scale.unit,
        unit,
        "text" if text else "number",
        () if text or not count else (count,),
    )
    return Field(name, offset, dtype, count, text, scale, unknown_of(message, name), column)
