"""How a run went, for a person at a terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from xitl_cli.commands.sim_autopilot import autopilot_rows
from xitl_cli.commands.sim_incidents import incidents
from xitl_cli.commands.sim_perception import perception_rows
from xitl_cli.profile import Profile
from xitl_cli.run import directory
from xitl_cli.run.session import Result

_MORE = (directory.DATAFLASH, directory.MAP, directory.TRAJECTORY, directory.TRUTH)


def show_result(console: Console, profile: Profile, result: Result) -> None:
    """The summary as tables, readable at 80 columns and without colour."""
    summary = result.summary
    mission, estimation = summary["mission"], summary["estimation"]
    table = Table.grid(padding=(0, 2))
    table.add_row(
        "profile", f"{summary['profile']} ({summary['technique']}, {summary['clock']}, seed {summary['seed']})"
    )
    table.add_row("realism", _realism(summary))
    table.add_row("ended", summary["ended"])
    factor = summary["real_time_factor"]
    table.add_row(
        "time",
        f"{summary['duration_s']:.1f} s in {summary['wall_s']:.1f} s"
        + (f", {factor:.1f}× real time" if factor else ""),
    )
    driver = summary["driver"]
    if driver["kind"] in ("script", "replay"):
        table.add_row(driver["kind"], "played to its end" if driver["completed"] else "not played to its end")
    if mission["waypoints_total"]:
        state = "completed" if mission["completed"] else "not completed"
        table.add_row(
            "mission",
            f"{state}, {mission['waypoints_reached']} of {mission['waypoints_total']} waypoints, "
            f"cross-track RMS {_number(mission['cross_track_rms_m'], 'm')}",
        )
    if estimation["position_rms_m"] is not None:
        table.add_row(
            "estimate off",
            f"{_number(estimation['position_rms_m'], 'm')} RMS in position, "
            f"{_number(estimation['heading_rms_deg'], '°')} in heading",
        )
    for what, text in autopilot_rows(summary["autopilot"]):
        table.add_row(what, Text(text))
    for what, text in (*perception_rows(summary), *incidents(summary)):
        table.add_row(what, Text(text))
    console.print(table, highlight=False)
    for rows in (_links(summary["links"]), _tasks(summary["tasks"]), _clocks(summary["clocks"])):
        if rows is not None:
            console.print(rows, highlight=False)
    if summary["faults"]:
        console.print(_faults(summary["faults"]), highlight=False)
    console.print(
        f"{result.directory}/: {directory.RECORDING} (opens in Foxglove and Lichtblick), "
        + ", ".join(
            (directory.SUMMARY, directory.PROFILE, *(name for name in _MORE if (result.directory / name).exists()))
        ),
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


def _realism(summary: dict[str, Any]) -> str:
    graph = summary["graph"]
    measured = graph["measured"]["wdri"]
    lines = [f"WDRI {summary['wdri']:.2f} claimed, {'none' if measured is None else f'{measured:.2f}'} measured"]
    if graph["missing"]:
        lines.append(f"claimed, but nothing was carried: {', '.join(graph['missing'])}")
    if graph["unclaimed"]:
        lines.append(f"carried, but not claimed: {', '.join(graph['unclaimed'])}")
    return "\n".join(lines)


def _links(links: list[dict[str, Any]]) -> Table | None:
    if not links:
        return None
    table = _table("link", "sent", "received", "lost", "dropped", "p50 µs", "p99 µs", "max µs")
    for link in links:
        latency = link["latency_us"]
        table.add_row(
            link["name"],
            *(_count(link[key]) for key in ("sent", "received", "lost", "dropped")),
            *(_number(latency[key]) for key in ("p50", "p99", "max")),
        )
    return table


def _tasks(tasks: list[dict[str, Any]]) -> Table | None:
    if not tasks:
        return None
    table = _table("node", "task", "Hz", "cycles", "missed", "late p99", "max µs", "run p99", "max µs")
    for task in tasks:
        table.add_row(
            Text(task["node"]),
            Text(task["task"]),
            f"{task['rate_hz']:g}",
            _count(task["cycles"]),
            _count(task["missed"]),
            _number(task["start_jitter_p99_us"]),
            _number(task["start_jitter_max_us"]),
            _number(task["run_p99_us"]),
            _number(task["run_max_us"]),
        )
    return table


def _clocks(clocks: list[dict[str, Any]]) -> Table | None:
    if not clocks:
        return None
    table = _table("clock", "offset", "± µs", "drift ppm", "± ppm", "a sample ms", "± µs", "steps")
    for clock in clocks:
        slope_s, slope_std_s = clock["slope_s"], clock["slope_std_s"]
        table.add_row(
            Text(clock["node"]),
            _offset(clock["offset_us"]),
            _number(clock["asymmetry_bound_us"]),
            *("–" if clock[key] is None else f"{clock[key]:.2f}" for key in ("drift_ppm", "drift_std_ppm")),
            "–" if slope_s is None else f"{slope_s * 1e3:.5f}",
            _number(None if slope_std_s is None else slope_std_s * 1e6),
            _count(clock["steps"]),
        )
    return table


def _faults(faults: list[dict[str, Any]]) -> Table:
    table = _table("fault", "from s", "until s", "what it did")
    table.columns[-1].justify = "left"
    for fault in faults:
        did = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in fault["did"].items())
        table.add_row(
            Text(fault["name"]),
            "never" if fault["from_s"] is None else f"{fault['from_s']:g}",
            "the end" if fault["from_s"] is not None and fault["until_s"] is None else _plain(fault["until_s"]),
            did or "–",
        )
    return table


def _table(*columns: str) -> Table:
    table = Table(box=None, header_style="bold", pad_edge=False, padding=(0, 2, 0, 0))
    for number, column in enumerate(columns):
        text = number == 0 or column == "task"
        table.add_column(column, justify="left" if text else "right")
    return table


def _offset(value_us: float | None) -> str:
    if value_us is None:
        return "–"
    return f"{value_us * 1e-6:.4f} s" if abs(value_us) >= 1e5 else _number(value_us, "µs")


def _plain(value: float | None) -> str:
    return "–" if value is None else f"{value:g}"


def _count(value: int | None) -> str:
    return "–" if value is None else str(value)


def _number(value: float | None, unit: str = "") -> str:
    if value is None:
        return "–"
    digits = 0 if abs(value) >= 100 or value == 0 else 2 if unit else 1
    return f"{value:.{digits}f}{' ' if unit and unit != '°' else ''}{unit}"
