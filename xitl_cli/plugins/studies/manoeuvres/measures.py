"""Measures of a manoeuvre from its track: arrays (K,) over time, angles in rad that continue beyond a turn.

Turning circle, zig-zag, spiral and stopping as ITTC 7.5-02-06-03 and IMO MSC.137(76) define them; decays by the
logarithmic decrement; responses to waves by least squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy import complex128
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array

_LEAST_SWING = 0.01
_STEADY_SHARE = 0.25
"""Last part of a turn, which counts as steady."""


@dataclass(frozen=True, slots=True)
class TurningCircle:
    """Measures from the steering order on. None: not reached."""

    advance_m: float | None
    """Along the approach."""
    transfer_m: float | None
    """To the side of the turn."""
    tactical_diameter_m: float | None
    steady_diameter_m: float
    rate_radps: float
    speed_mps: float
    drift_rad: float
    """Positive for the bow inward."""


def turning_circle(time_s: Array, north_m: Array, east_m: Array, yaw_rad: Array, velocity: Array) -> TurningCircle:
    """Measure a turn. velocity: (K, 2) ahead and to starboard.

    The order is at the first instant, on a straight approach.
    """
    turned = yaw_rad - yaw_rad[0]
    side = math.copysign(1.0, turned[-1])
    ahead = (north_m - north_m[0]) * math.cos(yaw_rad[0]) + (east_m - east_m[0]) * math.sin(yaw_rad[0])
    aside = side * ((east_m - east_m[0]) * math.cos(yaw_rad[0]) - (north_m - north_m[0]) * math.sin(yaw_rad[0]))
    quarter, half = (_first_at(side * turned, angle) for angle in (0.5 * math.pi, math.pi))
    last = time_s >= time_s[-1] - _STEADY_SHARE * (time_s[-1] - time_s[0])
    first, end = np.flatnonzero(last)[[0, -1]]
    rate = float((yaw_rad[end] - yaw_rad[first]) / (time_s[end] - time_s[first]))
    speed = float(np.hypot(velocity[last, 0], velocity[last, 1]).mean())
    return TurningCircle(
        advance_m=_at(ahead, quarter),
        transfer_m=_at(aside, quarter),
        tactical_diameter_m=_at(aside, half),
        steady_diameter_m=2.0 * speed / abs(rate) if rate else math.inf,
        rate_radps=rate,
        speed_mps=speed,
        drift_rad=-side * float(np.arctan2(velocity[last, 1], velocity[last, 0]).mean()),
    )


def _first_at(rising: Array, level: float) -> float | None:
    """Return the fractional index at which `rising` first reaches a level."""
    above = np.flatnonzero(rising >= level)
    if not above.size:
        return None
    index = int(above[0])
    if index == 0:
        return 0.0
    before, after = rising[index - 1], rising[index]
    return index - 1 + float((level - before) / (after - before))


def _at(values: Array, index: float | None) -> float | None:
    return None if index is None else float(np.interp(index, np.arange(len(values)), values))


@dataclass(frozen=True, slots=True)
class ZigZag:
    """Measures of a zig-zag."""

    initial_turn_s: float
    """From the first order to the first reversal."""
    initial_turn_m: float
    """From the first order to the first reversal, along the track."""
    overshoot_rad: tuple[float, ...]
    """Each beyond the heading at which the steering was reversed."""
    period_s: float | None


def zig_zag(time_s: Array, yaw_rad: Array, speed_mps: Array, steering: Array) -> ZigZag:
    """Measure a zig-zag. steering: (K,) as ordered, only its sign counts. Raises ValueError without a reversal."""
    reversals = np.flatnonzero(np.diff(np.sign(steering)) != 0) + 1
    if not reversals.size:
        raise ValueError("the heading of the first reversal was not reached")
    heading = yaw_rad - yaw_rad[0]
    overshoots = []
    for start, end in zip(reversals, [*reversals[1:], len(time_s)], strict=True):
        side = math.copysign(1.0, heading[start])
        beyond = side * (heading[start:end] - heading[start])
        if int(np.argmax(beyond)) < len(beyond) - 1:  # it has returned
            overshoots.append(float(beyond.max()))
    first = reversals[0]
    return ZigZag(
        initial_turn_s=float(time_s[first] - time_s[0]),
        initial_turn_m=float(np.trapezoid(speed_mps[: first + 1], time_s[: first + 1])),
        overshoot_rad=tuple(overshoots),
        period_s=float(time_s[reversals[3]] - time_s[reversals[1]]) if len(reversals) > 3 else None,
    )


def spiral(time_s: Array, rate_radps: Array, steering: Array) -> list[tuple[float, float]]:
    """Return steering and the mean rate of turn in the last quarter of each hold, in order."""
    changes = np.flatnonzero(np.diff(steering) != 0) + 1
    holds = []
    for start, end in zip([0, *changes], [*changes, len(time_s)], strict=True):
        last = slice(end - max((end - start) // 4, 1), end)
        holds.append((float(steering[start]), float(rate_radps[last].mean())))
    return holds


@dataclass(frozen=True, slots=True)
class Stop:
    """Measures from the order on. None: the vessel did not slow down enough."""

    time_s: float | None
    track_reach_m: float | None
    """Along the track."""


def stopping(time_s: Array, north_m: Array, east_m: Array, ahead_mps: Array, left: float = 0.0) -> Stop:
    """Measure until the share `left` of the speed ahead remains. The order is at the first instant."""
    index = _first_at(-ahead_mps, -left * float(ahead_mps[0]) - 1e-12)
    track_m = np.concatenate([[0.0], np.hypot(np.diff(north_m), np.diff(east_m)).cumsum()])
    return Stop(_at(time_s - time_s[0], index), _at(track_m, index))


def time_to_95_percent(time_s: Array, speed_mps: Array, final_mps: float) -> float | None:
    """Return the time to 95 % of the final speed; None if it is not reached."""
    index = _first_at(speed_mps, 0.95 * final_mps)
    return _at(time_s - time_s[0], index)


@dataclass(frozen=True, slots=True)
class Decay:
    """Free decay."""

    period_s: float
    """Natural period, without damping."""
    damping_ratio: float
    """Share of critical damping."""


def decay(time_s: Array, deflection: Array) -> Decay | None:
    """Analyse a free decay of a deflection from rest, by the logarithmic decrement of its half swings.

    Swings below `_LEAST_SWING` of the first deflection are omitted. None for fewer than two.
    """
    turning = np.flatnonzero(np.diff(np.sign(np.diff(deflection))) != 0) + 1
    peaks = [(float(time_s[0]), abs(float(deflection[0])))]
    for index in turning:
        # Instant and size of the extreme, by the parabola through the sample and its neighbours
        at = int(index)
        before, here, after = deflection[at - 1 : at + 2]
        bend = before - 2.0 * here + after
        off = 0.5 * (before - after) / bend if bend else 0.0
        step = float(time_s[at + 1] - time_s[at])
        at_s, size = float(time_s[at]) + off * step, abs(float(here - 0.25 * (before - after) * off))
        if size < _LEAST_SWING * peaks[0][1]:
            break
        peaks.append((at_s, size))
    if len(peaks) < 3:
        return None
    at_s, size = np.array(peaks[1:]).T  # the release is not a free swing: terms that follow the motion lag there
    half_s, _ = np.polyfit(np.arange(len(at_s)), at_s, 1)
    slope, _ = np.polyfit(np.arange(len(size)), np.log(size), 1)
    ratio = -slope / math.hypot(slope, math.pi)
    return Decay(2.0 * half_s * math.sqrt(1.0 - ratio**2), float(ratio))


def response(phase_rad: Array, values: Array) -> NDArray[complex128]:
    """Fit (W, S) complex amplitudes c of waves to series (K, S): mean + Re(sum of c exp(i phase)), phases (K, W)."""
    columns = np.hstack([np.cos(phase_rad), -np.sin(phase_rad), np.ones((len(phase_rad), 1))])
    fit = np.linalg.solve(columns.T @ columns, columns.T @ values)
    waves = phase_rad.shape[1]
    complex_amplitude: NDArray[complex128] = fit[:waves] + 1j * fit[waves : 2 * waves]
    return complex_amplitude


def radius_of_95_percent(north_m: Array, east_m: Array, place: Sequence[float]) -> float:
    """Return the radius of the circle about a place that contains the vessel for 95 % of the time."""
    return float(np.quantile(np.hypot(north_m - place[0], east_m - place[1]), 0.95))
