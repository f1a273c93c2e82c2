"""`xitl world launch`."""

from __future__ import annotations

import math
from typing import Annotated

import typer

from sim_core.world.spec import DebrisName
from xitl_cli.errors import UserError

DEFAULT_URL = "udp://127.0.0.1:14670"


def launch(
    kind: Annotated[
        DebrisName,
        typer.Argument(metavar="KIND", help="trunk, branch, plants, animal, plank or plastic."),
    ],
    at: Annotated[
        str, typer.Option("--at", metavar="N,E", help="Position, in metres north and east of the site's origin.")
    ],
    heading: Annotated[
        float, typer.Option("--heading", metavar="DEG", help="Direction of its long axis, in degrees from north.")
    ] = 0.0,
    length: Annotated[
        float | None,
        typer.Option("--length", metavar="M", help="Length in metres (default: the usual length of its kind)."),
    ] = None,
    to: Annotated[
        str,
        typer.Option("--to", metavar="URL", help="Address of the run, udp://host:port: its world.debris.control."),
    ] = DEFAULT_URL,
) -> None:
    """Put a floating body into the water of a running simulation."""
    from xitl_cli.run.links.launch_requests import request_launch

    try:
        north_m, east_m = (float(part) for part in at.split(","))
    except ValueError:
        north_m = east_m = math.nan
    if not (math.isfinite(north_m) and math.isfinite(east_m)):
        raise UserError(f"--at {at} is no position; write metres north and east, such as --at 40,12.5")
    if not math.isfinite(heading):
        raise UserError(f"--heading {heading} is no direction; give degrees clockwise from north")
    if length is not None and not (math.isfinite(length) and length > 0.0):
        raise UserError(f"--length {length} is no length; give metres, such as 4.5")
    request_launch(to, kind, north_m, east_m, math.radians(heading), length)
    size = "" if length is None else f" of {length:g} m"
    typer.echo(f"{kind}{size} in the water at {north_m:g} N {east_m:g} E")
