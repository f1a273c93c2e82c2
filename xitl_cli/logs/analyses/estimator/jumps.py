"""What a filter does at once: lanes switched, resets of yaw, height and position, sensors given up."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.estimator.cores import Core, whole
from xitl_cli.logs.analyses.events.error_rows import error_rows
from xitl_cli.logs.analyses.instants import Instants, inside, length_s, length_text, spans_where
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Finding, Mark, Severity
from xitl_cli.logs.table import Table
from xitl_cli.logs.words import errors
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
from xitl_cli.logs.words.events import EKF_ALT_RESET, EKF_YAW_RESET
from xitl_cli.logs.words.heard import heard

_JOIN_S = 0.5
_LONG_S = 1.0
_JUMP_M = 1.0
_LONGEST_STEP_S = 1.0
_SAME_NS = 200_000_000
_LATEST_NS = 1 << 62
_MOST = 20


@dataclass(frozen=True, slots=True)
class Jump:
    """size_m: None where it is not logged. source: where it was seen."""

    at_ns: int
    what: str
    size_m: float | None
    source: str


def lane_switches(log: Log, every: list[Core]) -> list[tuple[int, int]]:
    """(stamp, core now in use), after the first; by XKF4.PI, or by ERR 24 where that is not logged."""
    table = every[0].health if every else None
    if table is not None and "PI" in table.columns and len(table):
        lanes = whole(table, "PI")
        rows = np.flatnonzero(np.diff(lanes) != 0) + 1
        return list(zip(table.stamp_ns[rows].tolist(), lanes[rows].tolist(), strict=True))
    return [(at_ns, code) for at_ns, subsystem, code in error_rows(log) if subsystem == errors.EKF_PRIMARY]


def primary_core(every: list[Core]) -> int:
    """The core that was in use longest; the first one where that is not logged."""
    table = every[0].health if every else None
    if table is None or "PI" not in table.columns or not len(table):
        return every[0].number if every else 0
    lanes = whole(table, "PI")
    known = lanes[np.isin(lanes, [core.number for core in every])]
    return int(np.bincount(known).argmax()) if len(known) else every[0].number


def jumps(log: Log, core: Core | None) -> list[Jump]:
    """Resets that were logged, and steps of the position that its velocity does not explain, in the order of time."""
    found = _logged(log)
    if core is not None:
        found += _offsets(core)
        told = [(one.at_ns - _SAME_NS, one.at_ns + _SAME_NS) for one in found if abs(one.at_ns) < _LATEST_NS]
        steps = _steps(core)
        known = inside(np.array([one.at_ns for one in steps], dtype=np.int64), told)
        found += [one for one, twice in zip(steps, known.tolist(), strict=True) if not twice]
    return sorted(found, key=lambda jump: jump.at_ns)


def findings(
    log: Log, every: list[Core], core: Core | None, armed: list[tuple[int, int]], instants: Instants
) -> list[Finding]:
    found = [*_lanes(log, every, armed, instants), *_jumped(jumps(log, core), armed, instants)]
    if core is not None:
        found += [*_timeouts(core, armed, instants), *_faults(core, instants)]
    return [*found, *_lost(log, core, armed, instants)]


def marks(log: Log, every: list[Core], core: Core | None) -> tuple[Mark, ...]:
    found = [Mark(at_ns, f"lane {lane}", None, Severity.WARNING) for at_ns, lane in lane_switches(log, every)]
    found += [Mark(jump.at_ns, jump.what, None, Severity.NOTICE) for jump in jumps(log, core)]
    return tuple(sorted(found, key=lambda mark: mark.at_ns)[:200])


def _logged(log: Log) -> list[Jump]:
    table = log.tables.get("EV")
    if table is None or "Id" not in table.columns:
        return []
    names = {EKF_ALT_RESET: "height reset", EKF_YAW_RESET: "yaw reset"}
    numbers = whole(table, "Id")
    return [
        Jump(at_ns, names[number], None, "EV.Id")
        for at_ns, number in zip(table.stamp_ns.tolist(), numbers.tolist(), strict=True)
        if number in names
    ]


def _offsets(core: Core) -> list[Jump]:
    """XKF4.OFN and OFE hold the last reset of the position."""
    table = core.health
    if table is None or not {"OFN", "OFE"} <= set(table.columns):
        return []
    north, east = (np.asarray(table.values(name), dtype=np.float64) for name in ("OFN", "OFE"))
    rows = np.flatnonzero((north[1:] != north[:-1]) | (east[1:] != east[:-1])) + 1
    return [
        Jump(int(table.stamp_ns[row]), "position reset", math.hypot(north[row], east[row]), f"{table.name}.OFN")
        for row in rows.tolist()
        if math.isfinite(north[row]) and math.isfinite(east[row])
    ]


def _steps(core: Core) -> list[Jump]:
    table = core.solution
    if table is None or not {"PN", "PE", "VN", "VE"} <= set(table.columns) or len(table) < 2:
        return []
    columns = [np.asarray(table.values(name), dtype=np.float64) for name in ("PN", "PE", "VN", "VE")]
    north, east, north_mps, east_mps = columns
    step_s = np.diff(table.stamp_ns) * 1e-9
    was = (north[:-1] != 0.0) | (east[:-1] != 0.0)
    with np.errstate(invalid="ignore", over="ignore"):
        fast_mps = np.hypot(
            np.maximum(np.abs(north_mps[1:]), np.abs(north_mps[:-1])),
            np.maximum(np.abs(east_mps[1:]), np.abs(east_mps[:-1])),
        )
        size_m = np.hypot(np.diff(north), np.diff(east)) - fast_mps * step_s
        rows = np.flatnonzero((size_m > _JUMP_M) & (step_s > 0.0) & (step_s < _LONGEST_STEP_S) & was)
    return [
        Jump(int(table.stamp_ns[row + 1]), "position step", float(size_m[row]), f"{table.name}.PN")
        for row in rows.tolist()
    ]


def _lanes(log: Log, every: list[Core], armed: list[tuple[int, int]], instants: Instants) -> list[Finding]:
    switches = lane_switches(log, every)
    while_armed = [switch for switch in switches if inside(np.array([switch[0]]), armed)[0]]
    if not while_armed:
        return []
    at_ns, lane = while_armed[0]
    times = "once" if len(while_armed) == 1 else f"{len(while_armed)} times"
    return [
        Finding(
            "estimator.lane_switch",
            Severity.WARNING,
            f"The estimator switched its core {times} while armed, first to core {lane} at {instants.text(at_ns)}",
            tuple(Evidence("XKF4", "PI", when, value=str(to)) for when, to in while_armed[:_MOST]),
            "Look at the test ratios of the core that was left, and at the IMU it used.",
        )
    ]


def _jumped(every: list[Jump], armed: list[tuple[int, int]], instants: Instants) -> list[Finding]:
    found = []
    for what in dict.fromkeys(jump.what for jump in every):
        these = [jump for jump in every if jump.what == what and inside(np.array([jump.at_ns]), armed)[0]]
        if not these:
            continue
        sizes = [jump.size_m for jump in these if jump.size_m is not None]
        largest = f", by up to {max(sizes):.2f} m" if sizes else ""
        times = "once" if len(these) == 1 else f"{len(these)} times"
        found.append(
            Finding(
                f"estimator.{what.replace(' ', '_')}",
                Severity.WARNING if max(sizes, default=0.0) >= _JUMP_M else Severity.NOTICE,
                f"The estimator made a {what} {times} while armed{largest}, first at {instants.text(these[0].at_ns)}",
                tuple(
                    Evidence(
                        jump.source.partition(".")[0],
                        jump.source.partition(".")[2],
                        jump.at_ns,
                        value=None if jump.size_m is None else f"{jump.size_m:.2f} m",
                    )
                    for jump in these[:_MOST]
                ),
                "Controllers saw a step there; look for what the estimator refused before it.",
            )
        )
    return found


def _timeouts(core: Core, armed: list[tuple[int, int]], instants: Instants) -> list[Finding]:
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


def _faults(core: Core, instants: Instants) -> list[Finding]:
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


def _lost(log: Log, core: Core | None, armed: list[tuple[int, int]], instants: Instants) -> list[Finding]:
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
