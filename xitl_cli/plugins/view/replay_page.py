"""Write a recording as one HTML page that plays it. The page opens from the disk and needs no network.

`ReplayDrawing` draws instant by instant, viser's serializer records the drawing, and viser's player shows it.
replay_page.js adds marks, numbers, events, findings and a camera that follows.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np

from xitl_cli.errors import UserError
from xitl_cli.plugins.view.model import Points, ViewInstant
from xitl_cli.plugins.view.readouts import arrow_legend
from xitl_cli.plugins.view.recording import LogScene, SceneFinding, open_scene
from xitl_cli.plugins.view.replay import ReplayDrawing, unseen_server

RATE_HZ = 10.0
MOST_INSTANTS = 6000
NUMBERS_HZ = 2.0
MOST_NUMBERS = 1500
CLOUD_S = 1.0
MOST_POINTS, MOST_MAP_POINTS, MAPS = 1200, 8000, 12
POINT_STEP_M = 0.05
_MOST_LISTED = 400
NUMBERS = (
    "speed m/s",
    "heading °",
    "cross-track m",
    "estimate off m",
    "links lost",
    "deadline misses",
    "clock offset ms",
)
"""Labels in the order of display. Other labels follow."""
View = Literal["behind", "beside", "above", "all"]


@dataclass(frozen=True, slots=True)
class Span:
    """Start and end of a replay, on the time line of its scene."""

    from_s: float
    to_s: float

    @property
    def length_s(self) -> float:
        return self.to_s - self.from_s


def checked_span(recording: LogScene, from_s: float | None = None, to_s: float | None = None) -> Span:
    """Return the part of the recording between two times. A time of None selects the recording's own start or end.

    Raises UserError if the span is empty.
    """
    begin_s, end_s = recording.span_s
    span = Span(begin_s if from_s is None else max(from_s, begin_s), end_s if to_s is None else min(to_s, end_s))
    if span.length_s <= 0.0:
        asked = f"from {begin_s if from_s is None else from_s:g} s to {end_s if to_s is None else to_s:g} s"
        raise UserError(
            f"there is nothing {asked}: the recording is from {begin_s:.2f} s to {end_s:.2f} s; choose others"
        )
    return span


def replay_html(
    recording: LogScene | Sequence[Path],
    *,
    from_s: float | None = None,
    to_s: float | None = None,
    findings: Sequence[SceneFinding] | None = None,
    view: View = "behind",
    at_s: float | None = None,
    dark: bool = False,
) -> str:
    """Return one HTML page with the replay.

    recording: an open scene, or paths of logs. findings: findings of the log analysis; None runs the analysis. view:
    initial camera. at_s: instant at which the page is paused initially; None starts playback.

    Raises UserError without the extra `view` and for an empty span. Raises LogError as `open_scene` does.
    """
    if not isinstance(recording, LogScene):
        with open_scene(recording) as opened:
            return replay_html(opened, from_s=from_s, to_s=to_s, findings=findings, view=view, at_s=at_s, dark=dark)
    span = checked_span(recording, from_s, to_s)
    rate_hz = min(RATE_HZ, MOST_INSTANTS / span.length_s)
    with unseen_server() as server:
        drawing = ReplayDrawing(server, recording, dark=dark, page=True)
        instants = _PageInstants(recording, span)
        drawing.draw(instants.at(span.from_s))
        serializer = server.get_scene_serializer()
        many = max(math.ceil(span.length_s * rate_hz), 1)
        for number in range(1, many + 1):
            serializer.insert_sleep(span.length_s / many)
            drawing.draw(instants.at(span.from_s + span.length_s * number / many))
        html = serializer.as_html(dark_mode=dark)
    found = recording.findings() if findings is None else findings
    return _with_overlay(html, _page_data(recording, span, found, view, at_s), dark)


class _PageInstants:
    """Instants with fewer clouds and fewer points per cloud, because a page holds all of them."""

    def __init__(self, recording: LogScene, span: Span) -> None:
        self._recording, self._span = recording, span
        self._map_s = max(span.length_s / MAPS, CLOUD_S)
        self._seen: dict[str, dict[str, Points]] = {}
        self._turns = -1, -1

    def at(self, time_s: float) -> ViewInstant:
        """Return the instant at time_s, with sensor clouds of the latest cloud update.

        Clouds are updated every `CLOUD_S`, the companion's map less often.
        """
        turns = tuple(math.floor((time_s - self._span.from_s) / each) for each in (CLOUD_S, self._map_s))
        anew = turns[0] != self._turns[0]
        instant = self._recording.instant(time_s, seen=anew)
        if anew:
            for name, vessel in instant.vessels.items():
                kept = self._seen.get(name, {})
                self._seen[name] = {
                    sensor: kept[sensor] if sensor == "map" and sensor in kept and turns[1] == self._turns[1] else some
                    for sensor, some in ((sensor, _fewer(sensor, points)) for sensor, points in vessel.clouds.items())
                }
            self._turns = turns[0], turns[1]
        vessels = {name: replace(vessel, clouds=self._seen.get(name, {})) for name, vessel in instant.vessels.items()}
        return replace(instant, vessels=vessels)


def _fewer(sensor: str, points: Points) -> Points:
    most = MOST_MAP_POINTS if sensor == "map" else MOST_POINTS
    some = points[:: max(-(-len(points) // most), 1)]
    rounded: Points = (np.round(some / POINT_STEP_M) * POINT_STEP_M).astype(np.float32)
    return rounded


def _page_data(
    recording: LogScene, span: Span, findings: Sequence[SceneFinding], view: View, at_s: float | None
) -> dict[str, Any]:
    def inside(time_s: float | None) -> bool:
        return time_s is None or span.from_s <= time_s <= span.to_s

    places = np.concatenate([recording.track(name).pose.position_enu_m[:, :2] for name in recording.names])
    low, high = places.min(axis=0), places.max(axis=0)
    return {
        "title": recording.scene.title,
        "begin_s": round(span.from_s, 3),
        "duration_s": round(span.length_s, 3),
        "view": view,
        "at_s": at_s,
        "middle_en_m": np.round((low + high) / 2, 1).tolist(),
        "extent_m": round(max(float(np.linalg.norm(high - low)), 20.0), 1),
        "vessels": [_vessel_data(recording, name, span) for name in recording.names],
        "marks": [{"time_s": mark.time_s, "text": mark.text} for mark in recording.marks if inside(mark.time_s)][
            :_MOST_LISTED
        ],
        "findings": [
            {
                "time_s": None if found.time_s is None else round(found.time_s, 2),
                "severity": found.severity.name.lower(),
                "sentence": found.sentence,
                "next_step": found.next_step,
            }
            for found in findings
            if inside(found.time_s)
        ][:_MOST_LISTED],
        "notes": list(recording.scene.notes),
        "legend": [
            {"colour": f"rgb{entry.colour}", "name": entry.name, "scale": entry.scale}
            for entry in arrow_legend(recording.scene.vessels[recording.names[0]].length_m)
        ],
    }


def _vessel_data(recording: LogScene, name: str, span: Span) -> dict[str, Any]:
    track, length_m = recording.track(name), recording.scene.vessels[name].length_m
    many = int(min(span.length_s * NUMBERS_HZ, MOST_NUMBERS)) + 1
    seconds = np.linspace(span.from_s, span.to_s, many)
    rows = [track.at(time_s, seen=False).numbers for time_s in seconds.tolist()]
    told = {label for row in rows for label in row}
    labels = [label for label in NUMBERS if label in told] + sorted(told - set(NUMBERS))
    return {
        "name": name,
        "path": f"/vessels/{name or 'vessel'}",
        "distance_m": round(max(4.0 * length_m, 4.0), 2),
        "missions": [[round(each.from_s, 2), max(len(each.places_enu_m) - 1, 0)] for each in track.missions],
        "reached_s": np.round(track.reached_s, 2).tolist(),
        "modes": [[round(state.from_s, 2), state.text] for state in track.modes],
        "armed": [[round(state.from_s, 2), round(state.until_s, 2)] for state in track.armed],
        "seconds": np.round(seconds, 2).tolist(),
        "numbers": {label: [_number(row.get(label)) for row in rows] for label in labels},
    }


def _number(value: float | None) -> float | int | None:
    if value is None or not math.isfinite(value):
        return None
    return int(value) if value == int(value) else round(value, 2)


def _with_overlay(html: str, data: dict[str, Any], dark: bool) -> str:
    here = files("xitl_cli.plugins.view")
    script, style = ((here / f"replay_page.{kind}").read_text(encoding="utf-8") for kind in ("js", "css"))
    text = json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    mark = "<script>document.documentElement.classList.add('replay-dark')</script>" if dark else ""
    overlay = (
        f"<style>{style}</style>{mark}"
        f'<script type="application/json" id="replay-data">{text}</script><script>{script}</script>'
    )
    end = html.rindex("</body>")
    return html[:end] + overlay + html[end:]
