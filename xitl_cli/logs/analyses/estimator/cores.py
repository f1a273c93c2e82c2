"""Cores of the estimator: EKF3's XKF messages, EKF2's NKF, by number of the core, whatever the version calls them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.table import Selection, Table

_FAMILIES = (("EKF3", "XKF"), ("EKF2", "NKF"))
_SECOND_CORE = 5  # before 4.1 a core had messages of its own: XKF6 is XKF1 of the second


@dataclass(frozen=True, slots=True)
class Core:
    """solution: XKF1, innovations: XKF3, health: XKF4 of one core, None where not logged."""

    number: int
    filter: str
    solution: Table | None
    innovations: Table | None
    health: Table | None


def cores(log: Log) -> list[Core]:
    """Of EKF3 where it was logged, else of EKF2, by number."""
    for name, prefix in _FAMILIES:
        parts = {kind: _by_core(log, prefix, kind) for kind in (1, 3, 4)}
        numbers = sorted(set().union(*parts.values()))
        if numbers:
            return [
                Core(number, name, *(parts[kind].get(number) for kind in (1, 3, 4))) for number in numbers if number < 8
            ]
    return []


def whole(table: Table, column: str) -> NDArray[np.int64]:
    """(N,) of a column of flags."""
    return np.asarray(table.values(column, raw=True)).astype(np.int64)


def _by_core(log: Log, prefix: str, kind: int) -> dict[int, Table]:
    table = log.tables.get(f"{prefix}{kind}")
    if table is None:
        return {}
    if "C" in table.columns:
        numbers = whole(table, "C")
        return {int(number): Selection(table, numbers == number) for number in np.unique(numbers)}
    second = log.tables.get(f"{prefix}{kind + _SECOND_CORE}")
    return {0: table} if second is None else {0: table, 1: second}
