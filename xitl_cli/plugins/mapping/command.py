"""`xitl map`: odometry and map of a recording, recomputed and compared with the truth and with the online result."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from xitl_cli.commands.options import Json, Vessel
from xitl_cli.commands.output import quiet_pipe, tell_damage, tell_vessels
from xitl_cli.commands.terminal import show_rows, terminal
from xitl_cli.errors import UserError
from xitl_cli.logs.model.text import printable

_FORMATS = ("ply", "pcd")


def map_command(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A recording or bag with lidar clouds, or a run's directory.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder of the files (default: the folder of the recording)."),
    ] = None,
    kind: Annotated[str, typer.Option("--format", metavar="ply|pcd", help="Format of the map.")] = "ply",
    vessel: Vessel = None,
    as_json: Json = False,
) -> None:
    """Run the companion's odometry and mapping over a recording: map, trajectories and their errors.

    Writes map.ply (or .pcd), trajectory.tum, truth.tum, online.tum and map.json, and replaces existing files.
    """
    from xitl_cli.extras import PERCEPTION
    from xitl_cli.logs import open_log
    from xitl_cli.logs.formats.run_directory import recording_in
    from xitl_cli.mapping.rebuild import measure, written

    if kind not in _FORMATS:
        raise UserError(f"--format {kind}: is not a format of a map; use ply or pcd")
    missing = [package for package in ("kiss_icp", "scipy") if find_spec(package) is None]
    if missing:
        verb = "is" if len(missing) == 1 else "are"
        raise UserError(f"a map needs {' and '.join(missing)}, which {verb} not installed; {PERCEPTION.pip_line}")
    with open_log(recording, vessel or "") as log:
        if vessel is None:
            tell_vessels((log.path, log.vessel, log.vessels))
        directory = recording_in(recording).parent / log.vessel if out is None else out
        measured = measure(log)
        files = written(measured, directory, "ply" if kind == "ply" else "pcd")
        tell_damage(log)
    with quiet_pipe():
        if as_json:
            print(json.dumps({**measured.report, "files": [str(file) for file in files]}, allow_nan=False))
        else:
            _show(measured.report, files)


def _show(report: dict[str, Any], files: list[Path]) -> None:
    rows = []
    for group, name, unit in (
        ("odometry", "poses", ""),
        ("odometry", "rate_hz", "Hz"),
        ("odometry", "path_m", "m"),
        ("odometry", "ate_rms_m", "m"),
        ("odometry", "ate_max_m", "m"),
        ("odometry", "anchored_rms_m", "m"),
        ("odometry", "anchored_max_m", "m"),
        ("odometry", "anchored_level_rms_m", "m"),
        ("odometry", "rpe_m", "m"),
        ("mapping", "points", ""),
        ("mapping", "boom_points", ""),
        ("mapping", "boom_rms_m", "m"),
        ("mapping", "boom_uncut_points", ""),
        ("mapping", "boom_uncut_rms_m", "m"),
        ("mapping", "coverage", ""),
    ):
        cells = [_cell(report[when][group][name], unit) if report[when] else "–" for when in ("offline", "online")]
        rows.append([f"{group} {name}", *cells])
    for name, value in (report["difference"] or {}).items():
        rows.append([f"offline v. online {name}", _cell(value, ""), ""])
    show_rows(terminal(), ["", "offline", "online"], rows)
    for file in files:
        typer.echo(printable(f"wrote {file}"))


def _cell(value: Any, unit: str) -> str:
    return "–" if value is None else f"{value} {unit}".strip()
