"""Lanes of ArduPilot's estimator: the core in use over time."""

from __future__ import annotations

import numpy as np

from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Selection, Stamps, Table
from xitl_cli.logs.signals.series import first_instance

CORE = "C"
_PRIMARY = "PI"


def lanes(log: Log, family: str) -> tuple[Stamps, Stamps] | None:
    """(N,) stamps, and the core in use by PI of a family ("XKF", "NKF"), in order of time; None if not logged."""
    table = log.tables.get(f"{family}4")
    if table is None or _PRIMARY not in table.columns or not len(table):
        return None
    order = np.argsort(table.stamp_ns, kind="stable")
    return table.stamp_ns[order], np.asarray(table.values(_PRIMARY, raw=True))[order].astype(np.int64)


def rows_in_use(log: Log, name: str) -> Table | None:
    """Rows of XKF1, XKF3, NKF1 … of the core in use at each row.

    Without a logged core in use, and for other messages, the result is that of `first_instance`.
    """
    table, known = log.tables.get(name), lanes(log, name[:-1])
    if table is None or CORE not in table.columns or known is None:
        return first_instance(log, name)
    stamps, numbers = known
    at = np.clip(np.searchsorted(stamps, table.stamp_ns, side="right") - 1, 0, None)
    own = np.asarray(table.values(CORE, raw=True)).astype(np.int64) == numbers[at]
    return Selection(table, own) if own.any() else first_instance(log, name)
