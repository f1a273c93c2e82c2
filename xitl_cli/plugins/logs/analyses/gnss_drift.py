"""Drift of a GNSS position against the velocity of the same receiver, and which of the two is wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.geodesy import LocalFrame
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.sections import Evidence, Finding
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.signals.receivers import GnssReceiver
from xitl_cli.logs.signals.spans import find_holds, join_runs, runs

DRIFT_MPS = 0.12
"""Least drift that exceeds a receiver's own error (0.5 m that changes over a minute) in one window."""
WINDOW_S = 15.0
LEAST_FIXES = 20
MOST_GAP_S = 1.0
"""Largest gap between two fixes of one stretch: the mean velocity determines the path of a boat that turns in this
time."""
JUMP_M = 3.0
"""Least step between two fixes, beyond the velocity, that is a jump."""
_STEADY = 10.0
"""Least ratio of a drift's way to the residuals about its straight line. The random error of a receiver with reflected
signals has ratios up to 8.3 (150 errors of 5 m that change over 8 s)."""
_LEAST_JUMP_MPS, _JUMP_SHARE, _JUMP_SIGMAS, _JUMP_REACH_NS = 0.5, 0.6, 6.0, 1_500_000_000


@dataclass(frozen=True, slots=True)
class GnssDrift:
    """A span of the log's time in which the position moves at another velocity than the receiver reports."""

    from_ns: int
    until_ns: int
    speed_mps: float
    bearing_deg: float


def wrong_velocity(receiver: GnssReceiver, drift: GnssDrift, clock: LogClock) -> Finding:
    """Return the finding for a time in which the velocity was off, and not the position; see `velocity_jumped`."""
    size = f"{drift.speed_mps:.2f} m/s"
    return Finding.warning(
        "gnss.velocity_off",
        f"From {clock.text(drift.from_ns)} to {clock.text(drift.until_ns)} the velocity of {receiver.name} is off by "
        f"{size} towards {(drift.bearing_deg + 180.0) % 360.0:.0f} degrees: it changed at once, and the position did "
        "not follow",
        (Evidence(receiver.message, receiver.fields.get("speed"), drift.from_ns, drift.until_ns, size),),
        "Do not trust the velocity in this time; check the receiver's dynamic model and its driver.",
    )


def gnss_drifts(receiver: GnssReceiver) -> list[GnssDrift]:
    """Times in which the position moves at another velocity than the receiver reports, by the slope of the difference.

    Each stretch without a gap and without a jump is judged alone, because the velocity does not determine the path
    across a gap, and a position that jumps does not drift. A repeated position is a gap too: the receiver did not
    measure then. A drift that the velocity shares cannot be detected.
    """
    rows = _measured_rows(receiver)
    if len(rows) < LEAST_FIXES:
        return []
    time_s = (receiver.sample_ns[rows] - receiver.sample_ns[rows[0]]) * 1e-9
    steps_s = np.diff(time_s)
    if (steps_s <= 0).any():
        return []
    lat_deg, lon_deg = receiver.lat_deg[rows], receiver.lon_deg[rows]
    frame = LocalFrame(float(lat_deg[0]), float(lon_deg[0]), 0.0)
    place_m = frame.ned(lat_deg, lon_deg, np.zeros(len(rows)))[:, :2]
    vel_ne_mps = receiver.vel_ned_mps[rows, :2]
    strayed_m = np.diff(place_m, axis=0) - 0.5 * (vel_ne_mps[1:] + vel_ne_mps[:-1]) * steps_s[:, None]
    apart_m = np.concatenate([np.zeros((1, 2)), np.cumsum(strayed_m, axis=0)])
    broken = np.flatnonzero((steps_s > MOST_GAP_S) | (np.linalg.norm(strayed_m, axis=1) > JUMP_M))
    return [
        drift
        for stretch in np.split(np.arange(len(rows)), broken + 1)
        if len(stretch) >= LEAST_FIXES
        for drift in _drifts(receiver.stamp_ns[rows[stretch]], time_s[stretch], apart_m[stretch])
    ]


def _measured_rows(receiver: GnssReceiver) -> NDArray[np.intp]:
    """Rows with a fix, a position and a velocity, of each repeated position only the first."""
    known = np.isfinite(receiver.lat_deg + receiver.lon_deg) & np.isfinite(receiver.vel_ned_mps[:, :2]).all(axis=1)
    rows = np.flatnonzero((receiver.fix >= 3) & known)
    if len(rows) < 2:
        return rows
    period_s = float(np.median(np.diff(receiver.sample_ns[rows]))) * 1e-9
    measured = np.ones(len(rows), dtype=np.bool_)
    place_deg = np.stack([receiver.lat_deg[rows], receiver.lon_deg[rows]], axis=1)
    for hold in find_holds(place_deg, max(period_s, 1e-3), shortest_s=MOST_GAP_S).holds:
        measured[hold.first + 1 : hold.last + 1] = False
    return rows[measured]


def _drifts(stamp_ns: Stamps, time_s: Floats, apart_m: Floats) -> Iterator[GnssDrift]:
    """Drifts within rows without a gap. apart_m: (N, 2) way of the positions beyond that of the velocities."""
    ends = np.searchsorted(time_s, time_s + WINDOW_S)
    whole = ends < len(time_s)
    firsts, ends = np.flatnonzero(whole), ends[whole]
    slope = _slopes(time_s, apart_m, firsts, ends)
    for begin, after in join_runs(runs(np.linalg.norm(slope, axis=1) > DRIFT_MPS), 25):
        first, last = int(firsts[begin]), int(ends[after - 1])
        if (drift := _fitted_drift(stamp_ns, time_s, apart_m, first, last)) is not None:
            yield drift


def _slope(time_s: Floats, values: Floats) -> Floats:
    centred = time_s - time_s.mean()
    slope: Floats = centred @ (values - values.mean(axis=0)) / (centred @ centred)
    return slope


_WINDOWS_AT_ONCE = 1024
"""Windows whose sums begin at the same row: they are near each other, so that the sums stay exact."""


def _slopes(time_s: Floats, values: Floats, firsts: NDArray[np.intp], ends: NDArray[np.intp]) -> Floats:
    """(W, 2) slope of the values (N, 2) in each window of rows, by least squares. firsts, ends: (W,) rising."""
    slopes = np.empty((len(firsts), 2))
    for at in range(0, len(firsts), _WINDOWS_AT_ONCE):
        begin, after = firsts[at : at + _WINDOWS_AT_ONCE], ends[at : at + _WINDOWS_AT_ONCE]
        rows = slice(int(begin[0]), int(after[-1]))
        time = time_s[rows] - time_s[(rows.start + rows.stop) // 2]
        apart = (values[rows] - values[rows.start]).T
        summed = np.zeros((6, len(time) + 1))
        np.cumsum([time, time**2, *apart, *(time * apart)], axis=1, out=summed[:, 1:])
        window = summed[:, after - rows.start] - summed[:, begin - rows.start]
        mean_s = window[0] / (after - begin)
        slopes[at : at + _WINDOWS_AT_ONCE] = ((window[4:] - mean_s * window[2:4]) / (window[1] - mean_s * window[0])).T
    return slopes


def _fitted_drift(stamp_ns: Stamps, time_s: Floats, apart_m: Floats, first: int, last: int) -> GnssDrift | None:
    """Best fit of a level and a slope, then of a slope and a level; None if the slope is too small or unsteady."""
    before = int(np.searchsorted(time_s, time_s[first] - WINDOW_S))
    if last - first < 10:
        return None

    def rest(first: int, begin: int, end: int, last: int) -> float:
        """Squared residuals of rows with a drift between two of them."""
        ramp_s = np.clip(time_s[first:last], time_s[begin], time_s[end]) - time_s[begin]
        design = np.stack([np.ones(last - first), ramp_s], axis=1)
        left = apart_m[first:last] - design @ np.linalg.lstsq(design, apart_m[first:last], rcond=None)[0]
        return float(np.sum(left**2))

    # Each end lies within two windows of its first estimate, and is fitted to three.
    begins, near_begin = np.searchsorted(time_s, time_s[first] + WINDOW_S * np.array([2.0, 3.0])).tolist()
    near_end, ends = np.searchsorted(time_s, time_s[last - 1] - WINDOW_S * np.array([3.0, 2.0])).tolist()
    begin, end = before, last - 1
    for _ in range(3):  # each end for the other one
        until = min(end, near_begin, last - 1)
        possible = range(before, max(min(begins, end - 10), before + 1))
        begin = min(possible, key=lambda row: rest(before, row, until, until + 1))
        since = max(begin, near_end)
        possible = range(min(max(begin + 10, ends), last - 1), last)
        end = min(possible, key=lambda row: rest(since, since, row, last))
    span_s, strayed_m = time_s[begin : end + 1], apart_m[begin : end + 1]
    slope = _slope(span_s, strayed_m)
    size, length_s = float(np.hypot(*slope)), float(span_s[-1] - span_s[0])
    left_m = strayed_m - strayed_m.mean(axis=0) - (span_s - span_s.mean())[:, None] * slope
    steady = size * length_s > _STEADY * math.sqrt(float(np.sum(left_m**2)) / len(left_m))
    if size < DRIFT_MPS or length_s < 0.5 * WINDOW_S or not steady:
        return None
    bearing_deg = float(np.degrees(np.arctan2(slope[1], slope[0])) % 360.0)
    return GnssDrift(int(stamp_ns[begin]), int(stamp_ns[end]), size, bearing_deg)


def velocity_jumped(receiver: GnssReceiver, drift: GnssDrift) -> bool:
    """Whether the velocity changed at once by the opposite of the drift, which no vessel does: the velocity is wrong.

    A turn changes the velocity from fix to fix about evenly, so each change is compared with those next to it. Waves
    change it suddenly too, so the change must exceed the usual ones.
    """
    if drift.speed_mps < _LEAST_JUMP_MPS:
        return False
    bearing = np.radians(drift.bearing_deg)
    against = -np.diff(receiver.vel_ned_mps[:, :2], axis=0) @ np.array([np.cos(bearing), np.sin(bearing)])
    sudden = against[1:-1] - 0.5 * (against[:-2] + against[2:])
    near = np.abs(receiver.stamp_ns[1:-2] - drift.from_ns) < _JUMP_REACH_NS
    if not np.isfinite(sudden[near]).any():
        return False
    usual_mps = 1.4826 * float(np.nanmedian(np.abs(sudden)))
    return bool(np.nanmax(sudden[near]) > max(_JUMP_SHARE * drift.speed_mps, _JUMP_SIGMAS * usual_mps))
