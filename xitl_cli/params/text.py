"""Parameter values and files as text. On the wire a value is a 32-bit float."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from datetime import UTC, datetime

from agent.fcu.parameters import TABLE, Parameter

TABLE_BY_NAME: Mapping[str, Parameter] = {row.name: row for row in TABLE}


def single(value: float) -> float:
    """The value as a 32-bit float."""
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


def same(one: float, other: float) -> bool:
    """Whether two values are the same 32-bit float."""
    return single(one) == single(other)


def shown(value: float) -> str:
    """The shortest decimal that is this 32-bit float."""
    for digits in (7, 8):
        text = f"{value:.{digits}g}"
        if same(float(text), value):
            return text
    return f"{value:.9g}"


def parm_text(values: Mapping[str, float], source: str, now: datetime | None = None) -> str:
    """A .parm file that any ground station reads: a heading, then NAME value and, where known, what it means."""
    stamp = (now or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M UTC")
    lines = [f"# {len(values)} parameters of {source}, {stamp}"]
    described = set(values) <= set(TABLE_BY_NAME)
    for name, value in values.items():
        line = f"{name:<16} {shown(value)}"
        if described:
            row = TABLE_BY_NAME[name]
            line = f"{line:<32}# {row.meaning}{f' [{row.unit}]' if row.unit else ''}"
        lines.append(line)
    return "\n".join(lines) + "\n"
