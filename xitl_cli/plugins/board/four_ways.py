"""One mission in four ways: in process, as a loopback, on an emulated board, and on a real board if available."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from sim_core.dataclass import dataclass
from xitl_cli.experiment.report import Told, told_text
from xitl_cli.experiment.setup import ExperimentSetup
from xitl_cli.experiment.time_series import Floats, true_path_ne_m
from xitl_cli.logs import open_log
from xitl_cli.logs.compare.comparison import compare
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.sections import Grid, Plot, Section, Trace
from xitl_cli.plugins.board.emulator import the_reached_board

PAGE = "four-ways.html"
EMULATED = (
    "An emulated board is not hardware: its nodes have the weight of virtual nodes, and the emulator sets its timing."
)
_KEPT = {True: "yes", False: "no", None: "lockstep"}


@dataclass(frozen=True, slots=True)
class Way:
    """One of the runs."""

    title: str
    extends: str
    """Profile that it extends."""
    keys: str = ""
    """Keys that differ, as YAML."""
    summary: Mapping[str, Any] | None = None
    """Summary as the run wrote it."""
    path_ne_m: Floats | None = None
    """True path, (N, 2)."""
    off_path_m: tuple[Told, Told] = (None, None)
    """RMS and largest distance from the first run's path."""


def ways(emulated: str | None, real: str | None) -> Iterator[Way]:
    """Yield the runs. emulated: name of a running emulated board. real: URL of a board's agent. Raises UserError."""
    yield Way("in process", "sitl")
    yield Way("loopback", "hitl-beaglebone-loopback")
    if emulated is not None:
        board = the_reached_board(emulated, f"xitl board compare {emulated}")
        link = f"udp://{board.address}:{board.autopilot_port}"
        yield Way("emulated board", "hitl-virtual-board", f"autopilot: {{link: {link!r}}}\n")
    if real is not None:
        yield Way("real board", "hitl-beaglebone", f"autopilot: {{link: {real!r}}}\n")


def sail(setup: ExperimentSetup, chosen: Sequence[Way]) -> list[Way]:
    """Run all, one after the other. Raises UserError if a run cannot be set up, and InterruptedRunError."""
    sailed: list[Way] = []
    first: Path | None = None
    for number, way in enumerate(chosen, 1):
        setup.tell(f"{way.title}: {way.extends}")
        text = f"# {way.title}\nextends: {way.extends}\ndescription: The same mission, {way.title}\n{way.keys}"
        overrides = {"clock.seed": setup.seed, "clock.duration_s": setup.duration_s}
        result = setup.run_profile(f"{number}-{way.title.replace(' ', '-')}", text, overrides)
        off_path_m = (None, None) if first is None else _off_path_m(first, result.recording)
        first = first or result.recording
        with open_log(result.recording) as log:
            path_ne_m = true_path_ne_m(log)
        sailed.append(replace(way, summary=result.summary, path_ne_m=path_ne_m, off_path_m=off_path_m))
    return sailed


def _off_path_m(first: Path, other: Path) -> tuple[Told, Told]:
    """Return RMS and largest distance; None if either run is too short."""
    with open_log(first) as a, open_log(other) as b:
        try:
            sections = compare(a, b, of_a="truth", of_b="truth").sections
        except LogError:
            return None, None
    facts = {fact.key: fact.value for section in sections for fact in section.facts}
    return facts.get("path_rms_m"), facts.get("path_max_m")


def table(sailed: Sequence[Way]) -> list[list[str]]:
    """Return a row for each quantity: its name, and its value in each run."""
    columns = [dict(_quantities(way.summary or {}, way.off_path_m)) for way in sailed]
    return [[name, *(told_text(column.get(name)) for column in columns)] for name in columns[0]]


def _quantities(summary: Mapping[str, Any], off_path_m: tuple[Told, Told]) -> Iterator[tuple[str, Told]]:
    mission, estimation = summary.get("mission") or {}, summary.get("estimation") or {}
    links = {link["name"]: link for link in summary.get("links") or ()}
    clock: Mapping[str, Any] = next((clock for clock in summary.get("clocks") or () if clock["node"] == "LC"), {})
    age = (summary.get("actuators") or {}).get("age_us") or {}
    tasks = [task for task in summary.get("tasks") or () if task["node"] == "LC" and task["task"] == "control"]
    verdict, graph = summary.get("verdict") or {}, summary.get("graph") or {}
    node: Mapping[str, Any] = next(iter(summary.get("nodes") or ()), {})
    yield "machine", node.get("machine") or "this process"
    yield "kept real time", _KEPT[verdict.get("real_time")]
    yield "waypoints", f"{mission.get('waypoints_reached', 0)} of {mission.get('waypoints_total', 0)}"
    yield "cross-track RMS, m", mission.get("cross_track_rms_m")
    yield "cross-track at most, m", mission.get("cross_track_max_m")
    yield "off the path of the first, RMS, m", off_path_m[0]
    yield "off the path of the first, at most, m", off_path_m[1]
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
    """Write one page with the paths and the table. It loads nothing from elsewhere. Raises LogError."""
    from xitl_cli.logs.report.html import write_sections

    known = [(way.title, *way.path_ne_m.T) for way in sailed if way.path_ne_m is not None and len(way.path_ne_m)]
    paths = tuple(Trace(title, east, north) for title, north, east in known)
    plots = (Plot("paths", "Paths over ground", "north (m)", paths, "map", "east (m)"),) if paths else ()
    rows = tuple((name, *values) for name, *values in table(sailed))
    grid = Grid("quantities", "Measured quantities", ("", *(way.title for way in sailed)), rows)
    lacks = () if paths else ("No positions were recorded.",)
    section = Section("ways", "Side by side", grids=(grid,), plots=plots, lacks=lacks)
    write_sections(path, f"The same mission, {len(sailed)} ways", EMULATED, [section])
