"""`xitl twin`: the model of a boat next to the real boat."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.commands.options import Json, Overwrite, Set, complete_vehicle
from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console

    from sim_core.environment.spec import Water
    from xitl_cli.plugins.twin.boat import Outputs
    from xitl_cli.plugins.twin.session import TwinReport
    from xitl_cli.profile.load import LoadedProfile


def twin(
    boat: Annotated[
        str,
        typer.Option(
            "--boat",
            metavar="URL|FILE",
            help="Where the telemetry of the boat arrives, such as udp://:14550, or a telemetry log (.tlog). The twin "
            "only listens.",
        ),
    ],
    vehicle: Annotated[
        str,
        typer.Option(
            "--vehicle",
            metavar="VEHICLE",
            help="File or name of the vehicle, or a profile with it.",
            autocompletion=complete_vehicle,
        ),
    ],
    seconds: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Compare this time and end; default: until Ctrl-C.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The recording.")] = Path("twin.mcap"),
    outputs: Annotated[
        str | None,
        typer.Option(
            metavar="CHANNELS",
            help="Servo outputs of the actuators, in the order of the vehicle; default: those of the profile, 1,3.",
        ),
    ] = None,
    system: Annotated[
        int | None,
        typer.Option(metavar="ID", min=1, max=255, help="System id of the boat; default: the first autopilot heard."),
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Show boat and ghost in the 3D view.")] = False,
    overwrite: Overwrite = False,
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Run the model of a boat next to the real boat, record both, and name their difference.

    The model gets the servo outputs of the boat. The twin compares the motions and reports a change of a propeller, of
    the drag, of the current, of the compass or of the position. It never sends anything to the boat.

    Exit code: 0 no difference, 1 a difference was found, 2 the boat or the vehicle cannot be used.
    """
    from xitl_cli.commands.terminal import say, terminal
    from xitl_cli.plugins.twin.boat import open_boat
    from xitl_cli.plugins.twin.live import live_observer
    from xitl_cli.plugins.twin.session import LINK, Twin
    from xitl_cli.profile import load_with_origins
    from xitl_cli.record.recorder import Recorder
    from xitl_cli.run.session import Interruption

    loaded = load_with_origins(vehicle, overrides or ())
    model = loaded.profile.vehicle
    if model is None:
        raise UserError(f"{loaded.entry.origin.source}: has no vehicle; use a file with a group `vehicle`")
    channels = _outputs(loaded, outputs)
    if out.exists() and not overwrite:
        raise UserError(f"{out}: exists; choose another file with --out, or add --overwrite")
    console = terminal(stderr=as_json)
    interruption = Interruption()
    with ExitStack() as opened, interruption.noticed():
        source = open_boat(boat)
        opened.callback(source.close)
        out.parent.mkdir(parents=True, exist_ok=True)
        out.unlink(missing_ok=True)
        recorder = Recorder(out, "lz4", links=(LINK,))
        opened.callback(recorder.close)
        observers = [opened.enter_context(live_observer(loaded, vehicle, recorder, _say(console)))] if view else []
        try:
            session = Twin(source, model, _water(loaded), channels, recorder, system, observers)
        except ValueError as error:
            raise UserError(f"{loaded.origin('vehicle')}: {model.name} {error}") from None
        if not as_json:
            say(console, f"twin of {model.name}: listens at {source.name}, records {out}")
        report = session.run(seconds, _say(console), interruption)
    if as_json:
        typer.echo(json.dumps(report.as_json(), ensure_ascii=False, allow_nan=False))
    else:
        _show(report)
    raise typer.Exit(1 if report.alarms else 0)


def _say(console: Console) -> Callable[[str], None]:
    from xitl_cli.commands.terminal import say

    return lambda text: say(console, text, "yellow")


def _water(loaded: LoadedProfile) -> Water:
    from sim_core.environment.spec import Water

    environment = loaded.profile.environment
    return Water() if environment is None else environment.water


def _outputs(loaded: LoadedProfile, text: str | None) -> Outputs:
    """Return the outputs of the option, otherwise of the profile's bridge."""
    from xitl_cli.plugins.twin.boat import Outputs

    autopilot = loaded.profile.autopilot
    bridge = None if autopilot is None else autopilot.bridge
    of_profile = Outputs() if bridge is None else Outputs(tuple(bridge.outputs), bridge.trim_us, bridge.span_us)
    if text is None:
        return of_profile
    parts = text.split(",")
    if not all(part.strip().isdigit() and 1 <= int(part) <= 16 for part in parts):
        raise UserError(f"--outputs {text}: is not a list of channels from 1 to 16; write for example 1,3")
    return Outputs(tuple(int(part) for part in parts), of_profile.trim_us, of_profile.span_us)


def _show(report: TwinReport) -> None:
    from xitl_cli.commands.terminal import show_facts, terminal

    values = report.as_json()
    predicted = values["prediction_30_s"]
    errors = "none yet"
    if predicted["count"]:
        errors = f"median {predicted['median_m']:.1f} m, 95 % within {predicted['p95_m']:.1f} m ({predicted['count']})"
    found = f"{len(report.alarms)}" if report.alarms else "none"
    facts = [
        ("boat        ", f"system {report.system_id}, {report.frames} messages"),
        ("compared    ", f"{report.seconds:.0f} s"),
        ("30 s ahead  ", errors),
        ("differences ", found),
    ]
    if report.wdri is not None:
        facts.append(("WDRI        ", f"{report.wdri.wdri:.4f}, system in the loop"))
    show_facts(terminal(), facts)
