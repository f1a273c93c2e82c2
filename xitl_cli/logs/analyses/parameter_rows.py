"""Parameters as a log has them: PARM of DataFlash, PARAM_VALUE of telemetry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.log import Log
from xitl_cli.logs.words.heard import heard


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """One value of one parameter; default: of the firmware, None where it is not logged. source: message it is from."""

    at_ns: int
    name: str
    value: float
    default: float | None
    source: str


def parameter_rows(log: Log) -> list[ParameterRow]:
    """In the log's order; rows without a name or a number are left out."""
    for source, name, value, table in (
        ("PARM", "Name", "Value", log.tables.get("PARM")),
        ("PARAM_VALUE", "param_id", "param_value", heard(log, "PARAM_VALUE")),
    ):
        if table is None or name not in table.columns or value not in table.columns:
            continue
        names = table.values(name)
        values = np.asarray(table.values(value), dtype=np.float64)
        defaults = np.full(len(values), np.nan)
        if "Default" in table.columns:
            defaults = np.asarray(table.values("Default"), dtype=np.float64)
        return [
            ParameterRow(at_ns, str(text), number, default if np.isfinite(default) else None, source)
            for at_ns, text, number, default in zip(
                table.stamp_ns.tolist(), names, values.tolist(), defaults.tolist(), strict=True
            )
            if str(text) and np.isfinite(number)
        ]
    return []


def last_values(log: Log) -> dict[str, float]:
    """Each parameter's last value in the log."""
    return {row.name: row.value for row in parameter_rows(log)}
