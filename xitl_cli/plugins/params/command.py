"""`xitl params show|diff|set|push|pull|check`."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from xitl_cli.commands.options import Json, Overwrite, SigningKey, VehicleAddress
from xitl_cli.commands.terminal import show_rows, terminal
from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from xitl_cli.plugins.params.push import PushedParameter

SourceArgument = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE",
        help="A .parm or .params file, the name of a shipped file, `defaults`, or a vehicle: udp://… or tcp://…",
    ),
]
WantedArgument = Annotated[
    str,
    typer.Argument(metavar="FILE|PROFILE", help="A .parm or .params file, the name of a shipped file, or a profile."),
]


def show(
    source: SourceArgument,
    pattern: Annotated[str, typer.Option("--filter", metavar="GLOB", help="Pattern of names, such as 'ATC_*'.")] = "*",
    signing_key: SigningKey = None,
    as_json: Json = False,
) -> None:
    """Show parameters: value, unit, default and meaning."""
    from xitl_cli.params.values import TABLE_BY_NAME, format_value, read_source

    parameters = read_source(source, _key(signing_key))
    values = {name: value for name, value in parameters.values.items() if fnmatchcase(name, pattern.upper())}
    if not values:
        raise UserError(
            f"{source}: none of its {len(parameters.values)} parameters matches {pattern!r}; use another pattern"
        )
    rows = {name: TABLE_BY_NAME.get(name) if parameters.described else None for name in values}
    if as_json:
        listed = [
            {
                "name": name,
                "value": values[name],
                "unit": row.unit if row else None,
                "default": row.default if row else None,
                "meaning": row.meaning if row else None,
            }
            for name, row in rows.items()
        ]
        _print_json({"source": source, "parameters": listed})
        return
    cells = [
        [name, format_value(values[name]), *((row.unit, format_value(row.default), row.meaning) if row else ("",) * 3)]
        for name, row in rows.items()
    ]
    show_rows(terminal(), ("name", "value", "unit", "default", "meaning"), cells, text=(0, 2, 4))


def diff(
    first: SourceArgument,
    other: SourceArgument,
    signing_key: SigningKey = None,
    as_json: Json = False,
) -> None:
    """Show the differences. Exit code: 0 none, 1 some, 2 an error."""
    from xitl_cli.params.values import differences, format_value, read_source

    key = _key(signing_key)
    differing = differences(read_source(first, key), read_source(other, key))
    if as_json:
        _print_json({"one": first, "other": other, "differences": [asdict(difference) for difference in differing]})
    else:
        rows = []
        for parameter in differing:
            values = (parameter.one, parameter.other)
            rows.append([parameter.name, *("–" if value is None else format_value(value) for value in values)])
        show_rows(terminal(), ("name", first, other), rows)
        if not differing:
            typer.echo("no differences")
    raise typer.Exit(1 if differing else 0)


def set_values(
    vehicle: VehicleAddress,
    assignments: Annotated[list[str], typer.Argument(metavar="NAME=VALUE...", help="WP_SPEED=2.5 CRUISE_SPEED=3")],
    signing_key: SigningKey = None,
    as_json: Json = False,
) -> None:
    """Set parameters of a vehicle and read them back."""
    from xitl_cli.params.vehicle import connect
    from xitl_cli.plugins.params.push import set_differing

    wanted: dict[str, float] = {}
    for text in assignments:
        name, separator, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not (separator and name.strip() and math.isfinite(number)):
            raise UserError(f"{text!r} is not NAME=VALUE with a number; write for example WP_SPEED=2.5")
        wanted[name.strip().upper()] = number
    with connect(_vehicle(vehicle), _key(signing_key)) as reached:
        read = {name: reached.read(name) for name in wanted}
        present = {name: value for name, value in read.items() if value is not None}
        changes = set_differing(reached, wanted, present, complete=False)
    _report(vehicle, changes, len(wanted), as_json)


def push(
    source: WantedArgument,
    vehicle: VehicleAddress,
    with_script: Annotated[
        bool, typer.Option("--with-script", help="Also install the script for HIL messages on an ArduPilot.")
    ] = False,
    reboot: Annotated[
        bool,
        typer.Option(
            "--reboot", help="Restart the vehicle, and set parameters that appear only then, until all are set."
        ),
    ] = False,
    signing_key: SigningKey = None,
    as_json: Json = False,
) -> None:
    """Set the parameters of a vehicle that differ from a file or a profile, and read them back."""
    from xitl_cli.params.values import read_wanted
    from xitl_cli.plugins.params.push import push as push_parameters
    from xitl_cli.plugins.params.push import shipped_script

    wanted = read_wanted(source)
    script = shipped_script() if with_script else None
    with terminal(stderr=True).status("parameters") as status:
        done = push_parameters(
            _vehicle(vehicle), _key(signing_key), wanted, script, reboot, lambda text: status.update(Text(text))
        )
    more = {"script": done.script or None, "script_written": done.written, "restarts": done.restarts}
    notes = [f"{done.script} {'written' if done.written else 'exists already'}"] if done.script else []
    notes += (
        ["the vehicle needs a restart: use --reboot, or switch its power off and on"]
        if done.restart_due and (reboot or script)
        else []
    )
    _report(vehicle, list(done.changes), len(wanted), as_json, more if with_script or reboot else {}, notes)


def check(
    source: WantedArgument,
    vehicle: VehicleAddress,
    signing_key: SigningKey = None,
    as_json: Json = False,
) -> None:
    """Compare a vehicle with a file or a profile: different values, and parameters that its version does not have.

    Exit code: 0 no difference, 1 some, 2 an error.
    """
    from xitl_cli.params.values import read_wanted
    from xitl_cli.params.vehicle import connect
    from xitl_cli.plugins.params.check import check_parameters, firmware_name

    wanted = read_wanted(source)
    with connect(_vehicle(vehicle), _key(signing_key)) as reached:
        version = firmware_name(reached)
        findings = check_parameters(wanted, reached.read_all())
    if as_json:
        _print_json({"source": source, "vehicle": vehicle, "firmware": version, **asdict(findings)})
    else:
        from xitl_cli.params.values import format_value

        console = terminal(soft_wrap=True)
        console.print(version)
        differs = [[row.name, format_value(row.wanted), format_value(row.kept)] for row in findings.differs]
        show_rows(console, ("name", "wanted", "vehicle"), differs)
        for missing in findings.absent:
            console.print(
                f"{missing.name} = {format_value(missing.wanted)}: {missing.sentence(format_value)}", markup=False
            )
        console.print(f"{findings.same} agree, {len(findings.differs)} differ, {len(findings.absent)} do not exist")
    raise typer.Exit(0 if findings.fine else 1)


def pull(
    vehicle: VehicleAddress,
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="File to write: NAME.parm, or NAME.params in QGroundControl's format."),
    ],
    overwrite: Overwrite = False,
    signing_key: SigningKey = None,
    as_json: Json = False,
) -> None:
    """Write all parameters of a vehicle into a file, each with its meaning."""
    from xitl_cli.params.values import file_text, read_source

    if file.exists() and not overwrite:
        raise UserError(f"{file}: exists; choose another name or add --overwrite")
    if not file.absolute().parent.is_dir():
        raise UserError(f"{file.parent}: is not a folder; make it first")
    parameters = read_source(_vehicle(vehicle), _key(signing_key))
    try:
        file.write_text(file_text(parameters, file.name), encoding="utf-8")
    except OSError as error:
        raise UserError(f"{file}: cannot be written ({error.strerror}); choose another place") from error
    if as_json:
        _print_json({"vehicle": vehicle, "file": str(file), "count": len(parameters.values)})
    else:
        terminal(soft_wrap=True).print(f"{file}: {len(parameters.values)} parameters", markup=False)


def _report(
    vehicle: str,
    changes: list[PushedParameter],
    asked: int,
    as_json: bool,
    also: dict[str, Any] | None = None,
    notes: Sequence[str] = (),
) -> None:
    from xitl_cli.params.values import format_value

    refused = [change for change in changes if change.reason]
    if as_json:
        _print_json(
            {
                "vehicle": vehicle,
                "set": [
                    {"name": change.name, "before": change.before, "value": change.kept}
                    for change in changes
                    if not change.reason
                ],
                "refused": [
                    {"name": change.name, "wanted": change.wanted, "kept": change.kept, "reason": change.reason}
                    for change in refused
                ],
                "unchanged": asked - len(changes),
                **(also or {}),
            }
        )
    else:
        console = terminal(soft_wrap=True)
        for change in changes:
            before = "" if change.before is None else f"{format_value(change.before)} → "
            if change.reason:
                console.print(f"{change.name} = {format_value(change.wanted)} refused: {change.reason}", markup=False)
            else:
                console.print(f"{change.name} = {before}{format_value(change.wanted)}", markup=False)
        for line in notes:
            console.print(line, markup=False)
        console.print(f"{len(changes) - len(refused)} set, {len(refused)} refused, {asked - len(changes)} unchanged")
    if refused:
        first, more = refused[0], len(refused) - 1
        raise UserError(
            f"{vehicle}: {first.name} = {format_value(first.wanted)} was refused, {first.reason}"
            + (f" (and {more} more)" if more else "")
            + "; see `xitl params show` for names and values"
        )


def _vehicle(url: str) -> str:
    from xitl_cli.params.values import is_vehicle

    if not is_vehicle(url):
        raise UserError(
            f"{url!r} is not an address of a vehicle; write tcp://host:port, udp://host:port or serial:///dev/ttyACM0"
        )
    return url


def _key(path: Path | None) -> bytes | None:
    from xitl_cli.signing import read_key_file

    return None if path is None else read_key_file(str(path))


def _print_json(content: dict[str, Any]) -> None:
    typer.echo(json.dumps(content, indent=2, allow_nan=False))
