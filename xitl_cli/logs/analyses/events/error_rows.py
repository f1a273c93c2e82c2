"""ERR of a DataFlash log: what went wrong, from when until it was cleared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.log import Log
from xitl_cli.logs.words.errors import lasts


@dataclass(frozen=True, slots=True)
class ErrorSpan:
    """code: the first one of the span. until_ns: when it was cleared, None when it never was or tells of an instant."""

    subsystem: int
    code: int
    from_ns: int
    until_ns: int | None


def error_rows(log: Log) -> list[tuple[int, int, int]]:
    """(stamp, subsystem, code) in the order of time."""
    table = log.tables.get("ERR")
    if table is None or not {"Subsys", "ECode"} <= set(table.columns):
        return []
    order = np.argsort(table.stamp_ns, kind="stable")
    columns = (np.asarray(table.values(name, raw=True))[order].astype(np.int64) for name in ("Subsys", "ECode"))
    return list(zip(table.stamp_ns[order].tolist(), *(column.tolist() for column in columns), strict=True))


def error_spans(rows: list[tuple[int, int, int]]) -> list[ErrorSpan]:
    """A code 0 ends what its subsystem had; one without anything to end is how a healthy start looks."""
    open_ones: dict[int, ErrorSpan] = {}
    done: list[ErrorSpan] = []
    for at_ns, subsystem, code in rows:
        if not lasts(subsystem):
            done.append(ErrorSpan(subsystem, code, at_ns, None))
        elif code == 0:
            before = open_ones.pop(subsystem, None)
            if before is not None:
                done.append(ErrorSpan(subsystem, before.code, before.from_ns, at_ns))
        elif subsystem not in open_ones:
            open_ones[subsystem] = ErrorSpan(subsystem, code, at_ns, None)
    return sorted([*done, *open_ones.values()], key=lambda span: span.from_ns)
