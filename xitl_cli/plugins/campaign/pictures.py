"""Plots of a campaign's page, for plotly, in the page's colours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sim_core.keys import unit_of
from xitl_cli.logs.model.sections import Plot
from xitl_cli.plugins.campaign.bisection import BoundaryFinding
from xitl_cli.plugins.campaign.compare import CampaignComparison
from xitl_cli.plugins.campaign.search import SearchFinding
from xitl_cli.plugins.campaign.search_spec import AxisRange, Search
from xitl_cli.plugins.campaign.sensitivity import Sensitivity
from xitl_cli.plugins.campaign.statistics import Floats, Interval, LogisticSurface, wilson_interval

PASS, FAIL, MAIN, MUTED, LIMIT = "--fine", "--critical", "--trace1", "--muted", "--warning"
_BAND = 0.16
_SURFACE_POINTS = 60
_RATE_BAR = {
    "title": {"text": "pass rate", "side": "top"},
    "thickness": 10,
    "len": 0.7,
    "outlinewidth": 0,
    "tickformat": ".0%",
}


def _figure(key: str, title: str, data: list[dict[str, Any]], layout: dict[str, Any]) -> Plot:
    return Plot(key, title, "", (), "figure", figure={"data": data, "layout": layout})


def titled(key: str) -> str:
    """Return the title of a key or figure, with its unit."""
    unit = unit_of(key)
    return f"{key} ({unit})" if unit else key


def _axis(key: str, **more: Any) -> dict[str, Any]:
    return {"title": {"text": titled(key), "standoff": 6}, **more}


def _line(at: float, across: bool, colour: str, dash: str = "dash") -> dict[str, Any]:
    """Return a line over the whole plot, at a value of x, or of y with `across`."""
    ends = (
        {"xref": "paper", "x0": 0, "x1": 1, "y0": at, "y1": at}
        if across
        else {"yref": "paper", "y0": 0, "y1": 1, "x0": at, "x1": at}
    )
    return {"type": "line", "line": {"color": colour, "width": 1.5, "dash": dash}, **ends}


def boxes(figure: str, axis: str, by_value: Mapping[str, Sequence[float]], limits: Sequence[float]) -> Plot:
    """Return quartiles, whiskers and every run, for each value of an axis."""
    data = [
        {
            "type": "box",
            "name": value,
            "y": list(numbers),
            "boxpoints": "all",
            "jitter": 0.4,
            "pointpos": 0,
            "marker": {"size": 4, "opacity": 0.6, "color": MAIN},
            "line": {"color": MAIN, "width": 1.4},
            "fillcolor": "rgba(0,0,0,0)",
            "hoverinfo": "y",
        }
        for value, numbers in by_value.items()
    ]
    layout = {
        "xaxis": _axis(axis, type="category"),
        "yaxis": _axis(figure),
        "shapes": [_line(limit, True, LIMIT) for limit in limits],
    }
    return _figure(f"boxes.{figure}.{axis}", f"{figure} by {axis}", data, layout)


def histogram(figure: str, values: Sequence[float], limits: Sequence[float]) -> Plot:
    """Return a histogram of runs by a figure, with the limit of its verdict."""
    data = [{"type": "histogram", "x": list(values), "marker": {"color": MAIN}, "opacity": 0.75, "nbinsx": 40}]
    layout = {
        "xaxis": _axis(figure),
        "yaxis": {"title": {"text": "runs", "standoff": 6}},
        "bargap": 0.04,
        "shapes": [_line(limit, False, LIMIT) for limit in limits],
    }
    limit = f"; dashed: the limit {', '.join(f'{limit:g}' for limit in limits)}" if limits else ""
    return _figure(f"histogram.{figure}", f"{figure}, all runs{limit}", data, layout)


def boundary(key: str, search: Search, finding: BoundaryFinding, fit: Floats, where: str) -> Plot:
    """Return the pass rate at each point with its interval, the monotone fit, and the boundary with its band."""
    axis, counts = search.ranges[0], finding.counts
    pairs = zip(counts.passed, counts.runs, strict=True)
    intervals = [wilson_interval(int(passed), int(runs), search.spec.confidence) for passed, runs in pairs]
    rates = counts.rates
    data: list[dict[str, Any]] = [
        {
            "x": counts.at.tolist(),
            "y": fit.tolist(),
            "mode": "lines",
            "name": "monotone fit",
            "line": {"color": MUTED, "width": 1.5},
            "hoverinfo": "skip",
        },
        {
            "x": counts.at.tolist(),
            "y": rates.tolist(),
            "mode": "markers",
            "name": "runs",
            "text": [f"{p} of {n}" for p, n in zip(counts.passed.tolist(), counts.runs.tolist(), strict=True)],
            "marker": {"size": (6 + 2 * np.sqrt(counts.runs / counts.runs.min())).tolist(), "color": MAIN},
            "error_y": {
                "type": "data",
                "symmetric": False,
                "array": [interval.high - rate for interval, rate in zip(intervals, rates, strict=True)],
                "arrayminus": [rate - interval.low for interval, rate in zip(intervals, rates, strict=True)],
                "color": MAIN,
                "thickness": 1.2,
                "width": 3,
            },
        },
    ]
    shapes: list[dict[str, Any]] = [_line(search.spec.pass_rate, True, MUTED, "dot")]
    if finding.estimate is not None:
        low, high = _clipped(finding.estimate.interval, axis)
        band = {"type": "rect", "yref": "paper", "y0": 0, "y1": 1, "x0": low, "x1": high, "layer": "below"}
        shapes += [
            {**band, "fillcolor": FAIL, "opacity": _BAND, "line": {"width": 0}},
            _line(finding.estimate.value, False, FAIL, "solid"),
        ]
    layout = {
        "xaxis": _axis(axis.key, **({"type": "log"} if axis.log else {})),
        "yaxis": {"title": {"text": "pass rate", "standoff": 6}, "range": [-0.04, 1.04], "tickformat": ".0%"},
        "shapes": shapes,
    }
    confidence = f"{100 * search.spec.confidence:g} %"
    title = f"Pass rate along {axis.key}{where}; red: the boundary and its {confidence} interval"
    return _figure(key, title, data, layout)


def _clipped(interval: Interval, axis: AxisRange) -> tuple[float, float]:
    """Return the interval's ends, clipped to the axis."""
    return min(max(interval.low, axis.low), axis.high), min(max(interval.high, axis.low), axis.high)


def boundaries(search: Search, findings: Sequence[SearchFinding], names: Sequence[str]) -> Plot:
    """Return the boundary of each group in one plot."""
    axis = search.ranges[0]
    known = [
        (name, group.found.estimate)
        for name, group in zip(names, findings, strict=True)
        if isinstance(group.found, BoundaryFinding) and group.found.estimate is not None
    ]
    values = [estimate.value for _, estimate in known]
    ends = [_clipped(estimate.interval, axis) for _, estimate in known]
    data = [
        {
            "x": [name for name, _ in known],
            "y": values,
            "mode": "markers",
            "marker": {"size": 9, "color": FAIL},
            "error_y": {
                "type": "data",
                "symmetric": False,
                "array": [high - value for value, (_, high) in zip(values, ends, strict=True)],
                "arrayminus": [value - low for value, (low, _) in zip(values, ends, strict=True)],
                "color": FAIL,
                "thickness": 1.5,
                "width": 5,
            },
        }
    ]
    layout = {"xaxis": {"type": "category"}, "yaxis": _axis(axis.key, range=[axis.low, axis.high])}
    return _figure("boundaries", f"Boundary along {axis.key}", data, layout)


def pass_map(
    across: str,
    up: str,
    x: Floats,
    y: Floats,
    passed: Sequence[bool],
    surface: LogisticSurface | None,
    rate: float,
    others: str,
) -> Plot:
    """Return passed and failed runs over two axes, with coloured cells for several runs at one place."""
    places: dict[tuple[float, float], list[bool]] = {}
    for at_x, at_y, outcome in zip(x.tolist(), y.tolist(), passed, strict=True):
        places.setdefault((at_x, at_y), []).append(outcome)
    rates = [sum(outcomes) / len(outcomes) for outcomes in places.values()]
    data: list[dict[str, Any]] = []
    if surface is not None:
        data += _contours(surface, x, y, rate)
    data.append(
        {
            "x": [place[0] for place in places],
            "y": [place[1] for place in places],
            "mode": "markers",
            "name": "runs",
            "text": [f"{sum(outcomes)} of {len(outcomes)} passed" for outcomes in places.values()],
            "marker": {
                "size": 12 if len(places) < 60 else 8,
                "symbol": ["circle" if at_place >= rate else "x" for at_place in rates],
                "color": rates,
                "cmin": 0,
                "cmax": 1,
                "colorscale": [[0, FAIL], [0.5, LIMIT], [1, PASS]],
                "line": {"width": 0},
                "colorbar": _RATE_BAR,
            },
        }
    )
    layout = {"xaxis": _axis(across), "yaxis": _axis(up)}
    line = f"; line: pass rate {100 * rate:g} % of a logistic surface; dotted: its 95 % band" if surface else ""
    return _figure("map", f"Pass and fail over {across} and {up}{others}{line}", data, layout)


def _contours(surface: LogisticSurface, x: Floats, y: Floats, rate: float) -> list[dict[str, Any]]:
    share = np.linspace(0.0, 1.0, _SURFACE_POINTS)
    across, up = np.meshgrid(share, share)
    surfaces = surface.rates(np.column_stack([across.ravel(), up.ravel()]))
    ticks = {
        "x": (x.min() + share * np.ptp(x)).tolist(),
        "y": (y.min() + share * np.ptp(y)).tolist(),
    }
    drawn = []
    for values, dash, width in zip(surfaces, ("solid", "dot", "dot"), (2.0, 1.2, 1.2), strict=True):
        grid = values.reshape(across.shape)
        if float(grid.min()) < rate < float(grid.max()):
            drawn.append(
                {
                    "type": "contour",
                    **ticks,
                    "z": np.round(grid, 4).tolist(),
                    "contours": {"start": rate, "end": rate, "size": 1, "coloring": "none"},
                    "line": {"color": MUTED, "width": width, "dash": dash, "smoothing": 0.6},
                    "showscale": False,
                    "hoverinfo": "skip",
                }
            )
    return drawn


def effects(sensitivity: Sensitivity) -> Plot:
    """Return bars of the total effects with their intervals, the strongest on top."""
    shown = list(reversed(sensitivity.effects))
    data = [
        {
            "type": "bar",
            "orientation": "h",
            "y": [effect.axis for effect in shown],
            "x": [effect.total for effect in shown],
            "marker": {"color": MAIN},
            "opacity": 0.8,
            "error_x": {
                "type": "data",
                "array": [effect.total_interval.high - effect.total for effect in shown],
                "color": MUTED,
                "thickness": 1.3,
                "width": 4,
            },
        }
    ]
    index = "total index" if sensitivity.method == "sobol" else f"mu* ({unit_of(sensitivity.figure) or 'whole range'})"
    layout = {"xaxis": {"title": {"text": index, "standoff": 6}, "rangemode": "tozero"}, "yaxis": {"type": "category"}}
    return _figure(f"effects.{sensitivity.figure}", f"{sensitivity.figure}: effects of the axes", data, layout)


def differences(comparison: CampaignComparison) -> list[Plot]:
    """Return one plot of the standardised mean differences of all figures with their intervals."""
    known = [
        (of.figure, of.difference)
        for of in comparison.figures
        if of.difference.effect and of.difference.interval is not None and math.isfinite(of.difference.effect)
    ]
    if not known:
        return []
    known.reverse()
    # Interval in the figure's unit, divided by the standard deviation of the differences.
    arms = [of.effect * (of.interval.high - of.mean) / of.mean for _, of in known if of.effect and of.interval]
    data = [
        {
            "x": [of.effect for _, of in known],
            "y": [figure for figure, _ in known],
            "mode": "markers",
            "marker": {"size": 9, "color": MAIN},
            "error_x": {
                "type": "data",
                "array": arms,
                "color": MAIN,
                "thickness": 1.5,
                "width": 4,
            },
        }
    ]
    layout = {
        "xaxis": {"title": {"text": "B - A in standard deviations of the difference (d_z)", "standoff": 6}},
        "yaxis": {"type": "category"},
        "shapes": [_line(0.0, False, MUTED)],
    }
    return [_figure("differences", "Differences with their intervals", data, layout)]
