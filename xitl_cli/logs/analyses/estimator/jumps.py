"""What a filter does at once: lanes switched, resets of yaw, height and position, sensors given up."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.analyses.estimator.cores import Core, whole
from xitl_cli.logs.analyses.estimator.losses import faults, lost, timeouts
from xitl_cli.logs.analyses.events.error_rows import error_rows
from xitl_cli.logs.analyses.instants import Instants, inside
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Finding, Mark, Severity
from xitl_cli.logs.words import errors
from xitl_cli.logs.words.events import EKF_ALT_RESET, EKF_YAW_RESET

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
        found += [*timeouts(core, armed, instants), *faults(core, instants)]
    return [*found, *lost(log, core, armed, instants)]


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
        first = instants.text(these[0].at_ns)
        if len(these) == 1:
            size = f" of {sizes[0]:.2f} m" if sizes else ""
            sentence = f"The estimator made a {what}{size} while armed, at {first}"
        else:
            size = f", by up to {max(sizes):.2f} m" if sizes else ""
            sentence = f"The estimator made a {what} {len(these)} times while armed{size}, first at {first}"
        found.append(
            Finding(
                f"estimator.{what.replace(' ', '_')}",
                Severity.WARNING if max(sizes, default=0.0) >= _JUMP_M else Severity.NOTICE,
                sentence,
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
