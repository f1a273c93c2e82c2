"""Cores against each other, and how evenly they were fed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.estimator.cores import Core
from xitl_cli.logs.analyses.instants import Instants, inside, number
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Severity
from xitl_cli.logs.table import Table

_APART_M = 5.0
_APART_DEG = 10.0
_STEPS = (
    ("IMUMin", "imu_step_min_ms", "IMU step, least", np.min),
    ("IMUMax", "imu_step_max_ms", "IMU step, longest", np.max),
    ("EKFMin", "ekf_step_min_ms", "Filter step, least", np.min),
    ("EKFMax", "ekf_step_max_ms", "Filter step, longest", np.max),
)


def facts(every: list[Core], armed: list[tuple[int, int]]) -> list[Fact]:
    """How far the first two cores were apart while armed."""
    found = _apart(every, armed)
    if found is None:
        return []
    _, metres, degrees = found
    return [
        Fact("cores_apart_max_m", "Cores apart in position, largest", number(metres.max()), "m"),
        Fact("cores_apart_max_deg", "Cores apart in yaw, largest", number(degrees.max(), 2), "deg"),
    ]


def findings(every: list[Core], armed: list[tuple[int, int]], two_worlds: bool, instants: Instants) -> list[Finding]:
    found = _apart(every, armed)
    if found is None:
        return []
    stamps, metres, degrees = found
    result = []
    for size, limit, unit, what in ((metres, _APART_M, "m", "position"), (degrees, _APART_DEG, "deg", "yaw")):
        worst = int(np.argmax(size))
        if size[worst] < limit:
            continue
        at_ns = int(stamps[worst])
        result.append(
            Finding(
                f"estimator.cores_apart.{what}",
                Severity.NOTICE if two_worlds else Severity.WARNING,
                f"Cores {every[0].number} and {every[1].number} were up to {size[worst]:.1f} {unit} apart in {what} "
                f"while armed, at {instants.text(at_ns)}"
                + (": their IMUs are of two worlds, one fed from outside, one simulated" if two_worlds else ""),
                (Evidence(every[0].solution.name if every[0].solution else "XKF1", None, at_ns),),
                "Compare the IMUs they use: a bias or a gap of one of them pulls its core away.",
            )
        )
    return result


def timing(log: Log) -> list[Fact]:
    """XKT, NKT: steps of the IMU and of the filter; of all cores, with the windows of the start left out."""
    table = log.tables.get("XKT") or log.tables.get("NKT")
    if table is None:
        return []
    counted = np.ones(len(table), dtype=np.bool_)
    if "Cnt" in table.columns:
        counts = np.asarray(table.values("Cnt", raw=True))
        counted = counts > 0.5 * np.median(counts)
    rows = np.flatnonzero(counted)
    found = []
    for column, key, label, pick in _STEPS:
        if column in table.columns and len(rows):
            found.append(Fact(key, label, number(1e3 * float(pick(table.values(column, rows)))), "ms"))
    return found


def _apart(
    every: list[Core], armed: list[tuple[int, int]]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]] | None:
    """Stamps, metres and degrees of the rows that the first two cores share."""
    tables = [core.solution for core in every[:2] if core.solution is not None]
    if len(tables) < 2 or not armed:
        return None
    first, second = tables
    names = ("PN", "PE", "Yaw")
    if not all(set(names) <= set(table.columns) for table in tables):
        return None
    stamps, one, other = np.intersect1d(first.stamp_ns, second.stamp_ns, return_indices=True)
    on = inside(stamps, armed)
    if not on.any():
        return None
    left, right = _columns(first, one[on], names), _columns(second, other[on], names)
    difference = left - right
    good = np.isfinite(difference).all(axis=1)
    if not good.any():
        return None
    degrees = np.abs(np.mod(difference[good, 2] + 180.0, 360.0) - 180.0)
    return stamps[on][good], np.hypot(difference[good, 0], difference[good, 1]), degrees


def _columns(table: Table, rows: NDArray[np.intp], names: tuple[str, ...]) -> NDArray[np.float64]:
    return np.stack([np.asarray(table.values(name, rows), dtype=np.float64) for name in names], axis=1)
