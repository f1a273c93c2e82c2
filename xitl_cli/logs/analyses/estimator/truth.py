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
_AROUND = 2


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
        level_m = _lasting(np.hypot(position.values[:, 0], position.values[:, 1]))
        height_m = _lasting(np.abs(position.values[:, 2]))
        found += [
            Fact("position_error_rms_m", "Position against truth, RMS", number(_rms(level_m)), "m"),
            Fact("position_error_max_m", "Position against truth, largest", number(level_m.max()), "m"),
            Fact("height_error_rms_m", "Height against truth, RMS", number(_rms(height_m)), "m"),
        ]
    if yaw is not None and len(yaw.values):
        yaw_deg = _lasting(np.abs(yaw.values))
        found += [
            Fact("yaw_error_rms_deg", "Yaw against truth, RMS", number(_rms(yaw_deg)), "deg"),
            Fact("yaw_error_max_deg", "Yaw against truth, largest", number(yaw_deg.max()), "deg"),
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
    size = _lasting(size)
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


def _lasting(size: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) the median of each with its neighbours: a row or two that are damaged are not what the estimate did."""
    width = 2 * _AROUND + 1
    if len(size) < width:
        return size
    around = np.lib.stride_tricks.sliding_window_view(np.pad(size, _AROUND, mode="edge"), width)
    found: NDArray[np.float64] = np.median(around, axis=1)
    return found


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))
