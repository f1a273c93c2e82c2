"""Panel next to the picture: numbers of each vessel, plots of the last minute, and messages."""

from __future__ import annotations

import html
import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from xitl_cli.plugins.view.drawing import ESTIMATE, GUIDED, TARGET, stream_arrows
from xitl_cli.plugins.view.model import Colour, VesselInstant, ViewEvent, ViewInstant, ViewScene
from xitl_cli.plugins.view.scene import PLAIN_LENGTH_M

if TYPE_CHECKING:
    import viser

PLOT_S = 60.0
"""Span of simulation time in a plot."""
SAMPLES = 300
EVENTS = 6
REFRESH_S = 0.2
PLOTS = ("speed m/s", "cross-track m", "estimate off m", "links lost", "deadline misses", "clock offset ms")
"""Plotted values in this order, if an instant has them. The table shows all values of the instant."""
COLOURS = ("#e8590c", "#1c7ed6", "#0ca678", "#d6336c", "#7048e8", "#f08c00")
AXIS: Any = {
    "stroke": "#868e96",
    "grid": {"stroke": "rgba(134,142,150,.25)", "width": 1},
    "ticks": {"stroke": "rgba(134,142,150,.5)", "width": 1, "size": 4},
}
"""Colours that are visible by day and by night."""


class Readouts:
    """The panel. Call `update` with each instant."""

    def __init__(self, server: viser.ViserServer, scene: ViewScene) -> None:
        self._server = server
        self._names = list(scene.vessels) or [""]
        self._shown_s = -math.inf
        self._before: tuple[float, float] | None = None
        self._events: deque[ViewEvent] = deque(maxlen=EVENTS)
        self._series: dict[tuple[str, str], deque[tuple[float, float]]] = {}
        self._plots: dict[str, Any] = {}
        gui = server.gui
        self._subject = None
        if len(self._names) > 1:
            self._subject = gui.add_dropdown("Vessel", tuple(self._names), initial_value=self._names[0], order=2.0)
            self._subject.on_update(self._refresh)
        self._table = gui.add_html("", order=3.0)
        self._lengths_m = {name: vessel.length_m for name, vessel in scene.vessels.items()}
        with gui.add_folder("Legend", order=3.5):
            self._legend = gui.add_html("", order=0.0)
        self._plot_folder = gui.add_folder("Plots", order=4.0)
        self._messages = gui.add_html("", order=5.0)
        for note in scene.notes:
            gui.add_markdown(html.escape(note), order=6.0)

    def _refresh(self, event: object) -> None:
        self._shown_s = -math.inf

    @property
    def _name(self) -> str:
        return self._names[0] if self._subject is None else str(self._subject.value)

    def update(self, instant: ViewInstant, now_s: float) -> None:
        """Add an instant. The panel changes a few times per second. now_s: wall clock time."""
        self._events.extend(instant.events)
        for name, vessel in instant.vessels.items():
            for label in PLOTS:
                value = vessel.numbers.get(label)
                if value is not None and math.isfinite(value):
                    series = self._series.setdefault((name, label), deque(maxlen=SAMPLES))
                    if series and instant.time_s < series[-1][0]:
                        series.clear()
                    if not series or instant.time_s - series[-1][0] >= PLOT_S / SAMPLES:
                        series.append((instant.time_s, value))
        if now_s - self._shown_s < REFRESH_S:
            return
        self._shown_s = now_s
        chosen = instant.vessels.get(self._name)
        if chosen is not None:
            self._table.content = table_html(instant, chosen)
            self._draw_plots(instant.time_s)
            first = next(iter(instant.vessels))  # the arrows are at this vessel
            legend = legend_html(instant, self._lengths_m.get(first, PLAIN_LENGTH_M))
            if self._legend.content != legend:
                self._legend.content = legend
        if self._events:
            self._messages.content = events_html(list(self._events))

    def _draw_plots(self, time_s: float) -> None:
        name = self._name
        for number, label in enumerate(PLOTS):
            series = self._series.get((name, label))
            plot = self._plots.get(label)
            if not series or len(series) < 2:
                if plot is not None and plot.visible:
                    plot.visible = False
                continue
            times, values = np.array(series).T
            recent = times >= time_s - PLOT_S
            data = times[recent], values[recent]
            if len(data[0]) < 2:
                continue
            if plot is None:
                line = {"label": label, "stroke": COLOURS[number], "width": 2, "points": {"show": False}}
                with self._plot_folder:
                    self._plots[label] = self._server.gui.add_uplot(
                        data=data,
                        series=({"label": "s"}, line),
                        title=label,
                        scales={"x": {"time": False, "auto": True}, "y": {"auto": True}},
                        axes=({"size": 24, **AXIS}, {"size": 46, **AXIS}),
                        legend={"show": False},
                        height=110,
                        order=4.0 + 0.01 * number,
                    )
            else:
                plot.data = data
                if not plot.visible:
                    plot.visible = True


def table_html(instant: ViewInstant, vessel: VesselInstant) -> str:
    """Return a table of time, mode, armed state, waypoint and all numbers."""
    armed = "armed" if vessel.armed else "disarmed"
    rows = [
        ("time", f"{instant.time_s:.1f} s{' · paused' if instant.paused else ''}"),
        ("mode", f"{vessel.mode or '–'} · {armed}"),
    ]
    if math.isfinite(instant.pace):
        rows.insert(1, ("pace", f"{instant.pace:.1f} × real time"))
    if vessel.waypoints_total:
        rows.append(("waypoint", f"{vessel.waypoints_reached} of {vessel.waypoints_total}"))
    for label, value in vessel.numbers.items():
        name, _, unit = label.rpartition(" ")
        if unit in UNITS and name:
            rows.append((name, f"{_number(value)} {unit}"))
        else:
            rows.append((label, _number(value)))
    cells = "".join(
        f"<tr><td style='opacity:.65;padding:1px 10px 1px 0;white-space:nowrap'>{html.escape(name)}</td>"
        f"<td style='text-align:right;width:100%;font-variant-numeric:tabular-nums'>{html.escape(text)}</td></tr>"
        for name, text in rows
    )
    return (
        "<div style='padding:0 12px;font-size:13px;line-height:1.35'>"
        f"<table style='width:100%;border-collapse:collapse'>{cells}</table></div>"
    )


UNITS = ("m/s", "m", "s", "ms", "µs", "°", "ppm", "Hz")


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "–"
    return f"{value:.0f}" if value == int(value) and abs(value) < 1e9 else f"{value:.2f}"


@dataclass(frozen=True, slots=True)
class LegendEntry:
    """A colour of the picture and its meaning."""

    colour: Colour
    name: str
    scale: str = ""


def arrow_legend(length_m: float) -> tuple[LegendEntry, ...]:
    """Return the legend entries of the arrows at a vessel of this length, each with its scale."""
    return tuple(
        LegendEntry(arrow.colour, arrow.name, f"1 m of arrow = {1.0 / arrow.m_per_mps:.2g} m/s")
        for arrow in stream_arrows(length_m)
    )


def legend_html(instant: ViewInstant, length_m: float) -> str:
    """Return the legend: arrows at a vessel of this length with their scale, and the marks of this instant."""
    vessels = instant.vessels.values()
    entries = list(arrow_legend(length_m))
    if any(vessel.target_enu_m is not None for vessel in vessels):
        entries.append(LegendEntry(TARGET, "next waypoint"))
    if any(vessel.guided_enu_m is not None for vessel in vessels):
        entries.append(LegendEntry(GUIDED, "GUIDED target"))
    if any(vessel.estimate_position_enu_m is not None for vessel in vessels):
        entries.append(LegendEntry(ESTIMATE, "estimate"))
    rows = "".join(
        "<div style='display:flex;align-items:center;gap:8px'>"
        "<span style='flex:none;width:18px;height:9px;border:1px solid #868e96;border-radius:2px;"
        f"background:rgb{entry.colour}'></span><span style='flex:1'>{html.escape(entry.name)}</span>"
        f"<span style='white-space:nowrap;opacity:.65'>{html.escape(entry.scale)}</span></div>"
        for entry in entries
    )
    return (
        f"<div class='xitl-legend' style='padding:0 12px;font-size:12px;line-height:1.35'>{rows}"
        "<div style='opacity:.65'>Arrows point to where wind and current go. "
        f"The vessel is {length_m:.2g} m long.</div></div>"
    )


def events_html(events: list[ViewEvent]) -> str:
    """Return the messages, the latest first."""
    lines = "".join(
        "<div style='padding:2px 0;{}'>{}</div>".format(
            "color:#e03131" if event.severity <= WARNING else "opacity:.75",
            html.escape(f"{event.time_s:.1f} s  {event.text}"),
        )
        for event in reversed(events)
    )
    return f"<div style='padding:0 12px;font-size:12px;line-height:1.3;overflow-wrap:anywhere'>{lines}</div>"
