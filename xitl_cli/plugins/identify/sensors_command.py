"""`xitl identify sensors`: noise, biases and delays of sensors from a log."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from xitl_cli.commands.options import Json, Overwrite
from xitl_cli.errors import UserError


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
