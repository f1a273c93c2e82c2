"""The relations of all clocks of a log, fitted once: several analyses ask for them."""

from __future__ import annotations

from weakref import WeakKeyDictionary

from xitl_cli.logs.log import Log
from xitl_cli.logs.timeline.clock_fit import Relation, relate
from xitl_cli.logs.timeline.line import LaidLog
from xitl_cli.logs.timeline.sources import clock_readings

_known: WeakKeyDictionary[Log, tuple[Relation, ...]] = WeakKeyDictionary()


def relations(log: Log) -> tuple[Relation, ...]:
    """Of every pair of clocks that can be fitted. Kept for as long as the log is."""
    if isinstance(log, LaidLog):  # the same rows and stamps
        log = log.inner
    found = _known.get(log)
    if found is None:
        found = tuple(one for readings in clock_readings(log) if (one := relate(readings)) is not None)
        _known[log] = found
    return found
