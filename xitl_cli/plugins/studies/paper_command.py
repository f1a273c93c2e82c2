"""`xitl paper`: the paper's experiments, with the paper's values and xitl's."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from xitl_cli.commands.options import Json, Overwrite, RunsDuration, RunsSeed
from xitl_cli.commands.output import still_read
from xitl_cli.commands.terminal import say, show_rows, terminal
from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from rich.console import Console

    from xitl_cli.experiment.report import ExperimentReport
    from xitl_cli.experiment.setup import ExperimentSetup

COMPLETED, INCOMPLETE, USER_ERROR, INTERRUPTED = 0, 1, 2, 130
TABLE = "table.json"

Out = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Folder of runs, figures and table.json (default: runs/paper-…-<time>)."),
]
Page = Annotated[bool, typer.Option("--report", help="Write one page with tables and figures: DIR/paper.html.")]
Firmware = Annotated[
    str | None,
    typer.Option("--firmware", metavar="PATH", help="ardurover to start (default: the installed one)."),
]
Real = Annotated[
    Path | None,
    typer.Option(
        "--real", metavar="LOG", help="Log of a real boat with servo outputs and positions: .bin, .tlog or MCAP."
    ),
]
Board = Annotated[
    str | None,
    typer.Option(
        "--board", metavar="URL", help="Agent on a board, such as udp://192.168.7.2:14660 (default: a process here)."
    ),
]


def section_4_1(
    real: Real = None,
    from_s: Annotated[
        float | None,
        typer.Option("--from", metavar="S", help="Start of the replay in LOG's time (default: first armed)."),
    ] = None,
    until_s: Annotated[
        float | None,
        typer.Option("--until", metavar="S", help="End of the replay in LOG's time (default: the end of LOG)."),
    ] = None,
    vehicle: Annotated[
        str,
        typer.Option("--vehicle", metavar="NAME", help="Vessel that the outputs drive: a shipped vehicle, or a .yaml."),
    ] = "asv-third",
    out: Out = None,
    seed: RunsSeed = 1,
    duration: RunsDuration = None,
    report: Page = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Drive the 1/3 scale vessel by recorded motor outputs, and compare positions and speeds with the recording.

    Without --real, the recording is from a run with other parameters, disturbances and noisy sensors.
    Exit code: 0 the replay was completed; 1 it was not; 2 an error.
    """
    setup = _setup(out, "4.1", seed, duration, overwrite, real=real, from_s=from_s, until_s=until_s, vehicle=vehicle)
    _carry_out(("4.1",), setup, report, as_json)


def section_4_2(
    firmware: Firmware = None,
    out: Out = None,
    seed: RunsSeed = 1,
    duration: RunsDuration = None,
    report: Page = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compare the departure times of ArduPilot with its own simulated sensors and with ours, in the paper's
    environments.

    Without an ardurover, the command uses the embedded autopilot and reports it.
    Exit code: 0 the vessel moved in all runs; 1 it did not; 2 an error.
    """
    _carry_out(("4.2",), _setup(out, "4.2", seed, duration, overwrite, firmware=firmware), report, as_json)


def section_4_3(
    board: Board = None,
    firmware: Firmware = None,
    out: Out = None,
    seed: RunsSeed = 1,
    duration: RunsDuration = None,
    report: Page = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compare one mission in software in the loop and in hardware in the loop: path, channels, timing, maps.

    The second run keeps real time. Exit code: 0 both completed the mission; 1 one did not; 2 an error.
    """
    setup = _setup(out, "4.3", seed, duration, overwrite, board=board, firmware=firmware)
    _carry_out(("4.3",), setup, report, as_json)


def section_4_4(
    out: Out = None,
    seed: RunsSeed = 1,
    duration: RunsDuration = None,
    report: Page = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Fuse lidar and sonar in front of a half-submerged branch and an obstacle under water.

    Exit code: 0 both sensors saw their obstacles; 1 one did not; 2 an error.
    """
    _carry_out(("4.4",), _setup(out, "4.4", seed, duration, overwrite), report, as_json)


def wdri(out: Out = None, report: Page = False, overwrite: Overwrite = False, as_json: Json = False) -> None:
    """Compute the eight realism indices of the paper and draw their graphs.

    Exit code: 0 all are as printed; 1 one is not.
    """
    _carry_out(("wdri",), _setup(out, "wdri", 1, None, overwrite), report, as_json)


def all_sections(
    real: Real = None,
    board: Board = None,
    firmware: Firmware = None,
    out: Out = None,
    seed: RunsSeed = 1,
    duration: RunsDuration = None,
    report: Page = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Carry out all experiments in turn. This takes about ten minutes; one run keeps real time.

    Experiments that are impossible here are left out and reported. Exit code: 0 all were completed; 1 one was not; 2 an
    error; 130 interrupted. Completed experiments are kept.
    """
    from xitl_cli.plugins.studies.api import EXPERIMENTS

    setup = _setup(out, "", seed, duration, overwrite, real=real, board=board, firmware=firmware)
    _carry_out(tuple(EXPERIMENTS), setup, report, as_json)


def _setup(
    out: Path | None, section: str, seed: int, duration_s: float | None, overwrite: bool, **more: Any
) -> ExperimentSetup:
    from xitl_cli.experiment.setup import ExperimentSetup, default_directory

    return ExperimentSetup(out or default_directory(section), seed, duration_s, overwrite, **more)


def _carry_out(sections: Sequence[str], setup: ExperimentSetup, page: bool, as_json: bool) -> None:
    """Carry out the sections one after the other. Each is shown and written when it is done."""
    from xitl_cli.experiment.setup import InterruptedRunError
    from xitl_cli.plugins.studies.api import carry_out
    from xitl_cli.plugins.studies.experiments.figures import PAGE, check_figures_installed, write_page

    console = terminal(stderr=as_json, soft_wrap=True)
    if page:
        check_figures_installed()
    setup = replace(setup, tell=lambda line: console.print(line, markup=False))
    done: list[ExperimentReport] = []
    refused: dict[str, str] = {}
    interrupted = False
    for section in sections:
        own = setup if len(sections) == 1 else replace(setup, out=setup.out / section)
        if len(sections) > 1:
            console.print(f"\n{section}: {len(done) + len(refused) + 1} of {len(sections)}", style="bold")
        try:
            report: ExperimentReport | None = carry_out(section, own)
        except (InterruptedRunError, KeyboardInterrupt) as stop:
            interrupted = True
            report = stop.done if isinstance(stop, InterruptedRunError) else None
        except UserError as error:
            if len(sections) == 1:
                raise
            refused[section] = str(error)
            say(console, f"{section} is left out: {error}", "yellow")
            continue
        if report is not None:
            done.append(report)
            _write(console, report, own.out, as_json)
        if interrupted:
            break
    written = setup.out / PAGE if page and done else None
    if written is not None:
        write_page(done, written)
    with still_read():
        if as_json:
            document: dict[str, Any] = done[0].as_json() if done else {}
            if len(sections) > 1:
                document = {"experiments": [report.as_json() for report in done], "left_out": refused}
            document["page"] = None if written is None else str(written)
            typer.echo(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))
        elif written is not None:
            console.print(f"page: {written}", markup=False)
    if interrupted:
        say(console, f"interrupted; completed experiments are kept in {setup.out}")
        raise typer.Exit(INTERRUPTED)
    if refused:
        raise typer.Exit(USER_ERROR)
    raise typer.Exit(COMPLETED if all(report.completed for report in done) else INCOMPLETE)


def _write(console: Console, report: ExperimentReport, directory: Path, as_json: bool) -> None:
    """Write its table and its files, and print their paths."""
    from xitl_cli.experiment.setup import write_file
    from xitl_cli.extras import FIGURES
    from xitl_cli.plugins.studies.experiments.figures import write_figures

    write_file(directory / TABLE, json.dumps(report.as_json(), indent=2, ensure_ascii=False, allow_nan=False) + "\n")
    if not as_json:
        from xitl_cli.experiment.report import told_text

        console.print()
        say(console, f"{report.section}: {report.title}", "bold")
        for note in report.notes:
            say(console, note)
        console.print()
        rows = [
            [row.quantity, told_text(row.paper, row.unit), told_text(row.ours, row.unit), row.difference]
            for row in report.rows
        ]
        show_rows(console, ("quantity", "paper", "ours", "difference"), rows, text=(0, 3))
        console.print()
    if not report.figures:
        drawn = ""
    elif FIGURES.missing:
        drawn = ""
        say(console, f"No figures without {', '.join(FIGURES.missing)}: {FIGURES.pip_line}", "yellow")
    else:
        drawn = ", ".join(path.name for path in write_figures(report, directory)) + ", "
    if not as_json:
        console.print(f"{directory}: {drawn}{TABLE}{', and the runs' if report.runs else ''}", markup=False)
