"""Panel next to the picture: plots of the last minute, and messages."""

from __future__ import annotations

import html
import math
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from xitl_cli.plugins.view.model import ViewEvent, ViewInstant, ViewScene

if TYPE_CHECKING:
    import viser

PLOT_S = 60.0
"""Span of simulation time in a plot."""
SAMPLES = 300
EVENTS = 6
REFRESH_S = 0.2
PLOTS = ("speed m/s", "cross-track m", "estimate off m", "links lost", "deadline misses", "clock offset ms")
"""Plotted values in this order, if an instant has them."""
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
        self._plot_folder: Any = None
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
        if self._name in instant.vessels:
            self._draw_plots(instant.time_s)
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
                if self._plot_folder is None:
                    self._plot_folder = self._server.gui.add_folder("Plots", order=4.0, expand_by_default=False)
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
