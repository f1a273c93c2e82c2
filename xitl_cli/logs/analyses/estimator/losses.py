"""What the estimator went without: sensors it timed out, a position, its own health."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.estimator.cores import Core, whole
from xitl_cli.logs.analyses.instants import Instants, inside, length_s, spans_where
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Finding, Severity
from xitl_cli.logs.table import Table
from xitl_cli.logs.text import length_text
from xitl_cli.logs.words.estimator import (
    ABSOLUTE,
    CONSTANT_POSITION,
    DEAD_RECKONING,
    FAULTS,
    GPS_GLITCHING,
    NOT_INITIALISED,
    TIMEOUTS,
    TIMEOUTS_THAT_COUNT,
    bit_names,
)
from xitl_cli.logs.words.heard import heard

_MOST = 20
_JOIN_S = 0.5
_LONG_S = 1.0


def timeouts(core: Core, armed: list[tuple[int, int]], instants: Instants) -> list[Finding]:
    table = core.health
    if table is None or "TS" not in table.columns:
        return []
    flags = whole(table, "TS") & TIMEOUTS_THAT_COUNT
    on = inside(table.stamp_ns, armed)
    found = []
    for bit, name in TIMEOUTS.items():
        spans = spans_where(table.stamp_ns, ((flags >> bit & 1) == 1) & on, _JOIN_S)
        if length_s(spans) < _LONG_S:
            continue
        found.append(
            Finding(
                f"estimator.timeout.{name}",
                Severity.WARNING,
                f"The estimator went without {name} for {length_text(length_s(spans))} while armed, first at "
                f"{instants.text(spans[0][0])}",
                tuple(Evidence(table.name, "TS", begin, end, name) for begin, end in spans[:_MOST]),
                "Look at that sensor: no data, or all of it refused.",
            )
        )
    return found


def faults(core: Core, instants: Instants) -> list[Finding]:
    table = core.health
    if table is None or "FS" not in table.columns:
        return []
    flags = whole(table, "FS")
    begun = np.flatnonzero((flags & NOT_INITIALISED) == 0)
    if not len(begun):
        return []
    flags = flags[begun[0] :]
    rows = np.flatnonzero(flags)
    if not len(rows):
        return []
    stamps = table.stamp_ns[begun[0] :]
    bits = int(np.bitwise_or.reduce(flags[rows]))
    spans = spans_where(stamps, flags != 0, _JOIN_S)
    return [
        Finding(
            "estimator.faults",
            Severity.CRITICAL,
            f"The filter itself was faulty for {length_text(length_s(spans))}, first at "
            f"{instants.text(int(stamps[rows[0]]))}: {', '.join(bit_names(FAULTS, bits))}",
            tuple(Evidence(table.name, "FS", begin, end, f"0x{bits:x}") for begin, end in spans[:_MOST]),
            "Do not trust attitude or position there; look at IMU gaps and clipping, and at what it fused.",
        )
    ]


def lost(log: Log, core: Core | None, armed: list[tuple[int, int]], instants: Instants) -> list[Finding]:
    """Solution status: a position that was there and is not any more, GPS that glitches, in use while armed."""
    table = None if core is None else core.health
    column = "SS"
    if table is None or column not in table.columns:
        table, column = heard(log, "EKF_STATUS_REPORT"), "flags"
    if table is None or column not in table.columns:
        return []
    flags, on = whole(table, column), inside(table.stamp_ns, armed)
    had = np.maximum.accumulate((flags & ABSOLUTE) != 0) if len(flags) else np.zeros(0, dtype=np.bool_)
    lost = had & on & (((flags & ABSOLUTE) == 0) | ((flags & CONSTANT_POSITION) != 0))
    found = []
    if spans := spans_where(table.stamp_ns, lost, _JOIN_S):
        found.append(
            Finding(
                "estimator.position_lost",
                Severity.CRITICAL if length_s(spans) >= _LONG_S else Severity.WARNING,
                f"The estimator had no absolute position for {_lasting(spans)} while armed, first at "
                f"{instants.text(spans[0][0])}",
                _evidence(table.name, column, spans),
                "Look at GNSS (fix, dropouts) and at what was refused just before.",
            )
        )
    if column == "SS":
        found += _status(table, on, flags, instants)
    return found


def _status(table: Table, on: NDArray[np.bool_], flags: NDArray[np.int64], instants: Instants) -> list[Finding]:
    """What the filter says of itself while armed, though it keeps a position."""
    found = []
    if spans := spans_where(table.stamp_ns, on & ((flags & GPS_GLITCHING) != 0), _JOIN_S):
        found.append(
            Finding(
                "estimator.gps_glitch",
                Severity.WARNING if length_s(spans) >= _LONG_S else Severity.NOTICE,
                f"The estimator took GPS for glitching for {_lasting(spans)} while armed, first at "
                f"{instants.text(spans[0][0])}",
                _evidence(table.name, "SS", spans),
                "Compare GPS with the estimate there: a jump, or a drift of the estimate.",
            )
        )
    spans = spans_where(table.stamp_ns, on & ((flags & DEAD_RECKONING) != 0), _JOIN_S)
    if length_s(spans) >= _LONG_S:
        found.append(
            Finding(
                "estimator.dead_reckoning",
                Severity.WARNING,
                f"The estimator was dead reckoning for {_lasting(spans)} while armed, first at "
                f"{instants.text(spans[0][0])}",
                _evidence(table.name, "SS", spans),
                "Look at GNSS there: a dropout, or all of it refused.",
            )
        )
    return found


def _lasting(spans: list[tuple[int, int]]) -> str:
    return length_text(length_s(spans)) if length_s(spans) > 0.0 else f"{len(spans)} samples"


def _evidence(message: str, field: str, spans: list[tuple[int, int]]) -> tuple[Evidence, ...]:
    return tuple(Evidence(message.rpartition(":")[2], field, begin, end) for begin, end in spans[:_MOST])
