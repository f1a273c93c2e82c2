"""Errors of an accelerometer that begin suddenly, from the velocity of a satellite receiver.

The estimate hides a bias, because it tilts until the force points down. The gyroscope does not. It turns the measured
force of a window into the axes of the estimate at the middle of the window. There, the integral of the force departs
from the velocity of the receiver by four terms: a line and a parabola (errors of the attitude), the delay of the
receiver, the motion of its antenna about the sensor, and the bias if one begins.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import euler_to_quat, quat_to_matrix
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Finding
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.signals import pitch, roll, yaw
from xitl_cli.logs.signals.receivers import FIX_3D, gnss_receivers, injected_receivers
from xitl_cli.logs.signals.sensors import STANDARD_GRAVITY_MPS2, InertialUnit, inertial_units, injected_units
from xitl_cli.logs.signals.series import Series, make_series
from xitl_cli.logs.signals.spans import find_holds
from xitl_cli.plugins.logs.analyses.sensor_departures import SensorStep, paired_steps, rotations

LEAST_BIAS_MPS2 = 0.3
"""Least change of a bias. In a window, a gyroscope that is off by 0.1 deg/s causes less than half of it."""
_CELL_S = 0.2
_HALF = 60
"""Cells of half a window."""
_STRIDE = 5
_MOST_CELLS = 40_000
_MARGIN = 10
"""Least cells of a window before and after an onset."""
_NEAR = 10
"""Cells within which two onsets are not told apart."""
_CLEARLY = 1.2
"""Ratio of gains from which another onset explains a window better."""
_LEAST_GAIN = 2.5
"""Least ratio of the squared residuals without a bias, and with a step of the velocity, to those with the bias."""
_MOST_GAP_S = 1.0


def accelerometer_findings(log: Log, clock: LogClock) -> Iterator[Finding]:
    units = [unit for unit in inertial_units(log) or injected_units(log) if unit.accel_mps2 is not None]
    receivers = gnss_receivers(log) or injected_receivers(log)
    angles = [read(log) for read in (roll, pitch, yaw)]
    known = [series for series in angles if series is not None]
    if not units or not receivers or len(known) < len(angles):
        return
    fixed = receivers[0].fix >= FIX_3D
    velocity = make_series(receivers[0].stamp_ns[fixed], receivers[0].vel_ned_mps[fixed], "m/s", receivers[0].name)
    end_ns = log.span_ns[1] if log.span_ns else 0
    for step in () if velocity is None else accelerometer_steps(units[0], known, velocity):
        axis = int(np.argmax(np.abs(step.size)))
        size = f"{step.size[axis]:+.2f} m/s²"
        fields = units[0].accel_fields
        yield Finding.warning(
            "sensors.accel_bias",
            f"{units[0].name}: the accelerometer is off by {size} on {'xyz'[axis]} {step.text(clock)}, by the velocity "
            f"of {receivers[0].name}",
            (
                Evidence(
                    units[0].table.name, fields[axis] if len(fields) == 3 else f"{fields[0]}[{axis}]",
                    step.from_ns, step.until_ns or end_ns, size,
                ),
            ),
            "Calibrate it; a bias that begins at once is a fault of the sensor, its mounting or its supply. The "
            "estimated attitude tilts with it.",
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Cells:
    """Means over `_CELL_S`."""

    stamp_ns: Stamps
    """(N,) middle of each cell."""
    force_mps2: Floats
    """(N, 3) in the axes of the body at the start, by the gyroscope; NaN if unknown."""
    turned: Floats
    """(N, 3, 3) rotation from body axes to those axes."""
    attitude: Floats
    """(N, 3, 3) rotation from body axes to north, east, down, by the estimate."""
    vel_ned_mps: Floats
    """(N, 3) at the end of each cell, NaN in a gap and while the receiver repeats one value."""


def accelerometer_steps(unit: InertialUnit, angles_deg: list[Series], velocity: Series) -> list[SensorStep]:
    """Steps of the bias (3,) in m/s², body axes. angles_deg: roll, pitch, yaw. velocity: (N, 3) north, east, down."""
    cells = _cells(unit, angles_deg, velocity)
    if cells is None:
        return []
    many = len(cells.stamp_ns) - _HALF
    fits = {at: fit for at in range(_HALF, many, _STRIDE) if (fit := _fitted(cells, at)) is not None}
    rows: dict[int, Floats] = {}
    # The clearest first: windows that contain the same onset belong to it.
    while fits:
        coarse = max(fits, key=lambda at: fits[at].gain)
        fine = [fit for at in range(coarse - _STRIDE, coarse + _STRIDE + 1) if (fit := _fitted(cells, at)) is not None]
        best = max(fine, key=lambda fit: fit.gain)
        if best.gain < _LEAST_GAIN:
            break
        elsewhere = _begins_elsewhere(cells, best)
        if best.sound and not elsewhere:
            rows[best.at] = best.bias_mps2
        near = _NEAR if elsewhere else _HALF
        fits = {at: fit for at, fit in fits.items() if abs(at - coarse) > near}
    order = sorted(rows)
    return paired_steps([int(cells.stamp_ns[at]) for at in order], [rows[at] for at in order])


def _cells(unit: InertialUnit, angles_deg: list[Series], velocity: Series) -> _Cells | None:
    """None if the sources do not cover a common time."""
    if unit.gyro_radps is None or unit.accel_mps2 is None or (turns := rotations(unit)) is None:
        return None
    good = np.isfinite(unit.gyro_radps).all(axis=1)
    force = np.einsum("nij,nj->ni", turns.matrices, unit.accel_mps2[good])
    sources = [turns.stamp_ns, velocity.stamp_ns, *(series.stamp_ns for series in angles_deg)]
    if len(velocity.stamp_ns) < 2:
        return None
    begin, end = max(int(stamps[0]) for stamps in sources), min(int(stamps[-1]) for stamps in sources)
    step_ns = round(_CELL_S * 1e9)
    many = (end - begin) // step_ns
    if not 4 * _HALF <= many <= _MOST_CELLS:
        return None
    place = (turns.stamp_ns - begin) // step_ns
    inner = (place >= 0) & (place < many) & np.isfinite(force).all(axis=1)
    for hold in find_holds(
        unit.accel_mps2[good], 1e-9 * float(turns.stamp_ns[-1] - turns.stamp_ns[0]) / len(turns.stamp_ns)
    ).holds:
        inner[hold.first : hold.last + 1] = False
    count = np.bincount(place[inner], minlength=many)
    enough = count > 0.7 * np.median(count)
    sums = np.stack([np.bincount(place[inner], force[inner, axis], many) for axis in range(3)], axis=1)
    middle = begin + step_ns * np.arange(many) + step_ns // 2
    euler_rad = np.radians(np.stack([series.interpolated(middle) for series in angles_deg], axis=1))
    after = np.searchsorted(velocity.stamp_ns, middle).clip(1, len(velocity.stamp_ns) - 1)
    gap_s = (velocity.stamp_ns[after] - velocity.stamp_ns[after - 1]) * 1e-9
    vel_ned_mps = velocity.interpolated(middle + step_ns // 2)
    vel_ned_mps[gap_s > _MOST_GAP_S] = np.nan
    for hold in find_holds(velocity.values, float(np.median(np.diff(velocity.stamp_ns))) * 1e-9).holds:
        first_ns, last_ns = (int(velocity.stamp_ns[row]) for row in (hold.first, hold.last))
        vel_ned_mps[(middle + step_ns // 2 > first_ns) & (middle - step_ns // 2 <= last_ns + step_ns)] = np.nan
    return _Cells(
        middle,
        np.where(enough[:, None], sums / np.maximum(count, 1)[:, None], np.nan),
        turns.matrices[np.searchsorted(turns.stamp_ns, middle).clip(0, len(turns.stamp_ns) - 1)],
        quat_to_matrix(euler_to_quat(euler_rad)),
        vel_ned_mps,
    )


@dataclass(frozen=True, slots=True)
class _Fit:
    """A bias that begins at a cell."""

    at: int
    bias_mps2: Floats
    """(3,) body axes."""
    gain: float
    """Squared residuals without it, in units of those with it."""
    steps: float
    """Squared residuals with a step of the velocity instead, in the same units."""

    @property
    def sound(self) -> bool:
        return self.steps > _LEAST_GAIN and float(np.linalg.norm(self.bias_mps2)) > LEAST_BIAS_MPS2


def _begins_elsewhere(cells: _Cells, fit: _Fit) -> bool:
    """Whether a bias with another onset explains the window better.

    In a turn, errors of the attitude by a bias of one axis look like an earlier or later bias of another axis.
    """
    onsets = range(-_HALF + _MARGIN, _HALF - _MARGIN + 1, _STRIDE)
    others = [_fitted(cells, fit.at, onset) for onset in onsets if abs(onset) > _NEAR]
    return any(other.gain > _CLEARLY * fit.gain for other in others if other is not None)


def _fitted(cells: _Cells, at: int, onset: int = 0) -> _Fit | None:
    """Fit of errors of the attitude and the receiver, of a bias in the whole window, and of one from `onset` on.

    at: cell in the middle of the window. onset: cells after it. None if a part of the window is unknown.
    """
    rows = slice(at - _HALF, at + _HALF)
    if at < _HALF or at + _HALF > len(cells.stamp_ns):
        return None
    to_ned = cells.attitude[at] @ cells.turned[at].T
    accel = cells.force_mps2[rows] @ to_ned.T + [0.0, 0.0, STANDARD_GRAVITY_MPS2]
    apart = (np.cumsum(accel, axis=0) * _CELL_S - cells.vel_ned_mps[rows]).reshape(-1)
    if not np.isfinite(apart).all():
        return None
    line = (np.arange(2 * _HALF) - _HALF + 0.5) / _HALF
    after = (line > onset / _HALF)[:, None, None]
    axes = to_ned @ cells.turned[rows]
    # The receiver reports an earlier velocity, which is that of its antenna.
    delay = (accel - accel.mean(axis=0)).reshape(-1, 1)
    antenna = -np.gradient(axes, _CELL_S, axis=0).reshape(-1, 3)
    whole, bias = (np.cumsum(part, axis=0).reshape(-1, 3) * _CELL_S for part in (axes, np.where(after, axes, 0.0)))
    attitude = np.kron(np.stack([np.ones(2 * _HALF), line, line**2], axis=1), np.eye(3))
    usual = np.hstack([attitude, whole, delay, antenna])
    step = np.where(after, np.eye(3), 0.0).reshape(-1, 3)
    squares = []
    for columns in (usual, np.hstack([usual, step]), np.hstack([usual, bias])):
        fitted = np.linalg.lstsq(columns, apart, rcond=None)[0]
        left = apart - columns @ fitted
        squares.append(float(left @ left))
    least = max(squares[-1], 1e-9)
    return _Fit(at + onset, fitted[-3:], squares[0] / least, squares[1] / least)
