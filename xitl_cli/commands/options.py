"""Arguments and options that several commands share, and their shell completion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

DEFAULT_PROFILE = "sitl"
OTHER_SPELLINGS = {"output": "out", "force": "overwrite", "verbosity": "verbose"}
"""Other spellings of options that commands accept in addition to the one in their help."""


def usual_spelling(token: str) -> str:
    """Return the usual spelling of an option, for click's `token_normalize_func`."""
    return OTHER_SPELLINGS.get(token, token)


def complete_profile(incomplete: str) -> list[str]:
    """Return names of shipped profiles, and YAML files that match the beginning of a path.

    Parts of profiles are offered once their folder is typed. Without a match, the shell completes files by itself.
    """
    from xitl_cli.paths import user_path
    from xitl_cli.profile.files.catalogue import SUFFIXES, shipped_profiles

    names = [name for name in shipped_profiles() if name.startswith(incomplete)]
    if "/" not in incomplete:
        names = [name for name in names if "/" not in name] or names
    folder, _, start = incomplete.rpartition("/")
    where = user_path(folder + "/" if folder or incomplete.startswith("/") else ".")
    try:
        files = [path.name for path in where.iterdir() if path.suffix in SUFFIXES and path.name.startswith(start)]
    except (OSError, ValueError):
        files = []
    return names + [f"{incomplete[: len(incomplete) - len(start)]}{name}" for name in sorted(files)]


def complete_vehicle(incomplete: str) -> list[str]:
    """Return names of shipped vehicles, then the results of `complete_profile`."""
    from xitl_cli.profile.files.catalogue import shipped_profiles

    vehicles = [name.removeprefix("vehicles/") for name in shipped_profiles() if name.startswith("vehicles/")]
    return [name for name in vehicles if name.startswith(incomplete)] or complete_profile(incomplete)


def complete_set(context: typer.Context, incomplete: str) -> list[str]:
    """Return keys of the profile on the command line (default: `sitl`), each with its value."""
    from xitl_cli.errors import UserError
    from xitl_cli.profile import load_with_origins
    from xitl_cli.profile.resolved import values_with_origins

    params = context.params
    profile = params.get("profile") or params.get("profile_option") or params.get("name")
    if not profile:  # an option without its value, as during typing, ends the parsing before the arguments
        profile = next((word for word in context.args if not word.startswith("-")), DEFAULT_PROFILE)
    try:
        assignments = [f"{key}={value}" for key, value, _ in values_with_origins(load_with_origins(str(profile), ()))]
    except UserError:
        return []
    return [text for text in assignments if text.startswith(incomplete)]


def complete_section(incomplete: str) -> list[str]:
    """Return names of analyses."""
    from xitl_cli.log_analyses import section_names

    return [name for name in section_names() if name.startswith(incomplete)]


ProfileName = Annotated[
    str,
    typer.Argument(
        metavar="PROFILE",
        help="Name of a shipped profile (`xitl profiles list`) or path of a .yaml file.",
        autocompletion=complete_profile,
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a key of the profile, such as environment.wind.mean_mps=8. Repeatable.",
        autocompletion=complete_set,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
OpenPage = Annotated[bool, typer.Option("--open", help="Open the page in a web browser.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing output.")]
Vessel = Annotated[
    str | None,
    typer.Option("--vessel", metavar="NAME", help="Use only this vessel of a fleet's recording or bag."),
]
From = Annotated[
    str | None,
    typer.Option(
        "--from", metavar="TIME", help="Begin at this time of the log, counted as by `info`: 90, 1:30.5 or 1:02:03."
    ),
]
Until = Annotated[str | None, typer.Option("--until", metavar="TIME", help="End at this time of the log.")]
Raw = Annotated[bool, typer.Option("--raw", help="Show values as stored in the log, without scaling.")]
VehicleAddress = Annotated[
    str,
    typer.Argument(
        metavar="VEHICLE",
        help="MAVLink address of the vehicle: tcp://host:port, serial:///dev/ttyACM0 or udp://host:port (xitl listens "
        "there if the host is this machine). Append ?system=3 to select one of several vehicles.",
    ),
]
SigningKey = Annotated[
    Path | None,
    typer.Option(
        "--signing-key", metavar="FILE", help="Sign sent messages with this key, and ignore unsigned messages."
    ),
]
RunsSeed = Annotated[int, typer.Option("--seed", min=0, help="Seed of all random numbers, the same for every run.")]
RunsDuration = Annotated[
    float | None,
    typer.Option("--duration", metavar="S", min=1.0, help="Longest simulated time of each run, in seconds."),
]


def renamed(old_value: str | None, value: str | None, old: str, new: str) -> str | None:
    """Return the value of a renamed option. The old name still works, with a notice."""
    if old_value is None:
        return value
    typer.echo(f"{old} is now {new}; a later version removes the old name", err=True)
    return old_value if value is None else value
