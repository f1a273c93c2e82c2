"""`xitl sim`: one run of a profile."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from xitl_cli.commands.options import DEFAULT_PROFILE, Json, Overwrite, Set, complete_profile
from xitl_cli.commands.output import still_read
from xitl_cli.commands.terminal import terminal
from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from xitl_cli.profile import Profile


def sim(
    profile: Annotated[
        str | None,
        typer.Argument(
            metavar="PROFILE",
            help="A shipped profile's name (`xitl profiles list`), or a path to a .yaml file; sitl if left out.",
            autocompletion=complete_profile,
        ),
    ] = None,
    profile_option: Annotated[
        str | None,
        typer.Option(
            "--profile", "-p", metavar="PROFILE", help="The same, as an option.", autocompletion=complete_profile
        ),
    ] = None,
    parts: Annotated[
        list[str] | None,
        typer.Option(
            "--with",
            metavar="PART",
            help="Lay a part on the profile: environments/calm, faults/lossy-link, or a path. Repeatable.",
            autocompletion=complete_profile,
        ),
    ] = None,
    overrides: Set = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Run directory (default: runs/<profile>-<time>).")
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            "--duration",
            metavar="S",
            help="End after this much simulated time from the start, also of what passes while the vessel is frozen "
            "until armed. Reaching it is success (exit code 0); that of the profile, clock.duration_s, is a limit.",
        ),
    ] = None,
    clock: Annotated[str | None, typer.Option("--clock", metavar="MODE", help="lockstep or realtime.")] = None,
    firmware: Annotated[
        str | None,
        typer.Option(
            "--firmware",
            metavar="PATH",
            help="Program of the autopilot to start; `find` looks for one, `external` waits for one started elsewhere. "
            "Vessels of a fleet that name their own keep it.",
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", metavar="N", help="Seed of everything random.")] = None,
    replay_events: Annotated[
        Path | None,
        typer.Option(
            "--replay-events",
            metavar="RUN",
            help="Do again, when it was done, what a person did in an earlier run: its directory, a .mcap or .jsonl.",
        ),
    ] = None,
    pace: Annotated[
        float | None,
        typer.Option("--pace", metavar="X", help="Times real time, in lockstep (default: as fast as it can)."),
    ] = None,
    view: Annotated[
        bool | None,
        typer.Option(
            "--view/--no-view",
            help="Show it in a browser in 3D while it goes on; its address is printed.",
            show_default=False,
        ),
    ] = None,
    view_host: Annotated[
        str | None,
        typer.Option(
            "--view-host",
            metavar="ADDRESS",
            help="Where the view listens, 0.0.0.0 for everywhere; the address it prints has a token in it.",
        ),
    ] = None,
    view_port: Annotated[
        int | None, typer.Option("--view-port", metavar="PORT", help="Its port (default: 8470, or a free one).")
    ] = None,
    live: Annotated[
        str | None,
        typer.Option("--live", metavar="foxglove", help="Serve what is recorded to Foxglove while it goes on."),
    ] = None,
    live_port: Annotated[
        int | None,
        typer.Option("--live-port", metavar="PORT", help="Where: of 127.0.0.1 (default: 8765, or a free one)."),
    ] = None,
    live_commands: Annotated[
        bool, typer.Option("--live-commands", help="Let clients of --live act; otherwise they only read.")
    ] = False,
    ros: Annotated[
        str | None,
        typer.Option(
            "--ros",
            metavar="[URL]",
            help="Publish it for nodes of ROS 2 as it goes on, or of ROS 1 at ros1://HOST:PORT, and do what they ask.",
        ),
    ] = None,
    no_ros: Annotated[bool, typer.Option("--no-ros", help="Without ROS, though the profile has it.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Also print the tables of links, tasks, clocks and faults.")
    ] = False,
    as_json: Json = False,
    overwrite: Overwrite = False,
) -> None:
    """Run a simulation.

    Exit code: 0 completed, or --duration reached; 1 not completed; 2 something to put right; 130 interrupted.
    """
    from xitl_cli.commands.sim_report import show_result
    from xitl_cli.profile import load_with_origins
    from xitl_cli.run.core.directory import default_path
    from xitl_cli.run.nodes.display import make_display
    from xitl_cli.run.operator.operation import operation_of
    from xitl_cli.run.session import run

    if profile is not None and profile_option is not None:
        raise UserError(f"{profile} and --profile {profile_option}: are two profiles; give one of them")
    if view is False and (view_host is not None or view_port is not None):
        raise UserError("--no-view and --view-host or --view-port: are of no view and of one; give one of them")
    options = {
        "clock.duration_s": duration,
        "clock.mode": clock,
        "clock.seed": seed,
        "autopilot.firmware": firmware,
        "view.show": True if view_host is not None or view_port is not None else view,
        "view.host": view_host,
        "view.port": view_port,
        **live_options(live, live_port, live_commands),
        **ros_options(ros, no_ros),
    }
    given = [f"{key}={value}" for key, value in options.items() if value is not None]
    found = load_with_origins(profile or profile_option or DEFAULT_PROFILE, [*(overrides or []), *given], parts or ())
    loaded = found.profile
    operation = operation_of(loaded, replay_events, pace)
    console = terminal(stderr=as_json)
    result = run(
        loaded,
        out or default_path(loaded.name),
        overwrite,
        lambda: make_display(console, loaded.name, as_json),
        timed=duration is not None,
        warnings=[*found.warnings, *_beyond_firmware(loaded, firmware)],
        operation=operation,
        tell=lambda text: console.print(text, soft_wrap=True),
    )
    with still_read():
        if as_json:
            typer.echo(json.dumps(result.summary, indent=2, allow_nan=False))
        else:
            show_result(console, result, verbose)
    if result.summary["error"]:
        raise UserError(f"{result.summary['error']} (what was recorded is in {result.directory})")
    raise typer.Exit(result.exit_code)


class SimCommand(TyperCommand):
    """A command in which `--ros` may have no value: the next word is its value only if it names a ROS."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        whole = []
        for number, text in enumerate(args):
            follows = args[number + 1] if number + 1 < len(args) else ""
            whole.append("--ros=ros2" if text == "--ros" and not follows.startswith(("ros1:", "ros2")) else text)
        return super().parse_args(ctx, whole)


def live_options(live: str | None, port: int | None, commands: bool) -> dict[str, Any]:
    """Return the profile keys for `--live`, `--live-port` and `--live-commands`.

    Raises UserError for another server.
    """
    if live not in (None, "foxglove"):
        raise UserError(f"--live {live}: is not known; use foxglove, or --view for a page of xitl's own")
    given = {"live.port": port, "live.commands": True if commands else None}
    return {"live.foxglove": True, **given} if live is not None or any(given.values()) else {}


def ros_options(ros: str | None, without: bool) -> dict[str, str | None]:
    """Return the profile keys for `--ros` and `--no-ros`. Raises UserError for an unknown ROS."""
    if without:
        if ros is not None:
            raise UserError("--ros and --no-ros: are opposites; give one of them")
        return {"ros.enabled": "false"}
    if ros is None:
        return {}
    if ros == "ros2":
        return {"ros.enabled": "true", "ros.master": "null"}
    if ros.startswith("ros1:"):
        return {"ros.enabled": "true", "ros.master": ros}
    raise UserError(f"--ros {ros}: names no ROS; use --ros, or --ros ros1://localhost:11311")


def _beyond_firmware(profile: Profile, firmware: str | None) -> Iterator[str]:
    """Yield a sentence with the vessels that `--firmware` does not affect."""
    if firmware is None or profile.vessels is None:
        return
    given = None if profile.autopilot is None else profile.autopilot.firmware
    autopilots = {name: one.autopilot for name, one in profile.sailed.items() if one.autopilot is not None}
    own = [name for name, one in autopilots.items() if one.started_here and one.firmware != given]
    if own:
        keys = f"vessels.{own[0]}.autopilot.firmware=PATH"
        yield f"--firmware does not reach {', '.join(own)}, which have a firmware of their own; use --set {keys}"
