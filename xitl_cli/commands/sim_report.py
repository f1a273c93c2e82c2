"""How a run went, for a person at a terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from xitl_cli.profile import Profile
from xitl_cli.run import directory
from xitl_cli.run.session import Result


def show_result(console: Console, profile: Profile, result: Result) -> None:
    """The summary as tables, readable at 80 columns and without colour."""
    summary = result.summary
    mission, estimation = summary["mission"], summary["estimation"]
    table = Table.grid(padding=(0, 2))
    table.add_row(
        "profile", f"{summary['profile']} ({summary['technique']}, {summary['clock']}, seed {summary['seed']})"
    )
    table.add_row("realism", f"WDRI {summary['wdri']:.2f}")
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
    console.print(table, highlight=False)
    for rows in (_links(summary["links"]), _tasks(summary["tasks"]), _clocks(summary["clocks"])):
        if rows is not None:
            console.print(rows, highlight=False)
    console.print(
        f"{result.directory}/: {directory.RECORDING} (opens in Foxglove and Lichtblick), "
        f"{directory.SUMMARY}, {directory.PROFILE}"
        + (f", {directory.DATAFLASH}" if (result.directory / directory.DATAFLASH).exists() else ""),
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


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
    table = _table("node", "task", "Hz", "cycles", "missed", "late max µs", "run max µs")
    for task in tasks:
        table.add_row(
            task["node"],
            task["task"],
            f"{task['rate_hz']:g}",
            _count(task["cycles"]),
            _count(task["missed"]),
            _number(task["start_jitter_max_us"]),
            _number(task["run_max_us"]),
        )
    return table


def _clocks(clocks: list[dict[str, Any]]) -> Table | None:
    if not clocks:
        return None
    table = _table("clock", "offset µs", "± µs", "drift ppm")
    for clock in clocks:
        table.add_row(
            clock["node"],
            _number(clock["offset_us"]),
            _number(clock["asymmetry_bound_us"]),
            "–" if clock["drift_ppm"] is None else f"{clock['drift_ppm']:.2f}",
        )
    return table


def _table(*columns: str) -> Table:
    table = Table(box=None, header_style="bold", pad_edge=False, padding=(0, 2, 0, 0))
    for number, column in enumerate(columns):
        text = number == 0 or column == "task"
        table.add_column(column, justify="left" if text else "right")
    return table


def _count(value: int | None) -> str:
    return "–" if value is None else str(value)


def _number(value: float | None, unit: str = "") -> str:
    if value is None:
        return "–"
    digits = 0 if abs(value) >= 100 or value == 0 else 2 if unit else 1
    return f"{value:.{digits}f}{' ' if unit and unit != '°' else ''}{unit}"
