"""Reading logs back with pymavlink, which knows nothing of ours."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pymavlink import DFReader
from python39 import strict_zip


def rows_of(path: Path) -> dict[str, list[Any]]:
    """All messages by type, in their order; bytes the reader had to skip fail."""
    reader = DFReader.DFReader_binary(str(path), zero_time_base=False)
    found: dict[str, list[Any]] = {}
    try:
        while (message := reader.recv_msg()) is not None:
            assert message.get_type() != "BAD_DATA"
            found.setdefault(message.get_type(), []).append(message)
    finally:
        reader.close()
    return found


def described(rows: Mapping[str, list[Any]]) -> dict[str, dict[str, tuple[str, str, float]]]:
    """Message -> column -> (letter, unit, multiplier), as the log itself says."""
    labels = {chr(row.Id): row.Label for row in rows["UNIT"]}
    factors = {chr(row.Id): row.Mult for row in rows["MULT"]}
    fmtu = {row.FmtType: (row.UnitIds, row.MultIds) for row in rows["FMTU"]}
    found = {}
    for row in rows["FMT"]:
        units, multipliers = fmtu[row.Type]
        found[row.Name] = {
            column: (letter, labels[unit], factors[multiplier])
            for column, letter, unit, multiplier in strict_zip(row.Columns.split(","), row.Format, units, multipliers)
        }
    return found
