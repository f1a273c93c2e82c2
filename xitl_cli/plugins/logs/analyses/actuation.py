"""Faults detected from contradicting signals: GNSS position and velocity, battery voltage and current, commands and
motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_core.geodesy import LocalFrame
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Finding, Section
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.signals.receivers import GnssReceiver, gnss_receivers, injected_receivers
from xitl_cli.logs.signals.series import numbers
from xitl_cli.logs.signals.spans import find_holds, runs
from xitl_cli.plugins.logs.analyses.actuator_faults import actuator_findings
from xitl_cli.plugins.logs.analyses.power import batteries

DRIFT_MPS = 0.12
"""Least drift that exceeds a receiver's own error (0.5 m that changes over a minute) in one window."""
WINDOW_S = 15.0
DROP_SHARE = 0.015
"""Least fall of the voltage that exceeds noise, as share of its median."""
LEAST_FIXES = 20
MOST_GAP_S = 1.0
"""Largest gap between two fixes of one stretch: the mean velocity determines the path of a boat that turns in this
time."""
JUMP_M = 3.0
"""Least step between two fixes, beyond the velocity, that is a jump."""
_LEAST_JUMP_MPS, _JUMP_SHARE, _JUMP_REACH_NS = 0.5, 0.6, 1_500_000_000
BATTERY_WINDOW_S = 8.0


@dataclass(frozen=True, slots=True)
class Departure:
    """A span of the log's time in which a signal left its model."""

    from_ns: int
    until_ns: int
    size: float
    """In the unit of the judged signal."""
    bearing_deg: float = 0.0


def analyse(log: Log) -> Section | None:
    """Section on actuation. None if nothing was found, or if neither commands with motion, a receiver nor a battery is
    logged."""
    clock = LogClock(log)
    findings = [*_gnss_findings(log, clock), *_battery_findings(log, clock), *actuator_findings(log, clock)]
    return Section("actuation", "Actuators and power", findings=tuple(findings)) if findings else None


def _gnss_findings(log: Log, clock: LogClock) -> Iterator[Finding]:
    for receiver in gnss_receivers(log) or injected_receivers(log):
        for drift in gnss_drifts(receiver):
            if velocity_jumped(receiver, drift):
                yield _of_velocity(receiver, drift, clock)
                continue
            yield Finding.warning(
                "actuation.gnss_drift",
                f"From {clock.text(drift.from_ns)} to {clock.text(drift.until_ns)} the position of {receiver.name} "
                f"drifts by {drift.size:.2f} m/s towards {drift.bearing_deg:.0f} degrees against its own velocity",
                (
                    Evidence(
                        receiver.message,
                        receiver.fields.get("lat"),
                        drift.from_ns,
                        drift.until_ns,
                        f"{drift.size:.2f} m/s",
                    ),
                ),
                "Do not trust the position in this time: look for reflected signals, interference or spoofing.",
            )


def _of_velocity(receiver: GnssReceiver, drift: Departure, clock: LogClock) -> Finding:
    return Finding.warning(
        "gnss.velocity_off",
        f"From {clock.text(drift.from_ns)} to {clock.text(drift.until_ns)} the velocity of {receiver.name} is off by "
        f"{drift.size:.2f} m/s towards {(drift.bearing_deg + 180.0) % 360.0:.0f} degrees: it changed at once, and the "
        "position did not follow",
        (
            Evidence(
                receiver.message, receiver.fields.get("speed"), drift.from_ns, drift.until_ns, f"{drift.size:.2f} m/s"
            ),
        ),
        "Do not trust the velocity in this time; check the receiver's dynamic model and its driver.",
    )


def gnss_drifts(receiver: GnssReceiver) -> list[Departure]:
    """Times in which the position moves at another velocity than the receiver reports, by the slope of the difference.

    Each stretch without a gap and without a jump is judged alone, because the velocity does not determine the path
    across a gap, and a position that jumps does not drift. A repeated position is a gap too: the receiver did not
    measure then. A drift that the velocity shares cannot be detected. Size: m/s.
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


def _drifts(stamp_ns: Stamps, time_s: Floats, apart_m: Floats) -> Iterator[Departure]:
    """Drifts within rows without a gap. apart_m: (N, 2) way of the positions beyond that of the velocities."""
    ends = np.searchsorted(time_s, time_s + WINDOW_S)
    whole = ends < len(time_s)
    firsts, ends = np.flatnonzero(whole), ends[whole]
    slope = _slopes(time_s, apart_m, firsts, ends)
    for begin, after in _joined(runs(np.linalg.norm(slope, axis=1) > DRIFT_MPS), 25):
        first, last = int(firsts[begin]), int(ends[after - 1])
        if (departure := _fitted_drift(stamp_ns, time_s, apart_m, first, last)) is not None:
            yield departure


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


def _joined(spans: object, most_rows: int) -> list[tuple[int, int]]:
    """Join runs that are fewer than `most_rows` rows apart."""
    found: list[tuple[int, int]] = []
    for begin, after in spans:  # type: ignore[attr-defined]
        if found and begin - found[-1][1] < most_rows:
            found[-1] = found[-1][0], after
        else:
            found.append((begin, after))
    return found


def _fitted_drift(stamp_ns: Stamps, time_s: Floats, apart_m: Floats, first: int, last: int) -> Departure | None:
    """Best fit of a level and a slope, then of a slope and a level; None if the slope is too small."""
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
    slope = _slope(time_s[begin : end + 1], apart_m[begin : end + 1])
    size = float(np.hypot(*slope))
    if size < DRIFT_MPS or time_s[end] - time_s[begin] < 0.5 * WINDOW_S:
        return None
    bearing_deg = float(np.degrees(np.arctan2(slope[1], slope[0])) % 360.0)
    return Departure(int(stamp_ns[begin]), int(stamp_ns[end]), size, bearing_deg)


def velocity_jumped(receiver: GnssReceiver, drift: Departure) -> bool:
    """Whether the velocity changed at once by the opposite of the drift, which no vessel does: the velocity is wrong.

    A turn changes the velocity from fix to fix about evenly, so each change is compared with those next to it.
    """
    if drift.size < _LEAST_JUMP_MPS:
        return False
    near = np.abs(receiver.stamp_ns - drift.from_ns) < _JUMP_REACH_NS
    changes = np.diff(receiver.vel_ned_mps[near, :2], axis=0)
    bearing = np.radians(drift.bearing_deg)
    against = -changes @ np.array([np.cos(bearing), np.sin(bearing)])
    sudden = against[1:-1] - 0.5 * (against[:-2] + against[2:])
    return bool(len(sudden) and np.nanmax(sudden) > _JUMP_SHARE * drift.size)


def _battery_findings(log: Log, clock: LogClock) -> Iterator[Finding]:
    for name, stamp_ns, voltage_v, current_a in _batteries(log):
        for sag in battery_sags(stamp_ns, voltage_v, current_a):
            yield Finding.warning(
                "actuation.battery_sag",
                f"At {clock.text(sag.from_ns)} the voltage of the battery falls by {sag.size:.2f} V more than its "
                "current explains",
                (Evidence(name, "voltage_v", sag.from_ns, sag.until_ns, f"{sag.size:.2f} V"),),
                "Look at the cells, the contacts and the wires of the battery; the motors turn more slowly from then.",
            )


def _batteries(log: Log) -> Iterator[tuple[str, Stamps, Floats, Floats]]:
    """The simulated battery of a recording, else measured batteries."""
    table = log.tables.get("/battery")
    if table is not None and {"voltage_v", "current_a"} <= set(table.columns):
        voltage_v, current_a = numbers(table, "voltage_v"), numbers(table, "current_a")
        if voltage_v is not None and current_a is not None:
            yield "/battery", table.stamp_ns, voltage_v, current_a
        return
    for battery in batteries(log):
        if battery.current_a is not None:
            yield battery.message, battery.stamp_ns, battery.voltage_v, battery.current_a


def battery_sags(stamp_ns: Stamps, voltage_v: Floats, current_a: Floats) -> list[Departure]:
    """Instants at which the voltage falls permanently, by more than charge and resistance explain. Size: V.

    Around each instant, a level, a slope and a resistance are fitted, with a step or with a step of the resistance.
    """
    good = np.isfinite(voltage_v) & np.isfinite(current_a) & (voltage_v > 0.0)
    stamp_ns, voltage_v, current_a = stamp_ns[good], voltage_v[good], current_a[good]
    if len(stamp_ns) < 40:
        return []
    time_s = (stamp_ns - stamp_ns[0]) * 1e-9
    least_v = DROP_SHARE * float(np.median(voltage_v))
    period_s = float(np.median(np.diff(time_s)))
    half = max(round(BATTERY_WINDOW_S / max(period_s, 1e-3)), 5)
    drop_v = np.zeros(len(time_s))
    for at in range(half, len(time_s) - half, max(round(0.5 / max(period_s, 1e-3)), 1)):
        drop_v[at] = _drop_v(time_s, voltage_v, current_a, at, half, least_v)
    found: list[Departure] = []
    while drop_v.max() > least_v:
        coarse = int(np.argmax(drop_v))
        fine = range(max(coarse - half // 8, half), min(coarse + half // 8 + 1, len(time_s) - half))
        exact = [_drop_v(time_s, voltage_v, current_a, at, half, least_v) for at in fine]
        at = fine[int(np.argmax(exact))]
        found.append(Departure(int(stamp_ns[at]), int(stamp_ns[-1]), float(max(exact))))
        drop_v[max(at - 2 * half, 0) : at + 2 * half] = 0.0
    return sorted(found, key=lambda each: each.from_ns)


def _drop_v(time_s: Floats, voltage_v: Floats, current_a: Floats, at: int, half: int, least_v: float) -> float:
    """Fall of the voltage at row `at`; 0 unless a step explains at least three quarters of the residual without it."""
    rows = slice(at - half, at + half)
    after = (np.arange(at - half, at + half) >= at).astype(np.float64)
    current, voltage = current_a[rows], voltage_v[rows]
    plain = np.stack([np.ones(2 * half), time_s[rows] - time_s[at], current], axis=1)
    step = np.concatenate([plain, np.stack([after, after * current], axis=1)], axis=1)
    left = voltage - plain @ np.linalg.lstsq(plain, voltage, rcond=None)[0]
    fitted, *_ = np.linalg.lstsq(step, voltage, rcond=None)
    rest = voltage - step @ fitted
    if rest @ rest > 0.25 * (left @ left):
        return 0.0
    size_v = -float(fitted[3] + fitted[4] * current[half:].mean())
    noise_v = float(np.sqrt(rest @ rest / len(rest)))
    return size_v if size_v > max(least_v, 3.0 * noise_v) else 0.0
