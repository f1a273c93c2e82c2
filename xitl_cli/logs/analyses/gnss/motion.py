"""Whether the positions of a receiver move as its own velocities say: jumps, values that stand still, noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_core.geodesy import LocalFrame
from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.sections import Evidence, Fact, Finding, Plot, Section, Severity, Trace
from xitl_cli.logs.sensing.columns import some, told
from xitl_cli.logs.sensing.fixes import FIX_3D, Receiver
from xitl_cli.logs.sensing.holding import holding

_LONGEST_STEP_S = 3.0
_JUMP_M, _JUMP_WARNING_M = 2.0, 3.0
_SIGMAS = 8.0
_MOVING_MPS = 0.5
_BIAS_MPS = 0.5
_WINDOW_S = 10.0


def motion(receiver: Receiver, instants: Instants) -> Section:
    """Positions from fix to fix against the mean of the two velocities, in the horizontal."""
    good = np.flatnonzero((receiver.fix >= FIX_3D) & np.isfinite(receiver.lat_deg) & np.isfinite(receiver.lon_deg))
    if len(good) < 10:
        return Section("gnss", "GNSS")
    lat, lon = receiver.lat_deg[good], receiver.lon_deg[good]
    # About the median: one wild fix shall not move the frame.
    frame = LocalFrame(float(np.median(lat)), float(np.median(lon)), 0.0)
    north_east = frame.ned(lat, lon, np.zeros(len(good)))[:, :2]
    step_s = np.diff(receiver.sample_ns[good]) * 1e-9
    usable = (step_s > 0.0) & (step_s <= _LONGEST_STEP_S)
    moved = np.diff(north_east, axis=0)
    findings = _frozen(receiver, good, step_s, instants)
    facts: list[Fact] = []
    plots: list[Plot] = []
    velocity = receiver.vel_ned_mps[good][:, :2]
    if np.isfinite(velocity).all(axis=1).sum() >= 10:
        expected = 0.5 * (velocity[1:] + velocity[:-1]) * step_s[:, None]
        strayed = np.where(usable[:, None], moved - expected, np.nan)
        known = np.asarray(np.isfinite(strayed).all(axis=1))
        if np.count_nonzero(known) >= 10:
            length = np.where(known, np.hypot(strayed[:, 0], strayed[:, 1]), np.nan)
            if not findings:  # a position that stands still contradicts any velocity
                findings += _bias(receiver, good, strayed, step_s, known, instants)
            findings += _jumps(receiver, good, length, moved, step_s, instants)
            noise = np.sqrt(np.nanmedian(np.diff(velocity, axis=0)[known] ** 2) / 2.0) / 0.6745
            facts = [
                Fact(
                    "position_step_error_m",
                    "Position against velocity, median a fix",
                    told(float(np.nanmedian(length))),
                    "m",
                ),
                Fact("speed_noise_mps", "Velocity from fix to fix, one sigma an axis", told(float(noise)), "m/s"),
            ]
            plots.append(_plot(receiver, good, length))
    return Section("gnss", "GNSS", facts=tuple(facts), findings=tuple(findings), plots=tuple(plots))


def _jumps(
    receiver: Receiver,
    good: NDArray[np.intp],
    length_m: NDArray[np.float64],
    moved: NDArray[np.float64],
    step_s: NDArray[np.float64],
    instants: Instants,
) -> list[Finding]:
    usual = 1.4826 * float(np.nanmedian(length_m))
    rows = np.flatnonzero(np.nan_to_num(length_m) > max(_JUMP_M, _SIGMAS * usual))
    if not len(rows):
        return []
    largest = int(rows[np.argmax(length_m[rows])])
    trusted_m = _stated(receiver, int(receiver.stamp_ns[good[largest + 1]]))
    beyond = length_m[largest] > max(_JUMP_WARNING_M, 2.0 * trusted_m)
    speed = float(np.hypot(*moved[largest]) / step_s[largest])
    times = some([instants.text(int(receiver.stamp_ns[good[row + 1]])) for row in rows])
    reported = (
        "" if receiver.speed_mps is None else f", where it reported {receiver.speed_mps[good[largest + 1]]:.1f} m/s"
    )
    times_in_words = "once" if len(rows) == 1 else f"{len(rows)} times"
    return [
        Finding(
            "gnss.jump",
            Severity.WARNING if beyond else Severity.NOTICE,
            f"The position of {receiver.name} jumped {times_in_words}, by up to {length_m[largest]:.1f} m (as if at "
            f"{speed:.0f} m/s{reported}): at {times}",
            tuple(
                Evidence(
                    receiver.message,
                    receiver.fields["lat"],
                    int(receiver.stamp_ns[good[row + 1]]),
                    None,
                    f"{length_m[row]:.1f} m",
                )
                for row in rows[:8]
            ),
            "Look at satellites and surroundings then (bridge, wall, interference): did the estimator follow?",
        )
    ]


def _stated(receiver: Receiver, at_ns: int) -> float:
    """Horizontal accuracy that the receiver stated about then; 0 unknown."""
    accuracy = receiver.accuracy
    if accuracy is None or accuracy.horizontal_m is None or not len(accuracy.stamp_ns):
        return 0.0
    row = min(int(np.searchsorted(accuracy.stamp_ns, at_ns)), len(accuracy.stamp_ns) - 1)
    return float(np.nan_to_num(accuracy.horizontal_m[row]))


def _bias(
    receiver: Receiver,
    good: NDArray[np.intp],
    strayed: NDArray[np.float64],
    step_s: NDArray[np.float64],
    known: NDArray[np.bool_],
    instants: Instants,
) -> list[Finding]:
    """Velocities that for ten seconds say something else than the positions do; jumps are left out."""
    usual = 1.4826 * float(np.nanmedian(np.hypot(strayed[:, 0], strayed[:, 1])))
    calm = known & (np.nan_to_num(np.hypot(strayed[:, 0], strayed[:, 1])) < max(_JUMP_M, _SIGMAS * usual))
    stamps = receiver.stamp_ns[good[1:]][calm]
    if len(stamps) < 10:
        return []
    window = (stamps - stamps[0]) // int(_WINDOW_S * 1e9)
    numbers, place, count = np.unique(window, return_inverse=True, return_counts=True)
    time_s = np.bincount(place, step_s[calm])
    off = np.stack([np.bincount(place, strayed[calm, axis]) for axis in (0, 1)], axis=1) / time_s[:, None]
    speed = np.where((time_s > 0.5 * _WINDOW_S) & (count >= 5), np.hypot(off[:, 0], off[:, 1]), 0.0)
    limit = _BIAS_MPS
    if receiver.accuracy is not None and receiver.accuracy.speed_mps is not None:
        limit = max(limit, 2.0 * float(np.nanmedian(receiver.accuracy.speed_mps)))
    if speed.max() <= limit:
        return []
    worst = int(np.argmax(speed))
    at_ns = int(stamps[0] + numbers[worst] * int(_WINDOW_S * 1e9))
    return [
        Finding(
            "gnss.velocity_off",
            Severity.WARNING,
            f"The velocity of {receiver.name} is {speed[worst]:.1f} m/s off what its positions do, over ten seconds "
            f"from {instants.text(at_ns)}",
            (Evidence(receiver.message, receiver.fields.get("speed"), at_ns, at_ns + int(_WINDOW_S * 1e9)),),
            "Check the receiver's dynamic model and configuration; the estimator takes both for true.",
        )
    ]


def _frozen(
    receiver: Receiver, good: NDArray[np.intp], step_s: NDArray[np.float64], instants: Instants
) -> list[Finding]:
    """The same position again and again from a receiver that says it moves."""
    if receiver.speed_mps is None or not (step_s > 0.0).any():
        return []
    period_s = float(np.median(step_s[step_s > 0.0]))
    place = np.stack([receiver.lat_deg[good], receiver.lon_deg[good]], axis=1)
    spans = []
    for hold in holding(place, period_s, shortest_s=1.5).holds:
        speed = receiver.speed_mps[good[hold.first : hold.last + 1]]
        if np.isfinite(speed).any() and float(np.nanmedian(speed)) > _MOVING_MPS:
            spans.append((int(receiver.stamp_ns[good[hold.first]]), int(receiver.stamp_ns[good[hold.last]]), speed))
    if not spans:
        return []
    times = some([f"from {instants.text(a)} for {(b - a) * 1e-9:.1f} s" for a, b, _ in spans])
    return [
        Finding(
            "gnss.frozen",
            Severity.WARNING,
            f"{receiver.name} repeats one position while it reports "
            f"{float(np.nanmedian(spans[0][2])):.1f} m/s: {times}",
            tuple(Evidence(receiver.message, receiver.fields["lat"], a, b) for a, b, _ in spans[:8]),
            "Check the receiver and its driver: a device that no longer measures may repeat its last fix.",
        )
    ]


def _plot(receiver: Receiver, good: NDArray[np.intp], length_m: NDArray[np.float64]) -> Plot:
    name = f"{receiver.name} position against velocity"
    return Plot(
        f"gnss_motion_{receiver.name}",
        "How far each position is from where the velocity would have led",
        "m",
        (Trace(name, receiver.stamp_ns[good[1:]], length_m, "points"),),
    )
