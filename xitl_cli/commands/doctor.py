"""`xitl doctor`: checks this machine for simulation, and this machine or a board for hardware in the loop."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from xitl_cli.commands.agent import EMULATED, Identity, Port, SshConfig, reached
from xitl_cli.commands.options import DEFAULT_PROFILE, Json, complete_profile

if TYPE_CHECKING:
    from agent.board.doctor import DoctorFinding
    from agent.board.latency import LatencyPlan
    from xitl_cli.deploy.ssh import Board

HOST_PYTHON = (3, 11)
STYLES = {"ok": "", "warning": "yellow", "problem": "bold red"}


def doctor(
    destination: Annotated[
        str | None,
        typer.Argument(
            metavar="USER@HOST",
            help="Check this board over ssh (board:NAME: one of `xitl board`). Default: check this machine.",
        ),
    ] = None,
    link: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Also check that this link can be opened: its port, device or interface."),
    ] = None,
    board: Annotated[
        str | None, typer.Option(metavar="NAME", help="Check this board of `xitl board`, the same as board:NAME.")
    ] = None,
    latency: Annotated[
        bool, typer.Option("--latency", help="Measure start lateness, round trips and clocks instead.")
    ] = False,
    profile: Annotated[
        str | None,
        typer.Option(
            metavar="PROFILE",
            help=f"--latency: use the clock rates of this profile (default: {DEFAULT_PROFILE}).",
            autocompletion=complete_profile,
        ),
    ] = None,
    rate: Annotated[
        list[float] | None, typer.Option(metavar="HZ", help="--latency: use this rate. Repeatable.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="--latency: time of each measured loop (default: 10).")
    ] = None,
    load: Annotated[bool, typer.Option("--load", help="--latency: measure again with busy processors.")] = False,
    agent: Annotated[
        str | None,
        typer.Option(metavar="URL", help="--latency: measure the round trip to the agent that waits at this address."),
    ] = None,
    as_json: Json = False,
    port: Port = None,
    identity: Identity = None,
    ssh_config: SshConfig = None,
) -> None:
    """Check that this machine or a board is ready for runs, and print how to correct each problem.

    This machine: packages, firmware and ports for simulation. This machine or a board: kernel, permissions, clocks and
    devices for hardware in the loop. Exit code 1 when something will not work.

    With --latency, the command measures how late a periodic task starts, next to a bare sleep, and which rates this
    machine or board can hold. Exit code 1 when it cannot hold a rate.
    """
    from agent.board.doctor import examine, exit_code, findings_to_json
    from xitl_cli.errors import UserError

    if board is not None:
        if destination is not None:
            raise UserError(f"--board {board}: {destination} is a board too; give one of them")
        destination = f"{EMULATED}:{board}"
    of_latency = {"--profile": profile, "--rate": rate, "--duration": duration, "--load": load, "--agent": agent}
    if latency:
        if link is not None:
            raise UserError("--link: --latency opens no link of an agent; use --agent for one that waits")
        plan = _latency_plan(profile, rate, 10.0 if duration is None else duration, load, agent or "")
        reached_board = None if destination is None else reached(destination, port, identity, ssh_config)
        raise typer.Exit(_show_latency(reached_board, plan, as_json))
    for name, value in of_latency.items():
        if value:
            raise UserError(f"{name} is an option of the latency measurement; add --latency")
    simulating: list[DoctorFinding] = []
    if destination is None:
        from xitl_cli.readiness import examine_simulating

        simulating, machine = examine_simulating(), examine(link, HOST_PYTHON)
    else:
        machine = _examine_board(reached(destination, port, identity, ssh_config), link)
    if as_json:
        typer.echo(findings_to_json([*simulating, *machine]))
    else:
        _show(simulating, machine)
    raise typer.Exit(exit_code([*simulating, *machine]))


def _show(simulating: list[DoctorFinding], machine: list[DoctorFinding]) -> None:
    """Print the findings of each part, and the verdicts last."""
    from xitl_cli.commands.terminal import say, show_facts, terminal
    from xitl_cli.readiness import verdict, without_optional

    console = terminal()
    verdicts = []
    for title, purpose, findings in (
        ("Simulating", "simulating on this machine", simulating),
        ("Agent and hardware in the loop", "agent and hardware in the loop", machine),
    ):
        if not findings:
            continue
        say(console, title, "bold")
        facts = []
        for finding in findings:
            level = "" if finding.level == "ok" else f"{finding.level}: "
            advice = f"\n→ {finding.advice}" if finding.advice else ""
            facts.append((finding.check, f"{level}{finding.found}{advice}", STYLES[finding.level]))
        show_facts(console, facts)
        console.print()
        level, sentence = verdict(purpose, findings)
        verdicts.append((sentence + without_optional(findings), STYLES[level] or "green"))
    for sentence, style in verdicts:
        say(console, sentence, f"bold {style}")


def _examine_board(board: Board, link: str | None) -> list[DoctorFinding]:
    from agent.board.doctor import findings_from_objects
    from xitl_cli.deploy.package import build
    from xitl_cli.deploy.ssh import run_there
    from xitl_cli.errors import UserError

    arguments = ["doctor", "--for-host", *([] if link is None else [f"--link={link}"])]
    outcome = run_there(board, build(), arguments, b"")
    try:
        return findings_from_objects(outcome.get("findings"))
    except ValueError as error:
        raise UserError(f"{board.destination}: the answer of the board is {error}; try again") from None


def _latency_plan(
    profile: str | None, rates: list[float] | None, duration_s: float, load: bool, agent_url: str
) -> LatencyPlan:
    """Return the plan with the rates of the options. Raises UserError."""
    from agent.board.latency import LatencyError, LatencyPlan
    from xitl_cli.errors import UserError

    if rates and profile is not None:
        raise UserError(f"--rate: the profile {profile} already sets the rates; give one of them")
    if not rates:
        from xitl_cli.profile import load_profile

        clock = load_profile(profile or DEFAULT_PROFILE).run_profiles()[0].clock
        rates = [clock.physics_rate_hz, clock.exchange_rate_hz]
    try:
        return LatencyPlan(tuple(dict.fromkeys(map(float, rates))), duration_s, load, agent_url)
    except LatencyError as error:
        raise UserError(str(error)) from None


def _show_latency(board: Board | None, plan: LatencyPlan, as_json: bool) -> int:
    """Measure on this machine or on the board, and print the report. Return the exit code. Raises UserError."""
    import json

    from agent.board.latency import LatencyError, holds_all, measure, report_text
    from xitl_cli.commands.terminal import progress
    from xitl_cli.errors import UserError

    try:
        with progress(f"measuring, about {plan.total_s:.0f} s") as tell:
            report = measure(plan, tell) if board is None else _measure_board(board, plan)
    except LatencyError as error:
        raise UserError(str(error)) from None
    typer.echo(json.dumps(report, indent=2, ensure_ascii=False) if as_json else report_text(report))
    return 0 if holds_all(report) else 1


def _measure_board(board: Board, plan: LatencyPlan) -> dict[str, Any]:
    """Return the report of the board. The round trip to an address is measured from this machine."""
    from agent.board.latency import measure_link
    from xitl_cli.deploy.package import build
    from xitl_cli.deploy.ssh import LONGEST_S, run_there
    from xitl_cli.errors import UserError

    arguments = ["doctor", "--for-host", "--latency", f"--duration={plan.duration_s!r}"]
    arguments += [f"--rate={rate_hz!r}" for rate_hz in plan.rates_hz] + ["--load"] * plan.loaded
    report = run_there(board, build(), arguments, b"", LONGEST_S + 2.0 * plan.total_s).get("latency")
    if not isinstance(report, dict):
        raise UserError(f"{board.destination}: the answer of the board is no report of a latency; try again")
    if plan.agent_url:
        report["links"].append(measure_link(plan.agent_url, plan.duration_s))
    return report
