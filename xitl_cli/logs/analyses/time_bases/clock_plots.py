"""Pairs of clocks drawn: what is left of the line, rate by window, Allan deviation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs import allan
from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.analyses.time_bases.pair import key_of, title_of
from xitl_cli.logs.sections import Mark, Plot, Trace
from xitl_cli.logs.timeline.clock_fit import Relation

MOST_POINTS = 4000


def plots(relations: Sequence[Relation], instants: Instants) -> tuple[Plot, ...]:
    plots: list[Plot] = []
    curves: list[Trace] = []
    for relation in relations:
        readings = relation.readings
        if not relation.residual_s.any():
            continue
        thin = slice(None, None, max(len(readings) // MOST_POINTS, 1))
        marks = tuple(
            Mark(step.at_ns, f"step {step.size_s:+.3f} s" if step.size_s else "rate changes") for step in relation.steps
        )
        plots.append(
            Plot(
                f"residual_{key_of(readings)}",
                f"{title_of(readings)}: what is left of the offset",
                "ms",
                (Trace("residual", readings.at_ns[thin], relation.residual_s[thin] * 1e3, "points"),),
                marks=marks,
            )
        )
        if len(relation.window_ppm) > 1:
            rows = np.clip(np.searchsorted(readings.first_ns, relation.window_ns), 0, len(readings) - 1)
            plots.append(
                Plot(
                    f"rate_{key_of(readings)}",
                    f"{title_of(readings)}: drift in windows of {relation.window_s:.0f} s",
                    "ppm",
                    (Trace("drift", readings.at_ns[rows], relation.window_ppm, "points"),),
                    marks=marks,
                )
            )
        curve = allan_of(relation)
        if curve is not None:
            curves.append(Trace(title_of(readings), curve.tau_s, curve.deviation))
    if curves:
        plots.append(
            Plot(
                "clock_allan",
                "Allan deviation of the clocks",
                "ADEV (1)",
                tuple(curves),
                "loglog",
                "averaging time (s)",
            )
        )
    return tuple(plots)


def allan_of(relation: Relation) -> allan.AllanCurve | None:
    """Of the time error, its drift taken out, by the longest piece; None where that is too short or too uneven.

    A deviation of the mean rate over tau: that of the differences of the time error, each over one period.
    """
    piece = relation.longest
    readings = relation.readings
    inside = (readings.first_ns >= piece.from_ns) & (readings.first_ns <= piece.until_ns)
    time_s = (readings.first_ns[inside] - piece.from_ns).astype(np.float64) * 1e-9
    error_s = relation.residual_s[inside]
    if len(time_s) < 40 or not error_s.any():
        return None
    period_s = float(np.median(np.diff(time_s)))
    if not period_s > 0.0:
        return None
    even_s: NDArray[np.float64] = np.arange(0.0, time_s[-1], max(period_s, time_s[-1] / 200_000))
    if len(even_s) > 2 * len(time_s):
        return None
    even = np.interp(even_s, time_s, error_s)
    step_s = float(even_s[1] - even_s[0])
    curve = allan.overlapping(np.diff(even) / step_s, step_s)
    known = curve.deviation > 0.0
    if not known.any():
        return None
    return allan.AllanCurve(curve.tau_s[known], curve.deviation[known], curve.relative_error[known])
