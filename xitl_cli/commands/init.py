"""`xitl init`: writes the files of a new boat."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from xitl_cli.errors import UserError

FILES = ("profile.yaml", "vessel.yaml", "mission.yaml")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


def init(
    path: Annotated[Path, typer.Argument(metavar="NAME", help="The boat's name, or the path of its new folder.")],
) -> None:
    """Create the profile, vessel and mission of a new boat; they run at once.

    Comments in the files say what to edit.
    """
    from xitl_cli.profile.files.catalogue import shipped_profiles

    name = path.name
    if not _NAME.fullmatch(name):
        raise UserError(f"{str(path)!r} is no valid name of a boat; use up to 64 letters, digits, '-', '_' and '.'")
    if path.parent == Path() and any(name in (shipped, shipped.rpartition("/")[2]) for shipped in shipped_profiles()):
        raise UserError(f"{name} is the name of a profile that comes with xitl; choose another name")
    try:
        path.mkdir(parents=True)
        for file in FILES:
            text = files("xitl_cli").joinpath("templates", file).read_text(encoding="utf-8")
            (path / file).write_text(text.replace("NAME", name), encoding="utf-8")
    except FileExistsError:
        raise UserError(f"{path} exists; choose another name, or move it away first") from None
    except OSError as error:
        raise UserError(f"{path} cannot be written ({error.strerror}); choose another place") from None
    typer.echo(
        f"Created {path}/. Run the boat: xitl sim {path}\n"
        "Then edit, in this order:\n"
        f"  1. {path / 'vessel.yaml'}   mass, hull, drag, propellers, windage\n"
        f"  2. {path / 'mission.yaml'}  position of your water, waypoints\n"
        f"  3. {path / 'profile.yaml'}  weather, parameters of the autopilot\n"
        f"Check the files after each edit: xitl profiles check {path}"
    )
