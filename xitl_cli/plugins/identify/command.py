"""`xitl identify vessel` and `xitl identify sensors`: parameters of a vehicle, and of its sensors, from logs."""

from __future__ import annotations

import json
import os
import shlex
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.commands.options import Json, Overwrite, Set, complete_vehicle
from xitl_cli.errors import UserError
from xitl_cli.extras import IDENTIFY

if TYPE_CHECKING:
    from xitl_cli.plugins.identify.identification import Identification
    from xitl_cli.plugins.identify.recording import Recording
    from xitl_cli.profile import Profile


def vessel(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG...", help="DataFlash .bin, .tlog, .mcap, bag of ROS, or with --columns a .csv."),
    ],
    vehicle: Annotated[
        str,
        typer.Option(
            "--vehicle",
            metavar="START",
            help="File or name of the vehicle to begin with, or a profile with one.",
            autocompletion=complete_vehicle,
        ),
    ],
    free: Annotated[
        list[str] | None, typer.Option("--free", metavar="KEY", help="Fit this key of the vehicle alone. Repeatable.")
    ] = None,
    fix: Annotated[
        list[str] | None, typer.Option("--fix", metavar="KEY", help="Leave this key as it is. Repeatable.")
    ] = None,
    test: Annotated[
        list[Path] | None,
        typer.Option(
            "--test",
            metavar="LOG",
            help="Keep this log for the test. Repeatable. Default: every third log, or the last 30 % of one or two.",
        ),
    ] = None,
    columns: Annotated[
        Path | None, typer.Option("--columns", metavar="YAML", help="Map of the columns of .csv files.")
    ] = None,
    motion: Annotated[
        str,
        typer.Option("--motion", help="Motion of a .bin: `estimate` of the autopilot, or `receiver` for raw fixes."),
    ] = "estimate",
    window: Annotated[
        float, typer.Option("--window", metavar="S", min=2.0, max=120.0, help="Length of a window.")
    ] = 10.0,
    no_wind: Annotated[bool, typer.Option("--no-wind", help="Fit no wind.")] = False,
    no_surroundings: Annotated[
        bool,
        typer.Option(
            "--no-surroundings", help="Predict the tested logs without fitting their current, wind, biases and delays."
        ),
    ] = False,
    squares: Annotated[bool, typer.Option("--squares", help="Plain least squares, without Huber's weights.")] = False,
    out: Annotated[Path | None, typer.Option("--out", metavar="YAML", help="File of the identified vehicle.")] = None,
    report: Annotated[Path | None, typer.Option("--report", metavar="HTML", help="Page with tables and plots.")] = None,
    overrides: Set = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Fit inertia, damping and propulsion of a vehicle to logs, and test its predictions on other logs.

    Current, wind, biases and delays of each log are fitted too. The thrust ahead is not, as long as it is not named
    with --free: it gives all forces their scale.

    Exit code: 0 done, also with keys that the logs do not determine; 2 an error.
    """
    IDENTIFY.require("`xitl identify` needs")
    from sim_core.environment.spec import Water
    from xitl_cli.commands.terminal import progress
    from xitl_cli.logs.report import html
    from xitl_cli.plugins.identify.identification import Settings, identify
    from xitl_cli.plugins.identify.identification_page import sections, vehicle_text

    if motion not in ("estimate", "receiver"):
        raise UserError(f"--motion {motion}: use estimate or receiver")
    if out is not None and out.exists() and not overwrite:
        raise UserError(f"{out} exists; choose another name, or use --overwrite")
    if report is not None:
        html.refuse_other(report)
    profile, start = _profile(vehicle, overrides or ())
    if out is not None and out.resolve() == start.resolve():
        raise UserError(f"{out} is the vehicle to begin with, which the result extends; choose another name for --out")
    assert profile.vehicle is not None
    recordings = [_recording(path, profile, columns, motion) for path in logs]
    settings = Settings(tuple(free or ()), tuple(fix or ()), window, not no_wind, not squares, not no_surroundings)
    with progress("fitting") as tell:
        water = Water() if profile.environment is None else profile.environment.water
        result = identify(recordings, profile.vehicle, water, settings, [str(path) for path in test or ()], tell)
    if out is not None:
        _write(out, vehicle_text(result, profile, _extended(start, out), shlex.join(["xitl", *sys.argv[1:]])))
    if report is not None:
        html.write_sections(report, f"Identification of {result.vessel.name}", _summary(result), sections(result))
    if as_json:
        typer.echo(json.dumps(result.as_json(), allow_nan=False, ensure_ascii=False))
        return
    _show(result, [path for path in (out, report) if path is not None])


def _extended(start: Path, out: Path) -> str:
    """Return the vehicle to begin with as `extends` names it: a shipped name, or a path relative to the result."""
    from xitl_cli.profile.files.catalogue import profile_name, shipped_profiles

    name, resolved = profile_name(start), start.resolve()
    if (shipped := shipped_profiles().get(name)) is not None and shipped.resolve() == resolved:
        return name
    return Path(os.path.relpath(resolved, out.resolve().parent)).as_posix()


def _profile(vehicle: str, overrides: list[str] | tuple[()]) -> tuple[Profile, Path]:
    from xitl_cli.profile import load_with_origins

    loaded = load_with_origins(vehicle, overrides)
    profile, *others = loaded.profile.one_a_vehicle
    if others or profile.vehicle is None:
        count = "several vehicles" if others else "no vehicle"
        raise UserError(f"{loaded.entry.origin.source}: has {count}; use a file with one group `vehicle`")
    return profile, loaded.path


def _recording(path: Path, profile: Profile, columns: Path | None, motion: str) -> Recording:
    from xitl_cli.plugins.identify.log_recording import read_log
    from xitl_cli.plugins.identify.recording import check_recording
    from xitl_cli.plugins.identify.table_recording import read_column_map, read_table
    from xitl_cli.profile.schema.agents import ReplaySpec

    assert profile.vehicle is not None
    if path.suffix.lower() == ".csv":
        if columns is None:
            raise UserError(f"{path} is a table; give --columns with a map of its columns")
        recording = read_table(path, read_column_map(columns))
        areas = profile.vehicle.wind
        if recording.wind_ne_mps is not None and not areas.frontal_area_m2 + areas.lateral_area_m2:
            raise UserError(
                f"{columns} gives the wind, but vehicle.wind.lateral_area_m2 of {profile.vehicle.name} is 0; add the "
                "areas to the vehicle's file, or remove wind_speed and wind_from"
            )
    else:
        replay = profile.driver.replay if profile.driver is not None else ReplaySpec()
        recording = read_log(path, profile.vehicle, replay, motion)
    return check_recording(recording, profile.vehicle.commands)


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}); choose another place") from error


def _summary(result: Identification) -> str:
    tested = "their last 30 %" if set(result.tested) & set(result.trained) else f"{len(result.tested)} others"
    return f"{result.windows} windows of {len(result.trained)} logs fitted; tested on {tested}"


def _show(result: Identification, written: list[Path]) -> None:
    from xitl_cli.commands.terminal import say, show_facts, show_rows, terminal
    from xitl_cli.logs.report.wording import value_text
    from xitl_cli.plugins.identify.identification_page import figure_rows, findings, key_rows, score_rows
    from xitl_cli.plugins.identify.prediction import SCORES

    console = terminal()
    say(console, f"{result.vessel.name}: {_summary(result)}", "bold")
    console.print()
    heads = ("figure", "value", "± σ", "unit")
    show_rows(console, heads, [[value_text(cell) for cell in row] for row in figure_rows(result)], text=(0, 3))
    console.print()
    rows = [[value_text(cell) for cell in row[:4]] for row in key_rows(result)]
    show_rows(console, ("key", "before", "identified", "± σ"), rows)
    console.print()
    rows = [[value_text(cell) for cell in row] for row in score_rows(result)]
    show_rows(console, ("window (s)", "error of", "windows", *SCORES), rows, text=(1,))
    if found := findings(result):
        console.print()
        show_facts(console, [("note", f"{own.sentence}\n→ {own.next_step}", "yellow") for own in found])
    for path in written:
        say(console, f"written: {path}")


def sensors(
    file: Annotated[
        Path, typer.Argument(metavar="LOG", help="Log with a boat at rest, and with manoeuvres if possible.")
    ],
    out: Annotated[Path | None, typer.Option("--out", metavar="YAML", help="File of the block `sensors`.")] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Estimate noise densities, bias stability and the receiver's delay, and write the block `sensors`.

    Exit code: 0 done; 2 the log has no IMU samples or no rest.
    """
    from xitl_cli.commands.terminal import show_facts, show_rows, terminal
    from xitl_cli.logs import LogError, open_log
    from xitl_cli.plugins.identify.sensors import identify_sensors, sensors_text

    if out is not None and out.exists() and not overwrite:
        raise UserError(f"{out} exists; choose another name, or use --overwrite")
    try:
        with open_log(file) as log:
            found = identify_sensors(log)
    except LogError as error:
        raise UserError(str(error)) from error
    if out is not None:
        try:
            out.write_text(sensors_text(found, file.name), encoding="utf-8")
        except OSError as error:
            raise UserError(f"{out}: cannot be written ({error.strerror}); choose another place") from error
    if as_json:
        document = {
            "rest_s": found.rest_s,
            "sensors": [asdict(own) for own in found.values],
            "lacks": list(found.lacks),
        }
        typer.echo(json.dumps(document, allow_nan=False, ensure_ascii=False))
        return
    rows = [
        (own.key, f"{own.value:.4g}", "" if own.sigma is None else f"{own.sigma:.2g}", own.note) for own in found.values
    ]
    console = terminal()
    show_rows(console, ("key", "value", "± σ", ""), rows, text=(0, 3))
    show_facts(console, [("note", lack, "yellow") for lack in found.lacks])
