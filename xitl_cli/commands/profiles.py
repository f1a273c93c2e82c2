"""`xitl profiles list|show|check`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.commands.options import Json, ProfileName, Set, complete_profile
from xitl_cli.commands.terminal import say, show_rows, terminal
from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from xitl_cli.profile import Profile
    from xitl_cli.profile.load import LoadedProfile


def list_profiles(as_json: Json = False) -> None:
    """List the profiles that come with xitl; those at the top run."""
    from xitl_cli.profile import load_profile
    from xitl_cli.profile.files.catalogue import shipped_profiles

    loaded = {name: load_profile(name) for name in shipped_profiles()}
    if as_json:
        import json

        rows = [
            {"name": name, "technique": one.technique, "role": one.role(), "description": one.description}
            for name, one in loaded.items()
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


def _role(profile: Profile) -> str:
    if profile.vessels is None:
        return profile.role()
    sailed = len(profile.sailed)
    scripted = len(profile.vessels) - sailed
    return f"{profile.role()}, {sailed} vessel{'s' if sailed > 1 else ''}{f', {scripted} scripted' if scripted else ''}"


def show(
    name: ProfileName,
    overrides: Set = None,
    origins: Annotated[bool, typer.Option("--origins", help="One value a line, with where it was written.")] = False,
) -> None:
    """Show a profile with everything it extends, all overrides and all defaults."""
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
            help="Names or paths; all shipped profiles if none.",
            autocompletion=complete_profile,
        ),
    ] = None,
    overrides: Set = None,
) -> None:
    """Check profiles and list everything that is wrong with them, one problem a line."""
    from rich.text import Text

    from xitl_cli.profile import ProfileError, load_with_origins
    from xitl_cli.profile.files.catalogue import shipped_profiles

    console = terminal()
    wrong = 0
    for name in names or shipped_profiles():
        try:
            found = load_with_origins(name, overrides or ())
        except ProfileError as error:
            wrong += 1
            for problem in error.problems:
                console.print(Text(str(problem), style="red"), soft_wrap=True)
        except UserError as error:
            wrong += 1
            console.print(Text(str(error), style="red"), soft_wrap=True)
        else:
            console.print(Text.assemble(("ok", "green"), f"  {name} ({_role(found.profile)})"), soft_wrap=True)
            for text in (*found.warnings, *_compass_warnings(found)):
                console.print(Text(f"warning: {text}", style="yellow"), soft_wrap=True)
    if wrong:
        raise typer.Exit(2)


def _compass_warnings(loaded: LoadedProfile) -> list[str]:
    """Return the warnings of a profile that can run; none for a part of a profile."""
    from xitl_cli.run.sensors.compass import compass_warnings

    try:
        return compass_warnings(loaded.profile.run_profiles())
    except UserError:
        return []
