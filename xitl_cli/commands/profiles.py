"""`xitl profiles list|show|check`."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated

import typer

from xitl_cli.commands.options import Json, ProfileName, Set, complete_profile
from xitl_cli.commands.terminal import say, show_rows, terminal
from xitl_cli.errors import UserError
from xitl_cli.logs.model.text import plural


def list_profiles(as_json: Json = False) -> None:
    """List the profiles that come with xitl: first those that can run, then the parts of profiles."""
    from xitl_cli.profile import load_profile
    from xitl_cli.profile.files.catalogue import shipped_profiles

    loaded = {name: load_profile(name) for name in shipped_profiles()}
    if as_json:
        import json

        rows = [
            {"name": name, "technique": profile.technique, "role": profile.role(), "description": profile.description}
            for name, profile in loaded.items()
        ]
        typer.echo(json.dumps({"profiles": rows}, ensure_ascii=False))
        return
    groups: dict[str, list[str]] = {}
    for name in loaded:
        groups.setdefault(name.rpartition("/")[0], []).append(name)
    console = terminal()
    for group, names in sorted(groups.items()):
        say(console, group or "runnable", "bold")
        rows_of = [[name, loaded[name].technique or "", loaded[name].description] for name in names]
        show_rows(console, ("", "", ""), rows_of, text=(0, 1, 2))
        console.print()


def show(
    name: ProfileName,
    overrides: Set = None,
    origins: Annotated[
        bool, typer.Option("--origins", help="Print one key per line, with the file and line that set its value.")
    ] = False,
) -> None:
    """Show all keys of a profile, with the values of the profiles it extends, of --set and of defaults."""
    from rich.text import Text

    from xitl_cli.profile import load_with_origins, resolved_yaml
    from xitl_cli.profile.resolved import values_with_origins

    loaded = load_with_origins(name, overrides or ())
    console = terminal()
    if origins:
        for key, value, origin in values_with_origins(loaded):
            console.print(Text.assemble(f"{key} = {value}  ", (f"# {origin}", "dim")), soft_wrap=True)
        return
    text = resolved_yaml(loaded.profile)
    if console.is_terminal:
        from rich.syntax import Syntax

        console.print(Syntax(text, "yaml", background_color="default", word_wrap=True))
    else:
        console.print(text, end="", soft_wrap=True)


def check(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="PROFILE...",
            help="Names or paths of profiles (default: all shipped profiles).",
            autocompletion=complete_profile,
        ),
    ] = None,
    overrides: Set = None,
) -> None:
    """Check profiles and print all their problems, one per line."""
    from rich.text import Text

    from xitl_cli.profile import ProfileError, load_with_origins
    from xitl_cli.profile.files.catalogue import shipped_profiles
    from xitl_cli.run.sensors.compass import compass_warnings

    console = terminal()
    wrong = 0
    for name in names or shipped_profiles():
        try:
            loaded = load_with_origins(name, overrides or ())
        except ProfileError as error:
            wrong += 1
            for problem in error.problems:
                console.print(Text(str(problem), style="red"), soft_wrap=True)
        except UserError as error:
            wrong += 1
            console.print(Text(str(error), style="red"), soft_wrap=True)
        else:
            profile = loaded.profile
            role: str = profile.role()
            if profile.vessels is not None:
                scripted = len(profile.vessels) - len(profile.sailed)
                role += f", {plural(len(profile.sailed), 'vessel')}" + (f", {scripted} scripted" if scripted else "")
            console.print(Text.assemble(("ok", "green"), f"  {name} ({role})"), soft_wrap=True)
            warnings = list(loaded.warnings)
            with suppress(UserError):  # a part of a profile cannot run
                warnings += compass_warnings(profile.run_profiles())
            for text in warnings:
                console.print(Text(f"warning: {text}", style="yellow"), soft_wrap=True)
    if wrong:
        raise typer.Exit(2)
