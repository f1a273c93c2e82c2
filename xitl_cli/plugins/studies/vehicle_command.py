"""`xitl vehicle check`: behaviour of a vessel from its file, and suspicious values."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.commands.options import Json, Set, complete_vehicle
from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from xitl_cli.plugins.studies.manoeuvres.vessel_check import VesselCheck
    from xitl_cli.profile.load import LoadedProfile


def check(
    name: Annotated[
        str,
        typer.Argument(
            metavar="VEHICLE",
            help="File or name of a vehicle (`xitl profiles list`), or a profile with one; the check also uses the "
            "waves and the mission of the profile.",
            autocompletion=complete_vehicle,
        ),
    ],
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Compute how a vessel floats, moves, turns and stops from its file alone, and report suspicious values.

    Exit code: 0 done, also with suspicious values; 2 the file is invalid, or the vessel does not float.
    """
    from xitl_cli.plugins.studies.manoeuvres.vessel_check import Demands, check_vessel
    from xitl_cli.profile import load_with_origins

    loaded = load_with_origins(name, overrides or ())
    profile, *others = loaded.profile.one_a_vehicle
    if others:
        names = ", ".join(vessel.vehicle.name for vessel in (profile, *others) if vessel.vehicle)
        raise UserError(f"{loaded.entry.origin.source}: has several vehicles ({names}); check one of them")
    if (vehicle := profile.vehicle) is None:
        raise UserError(f"{loaded.entry.origin.source}: has no vehicle; use a file with a group `vehicle`")
    demands = Demands(
        environment=profile.environment,
        mission_speed_mps=None if profile.mission is None else profile.mission.speed_mps,
        **({} if profile.clock is None else {"physics_rate_hz": profile.clock.physics_rate_hz}),
    )
    try:
        result = check_vessel(vehicle, demands)
    except ValueError as error:
        raise UserError(f"{loaded.origin('vehicle')}: {vehicle.name} {error}") from None
    if as_json:
        import json

        findings = [
            {
                "rule": finding.rule,
                "severity": finding.severity.name.lower(),
                "key": finding.key,
                "where": str(loaded.origin(finding.key)),
                "sentence": finding.sentence,
                "next_step": finding.next_step,
            }
            for finding in result.findings
        ]
        document = {"vehicle": result.vehicle, "figures": result.values, "findings": findings}
        typer.echo(json.dumps(document, ensure_ascii=False, allow_nan=False))
        return
    _show(result, loaded)


def _show(result: VesselCheck, loaded: LoadedProfile) -> None:
    from xitl_cli.commands.terminal import say, show_facts, terminal
    from xitl_cli.logs.model.sections import Severity
    from xitl_cli.logs.report.wording import UNKNOWN, value_text

    console = terminal()
    width = max(len(fact.label) for _, facts in result.figures for fact in facts) + 2
    for title, facts in result.figures:
        if not facts:
            continue
        say(console, title, "bold")
        for fact in facts:
            text = value_text(fact.value)
            shown = text if text == UNKNOWN else f"{text} {fact.unit}".rstrip()
            show_facts(console, [(f"  {fact.label:<{width}}", shown)])
        console.print()
    if not result.findings:
        say(console, "No suspicious values.", "green")
        return
    say(console, "Suspicious values", "bold")
    for finding in result.findings:
        serious = finding.severity >= Severity.WARNING
        show_facts(
            console,
            [
                (
                    f"  {'warning' if serious else 'notice':<7}",
                    f"{finding.key} ({loaded.origin(finding.key)}): {finding.sentence}\n→ {finding.next_step}",
                    "yellow" if serious else "",
                )
            ],
        )
