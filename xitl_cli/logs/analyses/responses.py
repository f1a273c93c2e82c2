"""Response to a setpoint: its delay, and rise, overshoot and settling after each step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from xitl_cli.logs.model.table import Floats, Stamps

LONGEST_PAUSE_S = 2.0  # between rows: values in a longer pause are unknown
LONGEST_DELAY_S = 10.0
_FINER = 0.8  # share of the error without a shift, required for a delay
_SHIFT_S, _MOST_ROWS = 0.05, 20_000
_STEP_WITHIN_S, _BEGINS_SHARE = 1.0, 0.1
_HOLD_S, _HOLD_SHARE = 4.0, 0.15
_SETTLED_SHARE = 0.1
_ANSWER_S = 20.0  # after a step; later changes are effects of water and wind
_LEAST_ROWS = 20


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Response to a step of the setpoint from `begin` to `end`, held until until_ns. All figures are within twenty
    seconds."""

    at_ns: int
    until_ns: int
    begin: float
    end: float
    rise_s: float | None
    """From 10 to 90 % of the step; None if it was not reached."""
    overshoot_percent: float
    """Of the step, beyond its end."""
    settled_s: float | None
    """From the step until the response stayed within a tenth of it; None if it did not."""


def response_delay_s(stamp_ns: Stamps, demanded: Floats, achieved: Floats, least: float) -> float | None:
    """Delay at which the response is nearest to the setpoint, by least squares.

    demanded, achieved: (N,) without turns. least: least change of the setpoint that allows a result. None also if no
    shift brings the two clearly nearer to each other.
    """
    parts = [part for part in unbroken(stamp_ns) if part.stop - part.start >= _LEAST_ROWS]
    if not parts or max(float(np.std(demanded[part])) for part in parts) < least:
        return None
    shifts_s = np.arange(0.0, LONGEST_DELAY_S, _SHIFT_S)
    errors = np.array([_apart(stamp_ns, demanded, achieved, parts, shift_s) for shift_s in shifts_s])
    best = int(np.nanargmin(errors))
    if best == len(errors) - 1 or errors[0] == 0.0:
        return None if best else 0.0
    if best == 0:
        return 0.0
    if errors[best] > _FINER**2 * errors[0]:
        return None
    before, there, after = errors[best - 1 : best + 2]
    curve = before - 2.0 * there + after
    between = 0.5 * (before - after) / curve if curve > 0.0 else 0.0
    return float(shifts_s[best] + between * (shifts_s[1] - shifts_s[0]))


def _apart(stamp_ns: Stamps, demanded: Floats, achieved: Floats, parts: Sequence[slice], shift_s: float) -> float:
    """Mean square difference, over the rows that every shift has, so that all shifts use the same rows."""
    squares: list[Floats] = []
    for part in parts:
        seconds = (stamp_ns[part] - stamp_ns[part.start]) * 1e-9
        reach_s = min(LONGEST_DELAY_S, 0.25 * seconds[-1])
        kept = seconds <= seconds[-1] - reach_s
        some = np.flatnonzero(kept)[:: max(1, len(stamp_ns) // _MOST_ROWS)]
        later = np.interp(seconds[some] + min(shift_s, reach_s), seconds, achieved[part])
        squares.append((later - demanded[part][some]) ** 2)
    return float(np.mean(np.concatenate(squares)))


def step_responses(stamp_ns: Stamps, demanded: Floats, achieved: Floats, least: float) -> list[StepResponse]:
    """Responses to steps of at least `least`: a change within a second to a value that is then held for at least four.

    demanded, achieved: (N,) without turns. A step is from the vessel's value to the setpoint at its end.
    """
    return [found for part in unbroken(stamp_ns) for found in _responses(stamp_ns, demanded, achieved, part, least)]


def _responses(
    stamp_ns: Stamps, demanded: Floats, achieved: Floats, part: slice, least: float
) -> Iterator[StepResponse]:
    seconds = (stamp_ns[part] - stamp_ns[part.start]) * 1e-9
    wanted, there = demanded[part], achieved[part]
    done = 0
    for at in np.flatnonzero(np.abs(np.diff(wanted)) >= _BEGINS_SHARE * least).tolist():
        after = int(np.searchsorted(seconds, seconds[at] + _STEP_WITHIN_S, "right")) - 1
        change = np.abs(wanted[at + 1 : after + 1] - wanted[at])
        if at < done or not len(change) or change.max() < least:
            continue
        settled_at = at + 1 + int(np.argmax(change))
        step = wanted[settled_at] - wanted[at]
        moved = np.flatnonzero(np.abs(wanted[settled_at:] - wanted[settled_at]) > _HOLD_SHARE * abs(step))
        end = settled_at + int(moved[0]) if len(moved) else len(seconds)
        if seconds[end - 1] - seconds[settled_at] < _HOLD_S:
            continue
        found = _answered(stamp_ns[part][at:end], wanted[at:end], there[at:end], settled_at - at, least)
        if found is not None:
            yield found
        done = end - 1


def _answered(
    stamp_ns: Stamps, wanted: Floats, there: Floats, reached: int, least: float
) -> StepResponse | None:  # fmt: skip
    """Response to one step.

    reached: the row from which the setpoint is held. If the setpoint then drifts, the response is relative to it.
    """
    final, begin = float(wanted[reached]), float(there[0])
    if abs(final - begin) < least:
        return None
    seconds = (stamp_ns - stamp_ns[0]) * 1e-9
    held = np.where(np.arange(len(wanted)) < reached, final, wanted)
    way = 1.0 + (there - held) / (final - begin)
    first = seconds <= _ANSWER_S
    rise_s = None
    if (way[first] >= 0.9).any():
        rise_s = _crossing(seconds, way, 0.9) - _crossing(seconds, way, 0.1)
    outside = np.flatnonzero(np.abs(way[first] - 1.0) > _SETTLED_SHARE)
    settled = len(outside) == 0 or outside[-1] < first.sum() - 1
    settled_s = float(seconds[outside[-1] + 1]) if settled and len(outside) else None
    overshoot = 100.0 * max(float(way[first].max()) - 1.0, 0.0)
    return StepResponse(int(stamp_ns[0]), int(stamp_ns[-1]), begin, final, rise_s, overshoot, settled_s)


def _crossing(seconds: Floats, way: Floats, level: float) -> float:
    """First time (s) at which `way` reached the level, interpolated between rows."""
    row = int(np.flatnonzero(way >= level)[0])
    if row == 0:
        return float(seconds[0])
    share = (level - way[row - 1]) / (way[row] - way[row - 1])
    return float(seconds[row - 1] + share * (seconds[row] - seconds[row - 1]))


def unbroken(stamp_ns: Stamps) -> list[slice]:
    """Parts of the rows without a pause."""
    breaks = np.flatnonzero(np.diff(stamp_ns) > LONGEST_PAUSE_S * 1e9) + 1
    ends = [0, *breaks.tolist(), len(stamp_ns)]
    return [slice(first, after) for first, after in pairwise(ends) if after > first]
