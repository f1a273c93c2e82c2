"""`xitl world launch`."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import typer

from xitl_cli.errors import UserError

DEFAULT_URL = "udp://127.0.0.1:14670"


def launch(
    kind: Annotated[
        Literal["trunk", "branch", "plants", "animal"],
        typer.Argument(metavar="KIND", help="trunk, branch, plants, animal."),
    ],
    at: Annotated[str, typer.Option("--at", metavar="N,E", help="Metres north and east of the site's origin.")],
    heading: Annotated[float, typer.Option("--heading", metavar="DEG", help="Where its length points.")] = 0.0,
    length: Annotated[
        float | None, typer.Option("--length", metavar="M", help="Its length, unless the usual one of its kind.")
    ] = None,
    to: Annotated[
        str, typer.Option("--to", metavar="URL", help="The run's world.debris.control, as udp://host:port.")
    ] = DEFAULT_URL,
) -> None:
    """Put a body into the water of a run."""
    from xitl_cli.run.links.launch_requests import request_launch

    north_m, east_m = _place(at)
    if not math.isfinite(heading):
        raise UserError(f"--heading {heading} is no direction; give degrees clockwise from north")
    if length is not None and not (math.isfinite(length) and length > 0.0):
        raise UserError(f"--length {length} is no length; give metres, such as 4.5")
    request_launch(to, kind, north_m, east_m, math.radians(heading), length)
    size = "" if length is None else f" of {length:g} m"
    typer.echo(f"{kind}{size} in the water at {north_m:g} N {east_m:g} E")


def _place(text: str) -> tuple[float, float]:
    parts = text.split(",")
    try:
        north_m, east_m = (float(part) for part in parts)
    except ValueError:
        raise UserError(f"--at {text}: not two numbers; write metres north and east, such as --at 40,12.5") from None
    if not (math.isfinite(north_m) and math.isfinite(east_m)):
        raise UserError(f"--at {text}: no place; write metres north and east, such as --at 40,12.5")
    return north_m, east_m
