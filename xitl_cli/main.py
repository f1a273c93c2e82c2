"""The `xitl` command: one line per command. The only place that turns an error into a line and an exit code."""

from __future__ import annotations

import errno
import io
import os
import shutil
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NoReturn

from xitl_cli.errors import UserError
from xitl_cli.logs.model.errors import LogError

if TYPE_CHECKING:
    import typer

FRAMED_HELP_WIDTH = 80
_ABOUT_THE_AGENT = (["package"], ["deploy"])


def main() -> NoReturn:
    """Entry point of the console script."""
    # Before numpy is loaded: the matrices are small, and a second thread costs more than it brings.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if sys.argv[1:2] == ["agent"] and sys.argv[2:3] not in _ABOUT_THE_AGENT:
        from agent.__main__ import main as agent_main  # without the command-line library: boards are small

        sys.exit(agent_main(sys.argv[2:], program="xitl agent"))
    if not sys.warnoptions:  # advice on programs, such as numpy's on numbers that a damaged log holds
        warnings.simplefilter("ignore")
    if isinstance(sys.stdout, io.TextIOWrapper):  # names of files and texts of logs may hold what it cannot say
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        try:
            _app(_typed())(prog_name="xitl")
        finally:
            sys.stdout.flush()
    except (UserError, LogError) as error:
        fail(str(error))
    except OSError as error:
        from xitl_cli.commands.output import GONE

        if error.errno not in (errno.ENOSPC, errno.EDQUOT, *GONE):
            raise
        # What is left in the buffer would raise once more when the interpreter closes it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno not in GONE:
            fail(f"the output cannot be written ({error.strerror}); free space or send it elsewhere")
    sys.exit(0)


def _typed() -> list[str]:
    """The words of the command line: those typed so far when a shell asks what may follow them."""
    if "_XITL_COMPLETE" not in os.environ:
        return sys.argv[1:]
    return (os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS") or "").split()


def fail(message: str) -> NoReturn:
    """One red line, exit code 2."""
    from rich.text import Text

    from xitl_cli.commands.terminal import terminal
    from xitl_cli.logs.model.text import printable

    terminal(stderr=True).print(Text(f"error: {printable(message)}", style="bold red"), soft_wrap=True)
    sys.exit(2)


def _app(arguments: Sequence[str] | None = None) -> typer.Typer:
    """All commands. A group that is not named among these arguments stays empty: filling it takes its time."""
    import typer
    import typer.core

    from xitl_cli.commands import doctor, init, sim, validate, wdri
    from xitl_cli.commands.campaign import CampaignGroup
    from xitl_cli.commands.map import map_command
    from xitl_cli.commands.options import usual_spelling
    from xitl_cli.commands.view import view

    # The frames of rich cut the names of options off in a narrow terminal, plain help wraps what is beside them.
    markup: Literal["rich"] | None = "rich" if shutil.get_terminal_size().columns >= FRAMED_HELP_WIDTH else None

    class WrappedGroup(typer.core.TyperGroup):
        """Plain help that tells the whole first sentence of each command."""

        def format_commands(self, ctx: Any, formatter: Any) -> None:
            rows = [(name, one.get_short_help_str(limit=1000)) for name, one in self.commands.items() if not one.hidden]
            with formatter.section("Commands"):
                formatter.write_dl(rows)

    app = typer.Typer(
        name="xitl",
        cls=WrappedGroup,
        help="X-in-the-loop simulation for autonomous boats and other MAVLink vehicles.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=markup,
        context_settings={"help_option_names": ["-h", "--help"], "token_normalize_func": usual_spelling},
    )
    app.command("init")(init.init)
    app.command("sim", cls=sim.SimCommand)(sim.sim)
    app.command("doctor")(doctor.doctor)
    app.command("wdri")(wdri.wdri)
    app.command("map")(map_command)
    app.command("view")(view)
    app.command("validate")(validate.validate)
    for name, (text, fill) in _GROUPS.items():
        kind = CampaignGroup if name == "campaign" else WrappedGroup
        group = typer.Typer(help=text, no_args_is_help=name != "agent", rich_markup_mode=markup, cls=kind)
        if arguments is None or name in arguments:
            fill(group)
        app.add_typer(group, name=name)
    version = typer.Option(False, "--version", callback=_show_version, is_eager=True, help="Show the version and exit.")

    def options(version: bool = version) -> None:
        """X-in-the-loop simulation for autonomous boats and other MAVLink vehicles."""

    app.callback()(options)
    return app


def _agent(group: typer.Typer) -> None:
    from xitl_cli.commands import agent

    group.command("package")(agent.package)
    group.command("deploy")(agent.deploy)


def _profiles(group: typer.Typer) -> None:
    from xitl_cli.commands import profiles

    group.command("list")(profiles.list_profiles)
    group.command("show")(profiles.show)
    group.command("check")(profiles.check)


def _vehicle(group: typer.Typer) -> None:
    from xitl_cli.commands import vehicle

    group.callback()(_several)
    group.command("check")(vehicle.check)


def _params(group: typer.Typer) -> None:
    from xitl_cli.commands import params

    group.command("show")(params.show)
    group.command("diff")(params.diff)
    group.command("set")(params.set_values)
    group.command("push")(params.push)
    group.command("pull")(params.pull)
    group.command("check")(params.check)


def _firmware(group: typer.Typer) -> None:
    from xitl_cli.commands import firmware

    group.command("get")(firmware.get)
    group.command("list")(firmware.list_firmware)
    group.command("path")(firmware.path)


def _logs(group: typer.Typer) -> None:
    from xitl_cli.commands import logs, logs_analyze, logs_compare

    group.command("info")(logs.info)
    group.command("dump")(logs.dump)
    group.command("export")(logs.export)
    group.command("analyze")(logs_analyze.analyze)
    group.command("plot")(logs_analyze.plot)
    group.command("compare")(logs_compare.compare)
    group.command("repair")(logs.repair)
    group.command("tasks")(logs.tasks)


def _board(group: typer.Typer) -> None:
    from xitl_cli.commands import board

    group.command("create")(board.create)
    group.command("start")(board.start)
    group.command("stop")(board.stop)
    group.command("list")(board.list_boards)
    for command in (board.ssh, board.enter):  # what follows the name is the command's
        group.command(command.__name__, context_settings={"allow_interspersed_args": False})(command)
    group.command("console")(board.console)
    group.command("put")(board.put)
    group.command("compare")(board.compare)
    group.command("pause")(board.pause)
    group.command("unplug")(board.unplug)
    group.command("remove")(board.remove)


def _world(group: typer.Typer) -> None:
    from xitl_cli.commands import world

    group.callback()(_several)
    group.command("launch")(world.launch)


def _campaign(group: typer.Typer) -> None:
    from xitl_cli.commands import campaign, campaign_compare

    group.command(campaign.DEFAULT_COMMAND)(campaign.run)
    group.command("compare")(campaign_compare.compare)


def _paper(group: typer.Typer) -> None:
    from xitl_cli.commands import paper

    group.command("4.1")(paper.section_4_1)
    group.command("4.2")(paper.section_4_2)
    group.command("4.3")(paper.section_4_3)
    group.command("4.4")(paper.section_4_4)
    group.command("wdri")(paper.wdri)
    group.command("all")(paper.all_sections)


_GROUPS: Mapping[str, tuple[str, Callable[[typer.Typer], None]]] = {
    "agent": ("Run the agent for a simulation host (`xitl agent --help`), package it, deploy it to a board.", _agent),
    "board": ("An ARMv7 board with a Debian of its own, emulated on this machine.", _board),
    "profiles": ("List, show and check profiles.", _profiles),
    "vehicle": ("Look into the model of a vessel.", _vehicle),
    "params": ("Read, compare and set parameters of a vehicle.", _params),
    "firmware": ("Download the firmware of other autopilots.", _firmware),
    "logs": ("Look into the logs of vehicles and runs.", _logs),
    "world": ("Put things into the world of a run.", _world),
    "campaign": (
        "Run a plan of many runs: `xitl campaign PLAN.yaml` (options: `xitl campaign run -h`); compare two.",
        _campaign,
    ),
    "paper": ("Repeat the experiments of the paper.", _paper),
}


def _several() -> None:
    """Keeps the name of a group's only command."""


def _show_version(wanted: bool) -> None:
    if wanted:
        import typer

        from agent import __version__

        typer.echo(f"xitl {__version__}")
        raise typer.Exit


if __name__ == "__main__":
    main()
