"""`xitl sim`: one run of a profile."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from xitl_cli.commands.options import DEFAULT_PROFILE, Json, Overwrite, Set, complete_profile
from xitl_cli.commands.output import still_read
from xitl_cli.commands.plain_values import PlainCommand
from xitl_cli.commands.terminal import terminal
from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from xitl_cli.profile import Profile


def sim(
    profile: Annotated[
        str | None,
        typer.Argument(
            metavar="PROFILE",
            help="Name of a shipped profile (`xitl profiles list`) or path of a .yaml file (default: sitl).",
            autocompletion=complete_profile,
        ),
    ] = None,
    profile_option: Annotated[
        str | None,
        typer.Option(
            "--profile",
            "-p",
            metavar="PROFILE",
            help="The profile, as an option instead of the argument.",
            autocompletion=complete_profile,
        ),
    ] = None,
    parts: Annotated[
        list[str] | None,
        typer.Option(
            "--with",
            metavar="PART",
            help="Add a partial profile whose keys override those of the profile: a shipped one such as "
            "environments/calm or faults/lossy-link, or a path. Repeatable.",
            autocompletion=complete_profile,
        ),
    ] = None,
    overrides: Set = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write the run directory here (default: runs/<profile>-<time>)."),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            "--duration",
            metavar="S",
            help="End after this many seconds of simulated time, which also pass while the vessel is frozen until "
            "armed. Reaching them is success (exit code 0). Reaching the profile's limit, clock.duration_s, is not.",
        ),
    ] = None,
    clock: Annotated[
        str | None,
        typer.Option(
            "--clock",
            metavar="MODE",
            help="lockstep (repeatable, as fast as possible) or realtime (default: clock.mode of the profile).",
        ),
    ] = None,
    firmware: Annotated[
        str | None,
        typer.Option(
            "--firmware",
            metavar="PATH",
            help="Autopilot program to start. `find` searches for an installed one; `external` waits for one that you "
            "start. Vessels of a fleet with their own autopilot.firmware keep it.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option("--seed", metavar="N", help="Seed of all random numbers (default: clock.seed of the profile)."),
    ] = None,
    replay_events: Annotated[
        Path | None,
        typer.Option(
            "--replay-events",
            metavar="RUN",
            help="Repeat the operator's actions of an earlier run at their simulated times. RUN is a run directory, "
            "a .mcap or a .jsonl file.",
        ),
    ] = None,
    pace: Annotated[
        float | None,
        typer.Option(
            "--pace",
            metavar="X",
            help="Limit a lockstep run to X times real time (default: as fast as possible; 1 with a view or ROS).",
        ),
    ] = None,
    view: Annotated[
        bool | None,
        typer.Option(
            "--view/--no-view",
            help="Show the run in 3D in a web browser. xitl prints the address of the page.",
            show_default=False,
        ),
    ] = None,
    view_host: Annotated[
        str | None,
        typer.Option(
            "--view-host",
            metavar="ADDRESS",
            help="IP address on which the view listens (default: 127.0.0.1; 0.0.0.0: every network interface).",
        ),
    ] = None,
    view_port: Annotated[
        int | None,
        typer.Option("--view-port", metavar="PORT", help="TCP port of the view (default: 8470, or a free one)."),
    ] = None,
    live: Annotated[
        list[str] | None,
        typer.Option(
            "--live",
            metavar="NAME",
            help="Stream the recorded topics during the run: foxglove, or a live output of a package. Repeatable.",
        ),
    ] = None,
    live_port: Annotated[
        int | None,
        typer.Option(
            "--live-port", metavar="PORT", help="TCP port of --live on 127.0.0.1 (default: 8765, or a free one)."
        ),
    ] = None,
    live_commands: Annotated[
        bool,
        typer.Option("--live-commands", help="Let Foxglove send commands to the run (default: it can only watch)."),
    ] = False,
    ros: Annotated[
        str | None,
        typer.Option(
            "--ros",
            metavar="[URL]",
            help="Publish the recorded topics in ROS during the run and accept commands from ROS nodes: ROS 2, or "
            "ROS 1 with the URL of its master, ros1://HOST:PORT.",
        ),
    ] = None,
    no_ros: Annotated[bool, typer.Option("--no-ros", help="Run without ROS, even if the profile enables it.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Also print tables of links, tasks, clocks and faults.")
    ] = False,
    as_json: Json = False,
    overwrite: Overwrite = False,
) -> None:
    """Run a simulation.

    Exit code: 0 completed, or --duration reached; 1 not completed; 2 wrong input or a failed run; 130 interrupted.
    """
    from xitl_cli.commands.sim_report import show_result
    from xitl_cli.profile import load_with_origins
    from xitl_cli.run.core.directory import default_path
    from xitl_cli.run.nodes.display import make_display
    from xitl_cli.run.operator.operation import operation_of
    from xitl_cli.run.session import run

    if profile is not None and profile_option is not None:
        raise UserError(f"{profile} and --profile {profile_option} are two profiles; give one of them")
    if view is False and (view_host is not None or view_port is not None):
        raise UserError("--no-view contradicts --view-host and --view-port; remove one of them")
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
    settings = [*(overrides or []), *(f"{key}={value}" for key, value in options.items() if value is not None)]
    loaded = load_with_origins(profile or profile_option or DEFAULT_PROFILE, settings, parts or ())
    name, warnings = loaded.profile.name, list(loaded.warnings)
    if firmware is not None:
        warnings += _beyond_firmware(loaded.profile)
    operation = operation_of(loaded.profile, replay_events, pace)
    console = terminal(stderr=as_json)
    result = run(
        loaded.profile,
        out or default_path(name),
        overwrite,
        lambda: make_display(console, name, as_json),
        timed=duration is not None,
        warnings=warnings,
        operation=operation,
        tell=lambda text: console.print(text, soft_wrap=True),
    )
    with still_read():
        if as_json:
            typer.echo(json.dumps(result.summary, indent=2, allow_nan=False))
        else:
            show_result(console, result, verbose)
    if result.summary["error"]:
        raise UserError(f"{result.summary['error']} (the recording until then is in {result.directory})")
    raise typer.Exit(result.exit_code)


class SimCommand(PlainCommand):
    """A command in which `--ros` may have no value: the next word is its value only if it names a ROS."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        whole = []
        for number, text in enumerate(args):
            follows = args[number + 1] if number + 1 < len(args) else ""
            whole.append("--ros=ros2" if text == "--ros" and not follows.startswith(("ros1:", "ros2")) else text)
        return super().parse_args(ctx, whole)


def live_options(live: list[str] | None, port: int | None, commands: bool) -> dict[str, Any]:
    """Return the profile keys for `--live`, `--live-port` and `--live-commands`.

    Raises UserError for a name that no package registers.
    """
    from xitl_cli.profile.schema.profile import added_live_outputs

    added = [name for name in live or [] if name != "foxglove"]
    for name in added:
        if name not in added_live_outputs():
            raise UserError(
                f"--live {name} is unknown; use --live foxglove, or --view for the 3D view of xitl, or install the "
                "package that has this output"
            )
    options: dict[str, Any] = {"live.outputs": f"[{', '.join(added)}]"} if added else {}
    if "foxglove" in (live or []) or port or commands:
        options |= {"live.foxglove": True, "live.port": port, "live.commands": True if commands else None}
    return options


def ros_options(ros: str | None, without: bool) -> dict[str, str | None]:
    """Return the profile keys for `--ros` and `--no-ros`. Raises UserError for an unknown ROS."""
    if without:
        if ros is not None:
            raise UserError("--ros contradicts --no-ros; give one of them")
        return {"ros.enabled": "false"}
    if ros is None:
        return {}
    if ros == "ros2":
        return {"ros.enabled": "true", "ros.master": "null"}
    if ros.startswith("ros1:"):
        return {"ros.enabled": "true", "ros.master": ros}
    raise UserError(f"--ros {ros} is no ROS; use --ros for ROS 2, or --ros ros1://localhost:11311 for ROS 1")


def _beyond_firmware(profile: Profile) -> Iterator[str]:
    """Yield a sentence with the vessels that `--firmware` does not affect."""
    if profile.vessels is None:
        return
    fleet_firmware = None if profile.autopilot is None else profile.autopilot.firmware
    autopilots = {name: vessel.autopilot for name, vessel in profile.sailed.items() if vessel.autopilot is not None}
    own = [name for name, pilot in autopilots.items() if pilot.started_here and pilot.firmware != fleet_firmware]
    if own:
        key = f"vessels.{own[0]}.autopilot.firmware=PATH"
        yield f"--firmware has no effect on {', '.join(own)}: the profile sets their firmware; use --set {key}"
