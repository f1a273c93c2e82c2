"""`xitl profiles list|show|check`."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from xitl_cli.errors import UserError

Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a value: environment.wind.mean_mps=8."),
]


def list_profiles() -> None:
    """List the profiles that come with xitl; those at the top run."""
    from xitl_cli.profile import load_profile
    from xitl_cli.profile.files.catalogue import shipped_profiles

    groups: dict[str, list[str]] = {}
    for name in shipped_profiles():
        groups.setdefault(name.rpartition("/")[0], []).append(name)
    console = Console(highlight=False)
    width = max(len(name) for names in groups.values() for name in names)
    for group, names in sorted(groups.items()):
        table = Table(box=None, pad_edge=False, show_header=False, title=Text(group or "runnable", style="bold"))
        table.title_justify = "left"
        table.add_column(no_wrap=True, min_width=width)
        table.add_column(no_wrap=True, min_width=6, style="dim")
        table.add_column()
        for name in names:
            profile = load_profile(name)
            table.add_row(Text(name, style="cyan"), profile.technique or "", Text(profile.description))
        console.print(table)
        console.print()


def show(
    name: Annotated[str, typer.Argument(help="A shipped profile's name, or a path to a .yaml file.")],
    overrides: Set = None,
    origins: Annotated[bool, typer.Option("--origins", help="One value a line, with where it was written.")] = False,
) -> None:
    """Show a profile with everything it extends, all overrides and all defaults."""
    from xitl_cli.profile import load_with_origins, resolved_yaml
    from xitl_cli.profile.resolved import values_with_origins

    loaded = load_with_origins(name, overrides or ())
    console = Console(highlight=False, soft_wrap=True)
    if origins:
        for key, value, origin in values_with_origins(loaded):
            console.print(Text.assemble(f"{key} = {value}  ", (f"# {origin}", "dim")))
        return
    text = resolved_yaml(loaded.profile)
    if console.is_terminal:
        from rich.syntax import Syntax

        console.print(Syntax(text, "yaml", background_color="default"))
    else:
        console.print(text, end="", markup=False)


def check(
    names: Annotated[list[str] | None, typer.Argument(help="Names or paths; all shipped profiles if none.")] = None,
    overrides: Set = None,
) -> None:
    """Check profiles and list everything that is wrong with them, one problem a line."""
    from xitl_cli.profile import ProfileError, load_profile
    from xitl_cli.profile.files.catalogue import shipped_profiles

    console = Console(highlight=False, soft_wrap=True)
    wrong = 0
    for name in names or shipped_profiles():
        try:
            profile = load_profile(name, overrides or ())
        except ProfileError as error:
            wrong += 1
            for problem in error.problems:
                console.print(str(problem), style="red", markup=False)
        except UserError as error:
            wrong += 1
            console.print(str(error), style="red", markup=False)
        else:
            console.print(Text.assemble(("ok", "green"), f"  {name} ({profile.role()})"))
    if wrong:
        raise typer.Exit(2)
