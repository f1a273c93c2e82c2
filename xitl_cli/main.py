"""The `xitl` command: one line per command. The only place that turns an error into a line and an exit code."""

from __future__ import annotations

import errno
import gc
import io
import os
import shutil
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, NoReturn

from xitl_cli.errors import UserError
from xitl_cli.plugin import Command, keep_group

if TYPE_CHECKING:
    import typer

FRAMED_HELP_WIDTH = 80
_COLLECT_AFTER = 20_000
"""Objects that are created between two garbage collections. With Python's 700, imports take a tenth longer, because the
collector looks through all classes and functions again and again."""
_AGENT_COMMANDS = (["package"], ["deploy"])


def main() -> NoReturn:
    """Entry point of the console script."""
    # Before numpy is loaded: the matrices are small, and a second thread costs more time than it saves.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(_COLLECT_AFTER)
    if sys.argv[1:2] == ["agent"] and sys.argv[2:3] not in _AGENT_COMMANDS:
        from agent.__main__ import main as agent_main  # without the command-line library, because boards are small

        sys.exit(agent_main(sys.argv[2:], program="xitl agent"))
    if not sys.warnoptions:  # warnings for programmers, such as numpy's on numbers in a damaged log
        warnings.simplefilter("ignore")
    if isinstance(sys.stdout, io.TextIOWrapper):  # file names and log texts may have characters that it cannot encode
        sys.stdout.reconfigure(errors="backslashreplace")
    words = sys.argv[1:]
    if "_XITL_COMPLETE" in os.environ:  # shell completion: the words typed so far, if the command's name is complete
        typed = os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS") or ""
        words = typed.split()[1:]
        if len(words) == 1 and not typed[-1:].isspace():
            words = []
    try:
        try:
            _app(words)(prog_name="xitl")
        finally:
            sys.stdout.flush()
    except _user_errors() as error:
        fail(str(error))
    except OSError as error:
        from xitl_cli.commands.output import GONE, discard_output

        if error.errno not in (errno.ENOSPC, errno.EDQUOT, *GONE):
            raise
        discard_output()
        if error.errno not in GONE:
            fail(f"the output cannot be written ({error.strerror}); free disk space or write the output elsewhere")
    sys.exit(0)


def _user_errors() -> tuple[type[Exception], ...]:
    """Return the exceptions that a user can correct, without an import: only an imported module raises its error."""
    of_logs = sys.modules.get("xitl_cli.logs.model.errors")
    return (UserError,) if of_logs is None else (UserError, of_logs.LogError)


def fail(message: str) -> NoReturn:
    """Print one red line and exit with code 2."""
    from rich.text import Text

    from xitl_cli.commands.terminal import terminal
    from xitl_cli.logs.model.text import printable

    terminal(stderr=True).print(Text(f"error: {printable(message)}", style="bold red"), soft_wrap=True)
    sys.exit(2)


def _app(arguments: Sequence[str] | None = None) -> typer.Typer:
    """Return all commands. With `arguments`, commands that they do not name are missing or empty, to save time."""
    import typer
    import typer.core

    from xitl_cli.commands.options import usual_spelling
    from xitl_cli.commands.plain_values import converting_plainly

    # The frames of rich cut off option names in a narrow terminal. Plain help wraps the text instead.
    markup: Literal["rich"] | None = "rich" if shutil.get_terminal_size().columns >= FRAMED_HELP_WIDTH else None

    class WrappedGroup(typer.core.TyperGroup):
        """Plain help with the whole first sentence of each command."""

        def get_params(self, ctx: Any) -> list[Any]:
            return converting_plainly(super().get_params(ctx))

        def format_commands(self, ctx: Any, formatter: Any) -> None:
            rows = [
                (name, command.get_short_help_str(limit=1000))
                for name, command in self.commands.items()
                if not command.hidden
            ]
            with formatter.section("Commands"):
                formatter.write_dl(rows)

    class TopGroup(WrappedGroup):
        """Names the plug-in of a command that is missing."""

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            if args and args[0] not in self.commands and not args[0].startswith("-"):
                _refuse_missing(args[0])
            return super().resolve_command(ctx, args)

    app = typer.Typer(
        name="xitl",
        cls=TopGroup,
        help="X-in-the-loop simulation for autonomous boats and other MAVLink vehicles.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=markup,
        context_settings={"help_option_names": ["-h", "--help"], "token_normalize_func": usual_spelling},
    )
    for name, declared in _commands_for(arguments[0] if arguments else "").items():
        asked_for = arguments is None or name in arguments
        if not declared.group:
            if asked_for:
                declared.add(app, name)
            else:  # only its line in `xitl --help`
                app.command(name, help=declared.help)(lambda: None)
            continue
        kind = WrappedGroup if declared.group_class is None or not asked_for else declared.group_class()
        group = typer.Typer(
            help=declared.help, no_args_is_help=declared.help_without_command, rich_markup_mode=markup, cls=kind
        )
        if asked_for:
            declared.add(group, name)
        app.add_typer(group, name=name)

    def show_version(wanted: bool) -> None:
        if wanted:
            from agent import __version__

            typer.echo(f"xitl {__version__}")
            raise typer.Exit

    version = typer.Option(False, "--version", callback=show_version, is_eager=True, help="Show the version and exit.")

    def options(version: bool = version) -> None:
        """X-in-the-loop simulation for autonomous boats and other MAVLink vehicles."""

    app.callback()(options)
    return app


def _commands_for(first_word: str) -> dict[str, Command]:
    """Return the command of this name, or all commands when there is none."""
    if first_word in CORE_COMMANDS:
        return {first_word: CORE_COMMANDS[first_word]}
    from xitl_cli import registry

    if first_word in registry.names(registry.COMMANDS):
        return {first_word: registry.load(registry.COMMANDS, first_word)}
    return {**CORE_COMMANDS, **dict(registry.load_all(registry.COMMANDS))}


def _refuse_missing(name: str) -> None:
    """Raise UserError when the command's plug-in cannot be loaded, or when a plug-in of xitl is missing."""
    from xitl_cli import registry

    if name in registry.names(registry.COMMANDS):
        registry.load(registry.COMMANDS, name)
    elif name in OWN_PLUGIN_COMMANDS:
        extra = OWN_PLUGIN_COMMANDS[name]
        package = f"'xitl[{extra}]'" if extra else "xitl"
        raise UserError(f"xitl {name}: the plug-in is not installed; pip install --force-reinstall {package}")


def _add(app: typer.Typer, name: str) -> None:
    """Import the module of a core command and add its function, or the functions of a group."""
    from xitl_cli.commands.plain_values import PlainCommand

    module = import_module(f"xitl_cli.commands.{name}")
    if name == "world":
        keep_group(app)
    for command, function in _SUBCOMMANDS.get(name, {name: name}).items():
        app.command(command, cls=module.SimCommand if name == "sim" else PlainCommand)(getattr(module, function))


CORE_COMMANDS: Mapping[str, Command] = {
    "init": Command("Create the profile, vessel and mission of a new boat; they run at once.", _add),
    "sim": Command("Run a simulation.", _add),
    "doctor": Command(
        "Check that this machine or a board is ready for runs, and print how to correct each problem.", _add
    ),
    "wdri": Command(
        "Print the nodes, the links and the realism index (WDRI, from 0 to 1) of a profile or of a run.", _add
    ),
    "profiles": Command("List, show and check profiles.", _add, group=True),
    "plugins": Command("List the installed plug-ins and the errors of those that cannot be loaded.", _add),
    "agent": Command(
        "Run the agent, which connects an autopilot to a run (`xitl agent --help`); package it; deploy it to a board.",
        _add,
        group=True,
        help_without_command=False,
    ),
    "world": Command("Change the world of a running simulation.", _add, group=True),
}
"""The commands of the core, in the order of `xitl --help`."""

_SUBCOMMANDS = {
    "profiles": {"list": "list_profiles", "show": "show", "check": "check"},
    "agent": {"package": "package", "deploy": "deploy"},
    "world": {"launch": "launch"},
}
"""Commands of each group, with the names of their functions."""

OWN_PLUGIN_COMMANDS = {
    "board": "",
    "campaign": "campaign",
    "firmware": "",
    "identify": "identify",
    "logs": "report",
    "map": "perception",
    "paper": "figures",
    "params": "",
    "twin": "",
    "validate": "",
    "vehicle": "",
    "view": "view",
}
"""Commands of xitl's plug-ins with their extras, to name the source of a missing command."""


if __name__ == "__main__":
    main()
