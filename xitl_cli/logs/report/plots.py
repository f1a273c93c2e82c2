"""Plots for a screen: thinned without loss of extremes, and packed as JSON with typed arrays in base64."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.charts.chart import Chart
from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.sections import Plot, Trace
from xitl_cli.logs.model.table import Floats
from xitl_cli.logs.report.model import Overview
from xitl_cli.logs.report.page import Page
from xitl_cli.logs.report.signal_data import HeldColumn, HeldLog

MOST_POINTS = 4000
MOST_CHART_POINTS = 2000
Numbers = NDArray[Any]  # of int64 or float64

_LEAST_GAP_NS = 1_000_000_000
_GAP_IN_INTERVALS = 10


@dataclass(frozen=True, slots=True)
class ThinTrace(Trace):
    """A thinned trace, in the order of x if x is time. A NaN marks a break of the line."""

    of: int = 0
    """Number of points before thinning."""


def thin(trace: Trace, *, over_time: bool, most: int = MOST_POINTS) -> ThinTrace:
    """Keep about `most` points. Over time, these are the first, least, greatest and last of each interval, in their
    order.

    Other traces keep every n-th point and the last, because their order is their shape.
    """
    if isinstance(trace, ThinTrace):
        return trace
    x: Numbers = np.asarray(trace.x)
    y: Floats = np.asarray(trace.y, dtype=np.float64)
    many = min(len(x), len(y))
    x, y = x[:many], y[:many]
    if over_time:
        if many and (np.diff(x) < 0).any():
            order = np.argsort(x, kind="stable")
            x, y = x[order], y[order]
        if trace.style == "line":
            x, y = _broken_at_gaps(x, y)
    if len(x) <= most:
        rows = np.arange(len(x), dtype=np.intp)
    elif over_time:
        rows = _envelope(x, y, most)
    else:
        rows = np.arange(0, many, -(-many // most), dtype=np.intp)
        rows = rows if rows[-1] == many - 1 else np.append(rows, many - 1)
    return ThinTrace(trace.name, x[rows].copy(), y[rows].copy(), trace.style, many)


def _envelope(x: Numbers, y: Floats, most: int) -> NDArray[np.intp]:
    """Rows of the envelope over equal intervals of x. The first NaN of an interval is kept, so that a break is
    visible."""
    many = len(x)
    # Use intervals of x instead of the count: a burst must not use up the points of the rest.
    where = x.astype(np.float64) - float(x[0])
    intervals = max(most // 4, 1)
    scale = intervals / where[-1] if where[-1] > 0.0 else 0.0
    numbered = np.minimum((where * scale).astype(np.int64), intervals - 1)
    first = np.flatnonzero(np.concatenate(([True], numbered[1:] != numbered[:-1])))
    last = np.append(first[1:], many) - 1
    of = np.repeat(np.arange(len(first)), last - first + 1)
    numbers = np.isfinite(y)
    least = np.minimum.reduceat(np.where(numbers, y, np.inf), first)
    greatest = np.maximum.reduceat(np.where(numbers, y, -np.inf), first)
    extremes = [_one_each(np.flatnonzero(numbers & (y == bound[of])), of) for bound in (least, greatest)]
    extremes.append(_one_each(np.flatnonzero(~numbers), of))
    return np.unique(np.concatenate((first, last, *extremes)))


def _one_each(rows: NDArray[np.intp], of: NDArray[np.intp]) -> NDArray[np.intp]:
    """First of these rows in each interval."""
    return rows[np.unique(of[rows], return_index=True)[1]]


def _broken_at_gaps(x: Numbers, y: Floats) -> tuple[Numbers, Floats]:
    """Insert a NaN in every interval without data, because a straight line across would suggest data."""
    if len(x) < 3:
        return x, y
    steps = np.diff(x)
    limit = max(_LEAST_GAP_NS, _GAP_IN_INTERVALS * float(np.median(steps)))
    gaps = np.flatnonzero(steps > limit)
    if not len(gaps) or len(gaps) > len(x) // 10:
        return x, y
    middles = x[gaps] + steps[gaps] // 2
    return np.insert(x, gaps + 1, middles), np.insert(y, gaps + 1, np.nan)


_MOST_MARKS = 300
_COUNTS = 2**32 - 1
_FLOAT32 = 6e-8  # half a unit in the last place, relative
_ENOUGH = 1e-4  # of the height of a plot


def plot_payload(plot: Plot, time_line: TimeLine) -> dict[str, Any]:
    if plot.figure is not None:
        return {"kind": plot.kind, "figure": plot.figure}
    over_time = plot.kind == "time"
    traces = []
    for trace in plot.traces:
        drawn = thin(trace, over_time=over_time)
        x = time_line.seconds(drawn.x) if over_time else np.asarray(drawn.x, dtype=np.float64)
        traces.append(
            {
                "name": trace.name,
                "style": trace.style,
                "of": drawn.of,
                "x": _instants(x) if over_time else _numbers(x),
                "y": _numbers(drawn.y),
            }
        )
    marks = [
        {
            "from": time_line.second(mark.at_ns),
            "until": time_line.second(mark.at_ns if mark.until_ns is None else mark.until_ns),
            "text": mark.text,
            "severity": int(mark.severity),
        }
        for mark in plot.marks[:_MOST_MARKS]
    ]
    return {"kind": plot.kind, "y": plot.y_label, "xLabel": plot.x_label, "traces": traces, "marks": marks}


def thinned_note(plot: Plot) -> str:
    """Note for a plot that does not draw every point; "" if it does."""
    drawn = [thin(trace, over_time=plot.kind == "time") for trace in plot.traces]
    of, shown = sum(trace.of for trace in drawn), sum(len(trace.x) for trace in drawn)
    if of <= shown:
        return ""
    kept = "extremes kept" if plot.kind == "time" else "evenly thinned"
    return f"{of} points drawn as {shown}, {kept}"


def map_payload(overview: Overview) -> dict[str, Any]:
    return {
        "kind": "track",
        "tracks": [
            {
                "name": track.name,
                "t": _instants(track.at_s),
                "east": _numbers(track.east_m),
                "north": _numbers(track.north_m),
                "speed": None if track.speed_mps is None else _numbers(track.speed_mps),
            }
            for track in overview.tracks
        ],
        "waypoints": [[point.name, round(point.east_m, 3), round(point.north_m, 3)] for point in overview.waypoints],
        "chart": None if overview.chart is None else _chart_payload(overview.chart),
    }


def _chart_payload(chart: Chart) -> dict[str, Any]:
    return {
        "tiles": [
            {
                "source": f"data:{tile.media_type};base64,{base64.b64encode(tile.image).decode()}",
                "west": tile.west_m,
                "north": tile.north_m,
                "width": tile.east_m - tile.west_m,
                "height": tile.north_m - tile.south_m,
            }
            for tile in chart.tiles
        ],
        "shapes": [
            {
                "kind": shape.kind.value,
                "rings": [np.round(_thinned(ring), 2).tolist() for ring in shape.rings_en_m],
                "name": shape.style.name,
                "fill": _rgba(shape.style.fill, shape.style.fill_opacity),
                "stroke": _rgba(shape.style.stroke, shape.style.stroke_opacity),
                "width": shape.style.stroke_width_px,
                "marker": shape.style.marker,
            }
            for shape in chart.shapes
        ],
    }


def _thinned(ring: Floats) -> Floats:
    """Return at most MOST_CHART_POINTS points of a line, the first and the last among them."""
    many = -(-len(ring) // MOST_CHART_POINTS)
    return ring if many <= 1 else np.concatenate([ring[:-1:many], ring[-1:]])


def _rgba(colour: str, opacity: float) -> str:
    red, green, blue = (int(colour[first : first + 2], 16) for first in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:g})"


def page_payload(page: Page) -> dict[str, Any]:
    # First and last second of all time plots; of the marks if there are none.
    bounds: list[float] = []
    for part in page.parts:
        for plot in part.section.plots:
            if plot.kind == "time":
                bounds += _ends(plot.traces, part.time_line)
    if page.overview is not None:
        for plot in page.overview.plots:
            bounds += _ends(plot.traces, TimeLine())
        bounds += [at for track in page.overview.tracks for at in (track.at_s[0], track.at_s[-1])]
    bounds = bounds or [bound for mark in page.marks for bound in (mark.from_s, mark.until_s)] or [0.0, 1.0]
    low, high = float(min(bounds)), float(max(bounds))
    return {
        "range": ([low, high] if high > low else [low - 0.5, high + 0.5]),
        "marks": [
            {
                "kind": mark.kind,
                "from": mark.from_s,
                "until": mark.until_s,
                "text": mark.text,
                "severity": int(mark.severity),
            }
            for mark in page.marks
        ],
    }


def signals_payload(held: HeldLog) -> dict[str, Any]:
    """Data of the picker: a source of report/assets/expressions.js, with packed arrays."""
    return {
        "label": held.label,
        "tables": [
            {
                "name": table.name,
                "instance": table.instance,
                "t": _instants(table.at_s),
                "columns": {column.name: _held_column(column) for column in table.columns},
            }
            for table in held.tables
        ],
    }


def json_text(content: Any) -> str:
    """JSON that is safe inside a script element: no markup can begin in it."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _ends(traces: tuple[Trace, ...], time_line: TimeLine) -> list[float]:
    return [time_line.second(int(end)) for trace in traces if len(trace.x) for end in (trace.x.min(), trace.x.max())]


def _instants(at_s: Floats) -> dict[str, Any]:
    """Instants as counts of a 2³²th of their span: 1 µs or better in an hour, in half the bytes of a float64."""
    if not len(at_s):
        return _numbers(at_s)
    first = float(at_s.min())
    step = (float(at_s.max()) - first) / _COUNTS or 1.0
    counts = np.rint((at_s - first) / step).astype("<u4")
    return {"type": "u4", "data": _text(counts), "first": first, "step": step}


def _numbers(values: Floats) -> dict[str, Any]:
    """Values as float32 if the difference is invisible. Infinite values become NaN, which is not drawn."""
    finite = np.isfinite(values)
    known = values[finite]
    kept = np.where(finite, values, np.nan)
    largest = float(np.abs(known).max()) if len(known) else 0.0
    height = float(known.max() - known.min()) if len(known) else 0.0
    if largest < 1e38 and (height == 0.0 or largest * _FLOAT32 <= height * _ENOUGH):
        return {"type": "f4", "data": _text(kept.astype("<f4"))}
    return {"type": "f8", "data": _text(kept.astype("<f8"))}


def _held_column(column: HeldColumn) -> dict[str, Any]:
    values = column.values
    packed = _numbers(values)
    if len(values) and np.isfinite(values[0]) and (values == values[0]).all():
        packed = {"type": "constant", "value": float(values[0]), "many": len(values)}
    return {"unit": column.unit, "held": column.held, "values": packed}


def _text(values: NDArray[Any]) -> str:
    return base64.b64encode(values.tobytes()).decode("ascii")
