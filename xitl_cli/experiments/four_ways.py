"""The same mission four ways: in process, as a loopback, on an emulated board, and on a real one where there is one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from xitl_cli.board.emulator import the_reached_board
from xitl_cli.experiments.report import told_text
from xitl_cli.experiments.setup import ExperimentSetup, write_file
from xitl_cli.experiments.time_series import Floats
from xitl_cli.logs import open_log

PAGE = "four-ways.html"
_COLOURS = ("#1b6ca8", "#c2571a", "#3a8f4d", "#8a3ab9")
_KEPT = {True: "yes", False: "no", None: "lockstep"}
_WIDTH, _HEIGHT = 640, 420
_STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse}td,th{padding:.25rem .8rem;text-align:right;border-bottom:1px solid #ccc}"
    "td:first-child,th:first-child{text-align:left}svg{width:100%;height:auto}"
)


@dataclass(frozen=True, slots=True)
class Way:
    """One of the runs: its title, what it extends, and the keys that differ. path_ne_m (N, 2); summary: as written."""

    title: str
    extends: str
    keys: str = ""
    summary: Mapping[str, Any] | None = None
    path_ne_m: Floats | None = None


def ways(emulated: str | None, real: str | None) -> Iterator[Way]:
    """emulated: the name of an emulated board that runs. real: the URL of an agent on a board. Raises UserError."""
    yield Way("in process", "sitl")
    yield Way("loopback", "hitl-beaglebone-loopback")
    if emulated is not None:
        board = the_reached_board(emulated, f"xitl board compare {emulated}")
        link = f"udp://{board.address}:{board.autopilot_port}"
        yield Way("emulated board", "hitl-virtual-board", f"autopilot: {{link: {link!r}}}\n")
    if real is not None:
        yield Way("real board", "hitl-beaglebone", f"autopilot: {{link: {real!r}}}\n")


def sail(setup: ExperimentSetup, chosen: Sequence[Way]) -> list[Way]:
    """All of them, one after the other. Raises UserError where one cannot be made, and InterruptedRunError."""
    sailed = []
    for number, way in enumerate(chosen, 1):
        setup.tell(f"{way.title}: {way.extends}")
        text = f"# {way.title}\nextends: {way.extends}\ndescription: The same mission, {way.title}\n{way.keys}"
        given = {"clock.seed": setup.seed, "clock.duration_s": setup.duration_s}
        result = setup.run_profile(f"{number}-{way.title.replace(' ', '-')}", text, given)
        sailed.append(Way(way.title, way.extends, way.keys, result.summary, _path_ne_m(result.recording)))
    return sailed


def _path_ne_m(recording: Path) -> Floats:
    with open_log(recording) as log:
        found: Floats = np.asarray(log.tables["/truth/state"].values("position_ned_m"), dtype=np.float64)[:, :2]
        return found


def table(sailed: Sequence[Way]) -> list[list[str]]:
    """A row for each quantity: its name, and its value in each run."""
    columns = [dict(_quantities(way.summary or {})) for way in sailed]
    return [[name, *(told_text(column.get(name)) for column in columns)] for name in columns[0]]


def _quantities(summary: Mapping[str, Any]) -> Iterator[tuple[str, float | int | str | None]]:
    mission, estimation = summary.get("mission") or {}, summary.get("estimation") or {}
    links = {link["name"]: link for link in summary.get("links") or ()}
    clock: Mapping[str, Any] = next((one for one in summary.get("clocks") or () if one["node"] == "LC"), {})
    age = (summary.get("actuators") or {}).get("age_us") or {}
    tasks = [task for task in summary.get("tasks") or () if task["node"] == "LC" and task["task"] == "control"]
    verdict, graph = summary.get("verdict") or {}, summary.get("graph") or {}
    node: Mapping[str, Any] = next(iter(summary.get("nodes") or ()), {})
    yield "machine", node.get("machine") or "this process"
    yield "kept real time", _KEPT[verdict.get("real_time")]
    yield "waypoints", f"{mission.get('waypoints_reached', 0)} of {mission.get('waypoints_total', 0)}"
    yield "cross-track RMS, m", mission.get("cross_track_rms_m")
    yield "cross-track at most, m", mission.get("cross_track_max_m")
    yield "estimate off, RMS, m", estimation.get("position_rms_m")
    for name in ("sensors", "actuators"):
        latency = (links.get(name) or {}).get("latency_us") or {}
        yield f"{name}: latency p50, ms", _milli(latency.get("p50"))
        yield f"{name}: latency p99, ms", _milli(latency.get("p99"))
        yield f"{name}: frames lost", (links.get(name) or {}).get("lost")
    yield "commands old, p50, ms", _milli(age.get("p50"))
    yield "commands old, at most, ms", _milli(age.get("max"))
    yield "control cycles", sum(task["cycles"] for task in tasks) if tasks else None
    yield "control cycles missed", sum(task["missed"] for task in tasks) if tasks else None
    yield "clock drift, ppm", clock.get("drift_ppm")
    yield "clock steps", clock.get("steps")
    yield "CPU of the agent, %", node.get("cpu_percent")
    yield "WDRI claimed", (graph.get("claimed") or {}).get("wdri")
    yield "WDRI measured", (graph.get("measured") or {}).get("wdri")


def _milli(value_us: float | None) -> float | None:
    return None if value_us is None else value_us / 1e3


def write_page(sailed: Sequence[Way], path: Path) -> None:
    """One page with the paths and the table; nothing is loaded from elsewhere."""
    head, *rows = [["", *(way.title for way in sailed)], *table(sailed)]
    lines = ["".join(f"<th>{escape(cell)}</th>" for cell in head)]
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    body = "".join(f"<tr>{line}</tr>\n" for line in lines)
    write_file(
        path,
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>The same mission</title>'
        f"<style>{_STYLE}</style></head><body><h1>The same mission, {len(sailed)} ways</h1>\n"
        f"{_drawn_paths(sailed)}\n<table>{body}</table>\n"
        "<p>An emulated board is no hardware: its nodes weigh as virtual ones, and its timing is its emulator's.</p>"
        "</body></html>\n",
    )


def _drawn_paths(sailed: Sequence[Way]) -> str:
    """Paths over ground from above, north up, one scale for both directions."""
    paths = [way.path_ne_m for way in sailed if way.path_ne_m is not None and len(way.path_ne_m)]
    if not paths:
        return "<p>No positions were recorded.</p>"
    together = np.concatenate(paths)
    low, high = together.min(axis=0), together.max(axis=0)
    scale = 0.9 * min(_WIDTH / max(high[1] - low[1], 1.0), _HEIGHT / max(high[0] - low[0], 1.0))
    middle = (low + high) / 2.0
    drawn = []
    for way, colour, row in zip(sailed, _COLOURS, range(len(sailed)), strict=False):
        points = np.zeros((0, 2)) if way.path_ne_m is None else way.path_ne_m[:: max(1, len(way.path_ne_m) // 800)]
        placed = (points - middle) * scale
        corners = " ".join(f"{_WIDTH / 2 + east:.1f},{_HEIGHT / 2 - north:.1f}" for north, east in placed)
        drawn.append(f'<polyline points="{corners}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        drawn.append(f'<text x="8" y="{18 + 18 * row}" fill="{colour}" font-size="14">{escape(way.title)}</text>')
    metres = 10.0 ** np.floor(np.log10(_WIDTH / scale / 3.0))
    drawn.append(f'<path d="M8 {_HEIGHT - 8}h{metres * scale:.1f}" stroke="#444" stroke-width="3"/>')
    drawn.append(f'<text x="8" y="{_HEIGHT - 14}" font-size="12">{metres:g} m</text>')
    return f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="paths from above">{"".join(drawn)}</svg>'
