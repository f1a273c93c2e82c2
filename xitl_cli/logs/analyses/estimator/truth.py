"""The estimate against what a simulator knows: SIM of ArduPilot's own, /truth of ours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_core.geodesy import LocalFrame
from xitl_cli.logs import signals
from xitl_cli.logs.analyses.instants import Instants, inside, number
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Plot, Severity, Trace

_POSITION_M = (1.0, 3.0)
_YAW_DEG = (5.0, 10.0)
"""Root mean square from which an error is worth a notice, and a warning."""
_FARTHEST_M = 1e5
_ANOTHER_M = 20.0  # between a receiver and the place it is at
_MOVING_MPS = 0.5
_HALF_NS = 500_000_000


@dataclass(frozen=True, slots=True)
class Error:
    """Estimate less truth at the estimate's instants. values: (N,) or (N, k)."""

    stamp_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    source: str
    truth: str

    def while_in(self, spans: list[tuple[int, int]]) -> Error:
        """Only of these spans; all of it when there are none."""
        if not spans:
            return self
        rows = inside(self.stamp_ns, spans)
        return Error(self.stamp_ns[rows], self.values[rows], self.source, self.truth)


def of_another_world(log: Log) -> float | None:
    """Largest distance (m) from where SIM says the vehicle was to where its receiver was, when they moved differently.

    Sensors fed in from outside (external AHRS, HIL) leave ArduPilot's own simulated vehicle behind. A receiver that is
    only off, as a fault of it would be, still moves with the vehicle.
    """
    truth, table = signals.position_geodetic(log, "truth"), log.tables.get("GPS")
    if truth is None or truth.source != "SIM" or table is None:
        return None
    if not {"Lat", "Lng", "Status", "Spd", "GCrs"} <= set(table.columns):
        return None
    rows = np.flatnonzero(np.asarray(table.values("Status", raw=True)) >= 3)
    stamps = table.stamp_ns[rows]
    there, before, after = (truth.at(stamps + shift_ns) for shift_ns in (0, -_HALF_NS, _HALF_NS))
    course_deg, speed_mps = (np.asarray(table.values(name, rows), dtype=np.float64) for name in ("GCrs", "Spd"))
    known = np.isfinite(there + before + after).all(axis=1) & np.isfinite(course_deg)
    known &= np.isfinite(speed_mps) & (speed_mps > _MOVING_MPS)
    if not known.any():
        return None
    frame, level_m = LocalFrame(*map(float, truth.values[0])), np.zeros(int(known.sum()))
    at, behind, ahead = (frame.ned(each[known, 0], each[known, 1], level_m)[:, :2] for each in (there, before, after))
    fixes = frame.ned(table.values("Lat", rows[known]), table.values("Lng", rows[known]), level_m)[:, :2]
    true_mps = (ahead - behind) / (2e-9 * _HALF_NS)
    course = np.radians(course_deg[known])
    fast_mps = speed_mps[known, None] * np.stack([np.cos(course), np.sin(course)], axis=1)
    unlike = np.median(np.linalg.norm(fast_mps - true_mps, axis=1) / speed_mps[known])
    apart_m = float(np.linalg.norm(fixes - at, axis=1).max())
    return apart_m if unlike > 0.5 and apart_m > _ANOTHER_M else None


def position_error(log: Log) -> Error | None:
    """(N, 3) north, east, down in m."""
    local, true = signals.position_ned(log), signals.position_ned(log, "truth")
    if local is not None and true is not None and local.origin == true.origin and log.format == "mcap":
        return _difference(local.path, true.path, local.path.values - true.path.at(local.path.stamp_ns))
    estimate, truth = signals.position_geodetic(log), signals.position_geodetic(log, "truth")
    if estimate is None or truth is None:
        return None
    frame = LocalFrame(*map(float, truth.values[0]))
    there = truth.at(estimate.stamp_ns)
    known = np.isfinite(there).all(axis=1)
    values = np.full((len(there), 3), np.nan)
    values[known] = frame.ned(*estimate.values[known].T) - frame.ned(*there[known].T)
    return _difference(estimate, truth, values)


def yaw_error(log: Log) -> Error | None:
    """(N,) deg, between -180 and 180."""
    estimate, truth = signals.yaw(log), signals.yaw(log, "truth")
    if estimate is None or truth is None:
        return None
    values = np.mod(estimate.values - truth.at(estimate.stamp_ns) + 180.0, 360.0) - 180.0
    return _difference(estimate, truth, values)


def facts(position: Error | None, yaw: Error | None) -> list[Fact]:
    found = []
    if position is not None and len(position.values):
        horizontal = np.hypot(position.values[:, 0], position.values[:, 1])
        found += [
            Fact("position_error_rms_m", "Position against truth, RMS", number(_rms(horizontal)), "m"),
            Fact("position_error_max_m", "Position against truth, largest", number(horizontal.max()), "m"),
            Fact("height_error_rms_m", "Height against truth, RMS", number(_rms(position.values[:, 2])), "m"),
        ]
    if yaw is not None and len(yaw.values):
        found += [
            Fact("yaw_error_rms_deg", "Yaw against truth, RMS", number(_rms(yaw.values)), "deg"),
            Fact("yaw_error_max_deg", "Yaw against truth, largest", number(np.abs(yaw.values).max()), "deg"),
        ]
    return found


def findings(position: Error | None, yaw: Error | None, instants: Instants) -> list[Finding]:
    found = []
    if position is not None and len(position.values):
        horizontal = np.hypot(position.values[:, 0], position.values[:, 1])
        step = "See in the plot when it began: a jump is a reset or a refused fix, a slope a bias."
        found += _off("position", "m", horizontal, _POSITION_M, position, step, instants)
    if yaw is not None and len(yaw.values):
        step = "Compare compass and gyroscope: an offset is declination or calibration, a slope a bias."
        found += _off("yaw", "deg", np.abs(yaw.values), _YAW_DEG, yaw, step, instants)
    return found


def plots(position: Error | None, yaw: Error | None) -> list[Plot]:
    found = []
    if position is not None and len(position.values):
        names = ("north", "east", "down")
        traces = tuple(Trace(name, position.stamp_ns, position.values[:, axis]) for axis, name in enumerate(names))
        found.append(Plot("position_error", "Position, estimate less truth", "error (m)", traces))
    if yaw is not None and len(yaw.values):
        trace = Trace("yaw", yaw.stamp_ns, yaw.values)
        found.append(Plot("yaw_error", "Yaw, estimate less truth", "error (deg)", (trace,)))
    return found


def _difference(estimate: signals.Series, truth: signals.Series, values: NDArray[np.float64]) -> Error:
    good = np.isfinite(values).reshape(len(values), -1).all(axis=1)
    good &= (np.abs(values) < _FARTHEST_M).reshape(len(values), -1).all(axis=1)
    return Error(estimate.stamp_ns[good], values[good], estimate.source, truth.source)


def _off(
    what: str,
    unit: str,
    size: NDArray[np.float64],
    limits: tuple[float, float],
    error: Error,
    step: str,
    instants: Instants,
) -> list[Finding]:
    rms = _rms(size)
    if rms < limits[0]:
        return []
    worst = int(np.argmax(size))
    at_ns = int(error.stamp_ns[worst])
    message, _, field = error.source.partition(".")
    return [
        Finding(
            f"estimator.{what}_error",
            Severity.WARNING if rms >= limits[1] else Severity.NOTICE,
            f"The estimated {what} was off the truth by {rms:.2f} {unit} RMS and up to {size[worst]:.2f} {unit}, at "
            f"{instants.text(at_ns)}",
            (Evidence(message, field or None, at_ns, value=f"{size[worst]:.2f} {unit}"), Evidence(error.truth)),
            step,
        )
    ]


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))
