"""What two logs both hold and can be laid over each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from xitl_cli.logs.log import Log
from xitl_cli.logs.signals import armed, ground_speed, outputs, yaw, yaw_rate
from xitl_cli.logs.signals.series import Series
from xitl_cli.logs.timeline import robust
from xitl_cli.logs.timeline.correlation import Match, match
from xitl_cli.logs.timeline.placement import Placement

__all__ = ["line_of", "match", "moved", "signals", "tells"]

LEAST_ERROR_S = 2e-3
MOST_DRIFT = 2e-3
EDGE_S = 0.05
MOVES = {"deg/s": 1.0, "m/s": 0.2, "us": 15.0, "": 0.1}
"""Scatter by unit above which a signal is more than noise."""


def signals(one: Log, other: Log) -> Iterator[tuple[str, Series, Series]]:
    """The most telling first, each with its name."""
    for name, of in (("the turn rate", _turn_rate), ("the speed over ground", ground_speed)):
        first = of(one)
        second = None if first is None else of(other)
        if first is not None and second is not None:
            yield name, first, second
    ours, theirs = outputs(one), outputs(other)
    for channel in sorted(set(ours) & set(theirs)):
        if ours[channel].values.std() > 0.0 and theirs[channel].values.std() > 0.0:
            yield f"motor output {channel}", ours[channel], theirs[channel]
    first, second = _armed(one), _armed(other)
    if first is not None and second is not None:
        yield "arming", first, second


def _turn_rate(log: Log) -> Series | None:
    """Measured, else from the heading."""
    measured = yaw_rate(log)
    if measured is not None and len(measured.values) > 2 and measured.values.std() > 0.0:
        return measured
    heading = yaw(log)
    if heading is None or len(heading.values) < 3:
        return None
    turned_deg = np.unwrap(heading.values, period=360.0)
    dt_s = np.diff(heading.stamp_ns).astype(np.float64) * 1e-9
    middle = heading.stamp_ns[:-1] + np.diff(heading.stamp_ns) // 2
    return Series(middle, np.diff(turned_deg) / dt_s, "deg/s", heading.source)


def _armed(log: Log) -> Series | None:
    """0 and 1, where it changes at all within the log."""
    span = log.span_ns
    spans = armed(log)
    if span is None or not spans:
        return None
    edge_ns = round(EDGE_S * 1e9)
    stamps, values = [span[0]], [0.0]
    for each in spans:
        for at_ns, value in ((each.from_ns, 1.0), (each.until_ns, 0.0)):
            if stamps[-1] + edge_ns < at_ns < span[1]:
                stamps += [at_ns - edge_ns // 2, at_ns + edge_ns // 2]
                values += [values[-1], value]
    if len(stamps) == 1:
        return None
    keep = [0, *(i for i in range(1, len(stamps)) if stamps[i] > stamps[i - 1])]
    return Series(np.array(stamps)[keep], np.array(values)[keep], "", "armed")


def moved(series: Series, placement: Placement) -> Series:
    """On the reference's time."""
    stamps = placement.on_reference(series.stamp_ns)
    newest = np.maximum.accumulate(stamps)
    ahead = np.concatenate(([True], stamps[1:] > newest[:-1]))
    return replace(series, stamp_ns=stamps[ahead], values=series.values[ahead])


def tells(series: Series) -> bool:
    """Whether there is more in it than noise, so that the same signal elsewhere has to look like it."""
    values = series.values[: len(series.values) // 10 * 10].reshape(-1, 10).mean(axis=1)
    return bool(len(values) > 10 and float(np.std(values)) > MOVES.get(series.unit, np.inf))


def line_of(found: Match, span_ns: tuple[int, int]) -> tuple[int, int, float, float]:
    """Of a match: the instant (log's time) its offset is of, offset (ns), drift (1), and the error of both (s).

    Drift is told only when the parts show more than their scatter; the error is two standard deviations at the end of
    the log that is farther away.
    """
    middle_ns = (span_ns[0] + span_ns[1]) // 2
    if len(found.parts) < 3:
        spread_s = float(np.max(np.abs(found.parts), initial=0.0)) if len(found.parts) else 0.05
        return middle_ns, found.shift_ns, 0.0, max(2.0 * spread_s, LEAST_ERROR_S, 0.02)
    about_ns = int(np.mean(found.at_ns.astype(np.float64) - found.at_ns[0])) + int(found.at_ns[0])
    x = (found.at_ns - about_ns).astype(np.float64) * 1e-9
    slope, value_s = robust.line(x, found.parts)
    error_s = found.parts - value_s - slope * x
    count = len(x)
    sigma_s = max(float(np.sqrt(np.sum(error_s**2) / max(count - 2, 1))), 0.5 * LEAST_ERROR_S)
    slope_sigma = sigma_s / float(np.sqrt(np.sum(x * x)))
    far_s = max(abs(span_ns[0] - about_ns), abs(span_ns[1] - about_ns)) * 1e-9
    if abs(slope) < 3.0 * slope_sigma or abs(slope) > MOST_DRIFT:
        value_s = float(np.median(found.parts))
        sigma_s = max(float(np.std(found.parts)), sigma_s)
        return about_ns, found.shift_ns + round(value_s * 1e9), 0.0, max(2.0 * sigma_s, LEAST_ERROR_S)
    total_s = 2.0 * float(np.hypot(sigma_s / np.sqrt(count), slope_sigma * far_s))
    return about_ns, found.shift_ns + round(value_s * 1e9), slope, max(total_s, LEAST_ERROR_S)
