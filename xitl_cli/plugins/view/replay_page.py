"""Write a recording as one HTML page that plays it. The page opens from the disk and needs no network.

`ReplayDrawing` draws instant by instant, viser's serializer records the drawing, and viser's player shows it.
replay_page.js adds marks, numbers, events, findings and a camera that follows.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.extras import VIEW
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.report.model import Report
from xitl_cli.logs.report.page import Replay
from xitl_cli.plugins.view.camera import FOLLOW, usual_pose
from xitl_cli.plugins.view.instruments import InstrumentPanel, instruments_html
from xitl_cli.plugins.view.look import look_html
from xitl_cli.plugins.view.model import Points, ViewInstant
from xitl_cli.plugins.view.recording import LogScene, SceneFinding, open_scene, scene_of
from xitl_cli.plugins.view.replay import ReplayDrawing, unseen_server

RATE_HZ = 10.0
MOST_INSTANTS = 6000
INSTRUMENTS_S, MOST_INSTRUMENTS = 0.5, 1500
"""Time between two changes of the instruments, and the largest number of changes."""
CLOUD_S = 1.0
MOST_POINTS, MOST_MAP_POINTS, MAPS = 1200, 8000, 12
POINT_STEP_M = 0.05
_MOST_LISTED = 400
View = Literal["behind", "beside", "above", "all"]
MOST_REPLAY_BYTES = 12_000_000
"""Maximum size of a replay on the page of a report."""


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
        requested = f"from {begin_s if from_s is None else from_s:g} s to {end_s if to_s is None else to_s:g} s"
        raise UserError(
            f"no data {requested}: the recording is from {begin_s:.2f} s to {end_s:.2f} s; choose other times"
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
    with scene_of(recording) as scene:
        span = checked_span(scene, from_s, to_s)
        rate_hz = min(RATE_HZ, MOST_INSTANTS / span.length_s)
        with unseen_server() as server:
            drawing = ReplayDrawing(server, scene, dark=dark, page=True)
            every_s = max(INSTRUMENTS_S, span.length_s / MOST_INSTRUMENTS)
            instruments = InstrumentPanel(server, scene.scene, drawing.track_colours, every_s)
            instants = _PageInstants(scene, span)
            first = instants.at(span.from_s)
            drawing.draw(first)
            instruments.update(first)
            serializer = server.get_scene_serializer()
            count = max(math.ceil(span.length_s * rate_hz), 1)
            for number in range(1, count + 1):
                serializer.insert_sleep(span.length_s / count)
                instant = instants.at(span.from_s + span.length_s * number / count)
                drawing.draw(instant)
                instruments.update(instant)
            html: str = serializer.as_html(dark_mode=dark)
        results = scene.findings() if findings is None else findings
        here = files("xitl_cli.plugins.view")
        script, style = ((here / f"replay_page.{kind}").read_text(encoding="utf-8") for kind in ("js", "css"))
        text = json.dumps(_page_data(scene, span, results, view, at_s), ensure_ascii=False, allow_nan=False).replace(
            "<", "\\u003c"
        )
        mark = "<script>document.documentElement.classList.add('replay-dark')</script>" if dark else ""
        overlay = (
            f"<style>{style}</style>{mark}"
            f'<script type="application/json" id="replay-data">{text}</script><script>{script}</script>'
        )
        before, head, rest = html.partition("<head>")
        end = rest.rindex("</body>")
        return before + head + look_html() + instruments_html() + rest[:end] + overlay + rest[end:]


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
        elapsed_s = time_s - self._span.from_s
        cloud_turn, map_turn = math.floor(elapsed_s / CLOUD_S), math.floor(elapsed_s / self._map_s)
        renewed = cloud_turn != self._turns[0]
        instant = self._recording.instant(time_s, seen=renewed)
        if renewed:
            for name, vessel in instant.vessels.items():
                before, clouds = self._seen.get(name, {}), dict[str, Points]()
                for sensor, points in vessel.clouds.items():
                    if sensor == "map" and sensor in before and map_turn == self._turns[1]:
                        clouds[sensor] = before[sensor]
                        continue
                    most = MOST_MAP_POINTS if sensor == "map" else MOST_POINTS
                    some = points[:: max(-(-len(points) // most), 1)]
                    clouds[sensor] = (np.round(some / POINT_STEP_M) * POINT_STEP_M).astype(np.float32)
                self._seen[name] = clouds
            self._turns = cloud_turn, map_turn
        vessels = {name: replace(vessel, clouds=self._seen.get(name, {})) for name, vessel in instant.vessels.items()}
        return replace(instant, vessels=vessels)


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
        "vessels": [_vessel_data(recording, name) for name in recording.names],
        "marks": [{"time_s": mark.time_s, "text": mark.text} for mark in recording.marks if inside(mark.time_s)][
            :_MOST_LISTED
        ],
        "findings": [
            {
                "time_s": None if finding.time_s is None else round(finding.time_s, 2),
                "severity": finding.severity.name.lower(),
                "sentence": finding.sentence,
                "next_step": finding.next_step,
            }
            for finding in findings
            if inside(finding.time_s)
        ][:_MOST_LISTED],
        "notes": list(recording.scene.notes),
    }


def _vessel_data(recording: LogScene, name: str) -> dict[str, Any]:
    length_m = recording.scene.vessels[name].length_m
    return {
        "name": name,
        "path": f"/vessels/{name or 'vessel'}",
        "distance_m": round(max(4.0 * length_m, 4.0), 2),
        "behind_m": np.round(usual_pose(FOLLOW, length_m).offset_m(0.0), 2).tolist(),
    }


def report_replay(report: Report, vessel: str | None) -> Replay:
    """Return the 3D replay of a report's logs, or the reason why there is none."""
    if VIEW.missing:
        return Replay(note=f"the 3D replay needs {', '.join(VIEW.missing)}, which is not installed; {VIEW.pip_line}")
    from xitl_cli.plugins.view.replay_page import replay_html

    by_path = {file.path: file for file in report.files}
    recordings = [file.path for file in report.files if file.format == "mcap"][:1]  # other logs are of the same run
    try:
        chart = report.overview.chart
        with open_scene(recordings or list(by_path)[:1], vessel, None if chart is None else chart.path) as scene:
            page = replay_html(scene, findings=scene.findings_of(report), at_s=scene.span_s[0])
            path, second = scene.lead_second(0)
    except (LogError, UserError) as error:
        return Replay(note=f"no 3D replay: {error}")
    if len(page) > MOST_REPLAY_BYTES:
        size = f"{len(page) / 1e6:.0f} MB, more than {MOST_REPLAY_BYTES / 1e6:.0f}"
        return Replay(note=f"the 3D replay is omitted: it has {size}; `xitl view LOG --html FILE` writes it")
    return Replay(page, late_s=second - by_path[path].time_line.second(0))
