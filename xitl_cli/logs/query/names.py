"""Messages and fields by what a user typed: in any case, with the nearest one when there is none of that name."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from difflib import get_close_matches

from xitl_cli.logs.errors import LogError
from xitl_cli.logs.log import Log
from xitl_cli.logs.table import Table

_LISTED = 12


def tables_named(log: Log, wanted: Iterable[str]) -> list[Table]:
    """In the order wanted, each once; "IMU,ATT" are two. Raises LogError."""
    names = [name.strip() for text in wanted for name in text.split(",") if name.strip()]
    if not log.tables:
        raise LogError(f"{log.path}: holds no message that can be read; `xitl logs info` says what is wrong with it")
    return [log.tables[name] for name in dict.fromkeys(_table_name(log, name) for name in names)]


def _table_name(log: Log, wanted: str) -> str:
    topic, _, message = wanted.rpartition(":")
    if topic in log.tables and f"{topic}:{message.upper()}" in log.tables:  # of the frames that a recording keeps
        return f"{topic}:{message.upper()}"
    return match(wanted, log.tables, f"{log.path}: has no message", "`xitl logs info` lists them")


def column_named(table: Table, wanted: str) -> str:
    """Raises LogError."""
    return match(wanted, table.columns, f"{table.name} has no field", f"it has {listed(table.columns)}")


def match(wanted: str, known: Collection[str], lacks: str, advice: str) -> str:
    """The name of `known` that is meant. Raises LogError that begins with `lacks` and ends with `advice`."""
    if wanted in known:
        return wanted
    folded = {name.casefold(): name for name in reversed(list(known))}
    if (found := folded.get(wanted.casefold())) is not None:
        return found
    near = get_close_matches(wanted.casefold(), folded, n=1)
    suggestion = f"did you mean {folded[near[0]]!r}? " if near else ""
    raise LogError(f"{lacks} {wanted!r}; {suggestion}{advice}")


def listed(names: Collection[str]) -> str:
    """Roll, Pitch, Yaw; the first dozen of many."""
    shown = [name for name in names if not name.startswith("_")][:_LISTED]
    more = len(names) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")
