"""`xitl logs analyze|plot`."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.commands.options import From, Json, OpenPage, Raw, Until, Vessel, complete_section
from xitl_cli.commands.output import open_in_browser, quiet_pipe, refuse, tell_vessels
from xitl_cli.errors import UserError
from xitl_cli.logs.model.text import printable
from xitl_cli.registry import LOG_REPLAYS, load

if TYPE_CHECKING:
    from xitl_cli.logs.report.model import Report
    from xitl_cli.logs.report.page import Replay

XITL_REPLAY = "view"
"""Name of xitl's own replay."""


def analyze(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="DataFlash .bin, .ulg, .tlog, .mcap or bag; several of one run are aligned. The directory of a run "
            "contributes its recording and its autopilot's log.",
        ),
    ],
    report: Annotated[
        Path | None,
        typer.Option("--report", metavar="HTML", help="Write a page with plots and a map; it replaces an earlier one."),
    ] = None,
    sections: Annotated[
        list[str] | None,
        typer.Option(
            "--section",
            metavar="NAME",
            help="Only this analysis, such as scheduler. Repeatable.",
            autocompletion=complete_section,
        ),
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="With --report, also print all facts here.")] = False,
    vessel: Vessel = None,
    with_replay: Annotated[
        bool, typer.Option("--replay/--no-replay", help="With --report, show the 3D replay next to the map.")
    ] = True,
    replay_by: Annotated[
        str, typer.Option("--replay-by", metavar="NAME", help="Make it with the replay of a package (default: view).")
    ] = XITL_REPLAY,
    chart: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="FILE",
            help="With --report, draw this below the track: GeoJSON, MBTiles, or a folder of tiles {z}/{x}/{y}.png.",
        ),
    ] = None,
    as_json: Json = False,
    open_it: OpenPage = False,
) -> None:
    """Analyse logs: findings first, each with its evidence and a next step.

    Exit code: 0 analysed, whatever was found; 1 an analysis failed; 2 a file could not be read (the others are
    analysed).
    """
    from xitl_cli.commands.terminal import progress
    from xitl_cli.log_analyses import log_analyses, sections_named
    from xitl_cli.logs.report import html
    from xitl_cli.logs.report.build import OVERVIEW, build_report, with_chart
    from xitl_cli.logs.report.json import document

    wanted = sections_named(sections or ())
    analyses = log_analyses(wanted)
    overview = not wanted or OVERVIEW in wanted
    page = report or (_page_path(files[0], "report") if open_it else None)
    if page is not None:
        html.refuse_other(page)
    if chart is not None and (page is None or not overview):
        raise UserError("--map draws below the track of a report; add --report FILE.html, without --section")
    if replay_by != XITL_REPLAY:
        load(LOG_REPLAYS, replay_by)  # refused before the analysis
    with progress("opening") as show_progress:
        held = page is not None
        results = build_report(files, analyses, show_progress, vessel or "", overview=overview, signals_held=held)
        if page is not None and results.files:
            if chart is not None:
                results = with_chart(results, chart)
            replay = None
            if with_replay and overview:
                show_progress("3D replay")
                replay = _replay(results, vessel, replay_by)
            show_progress("page")
            html.write(results, page, replay)
    with quiet_pipe():
        if as_json:
            print(json.dumps(document(results), allow_nan=False, ensure_ascii=False))
        elif results.files:
            _show(results, page, verbose)
    if page is not None and open_it and results.files:
        open_in_browser(page)
    if vessel is None:
        tell_vessels(*((file.path, file.vessel, file.vessels) for file in results.files))
    for file in results.files:
        for failure in file.failures:
            typer.echo(f"error: {file.name}: {failure.sentence}", err=True)
    refuse([refusal.sentence for refusal in results.refusals])
    raise typer.Exit(1 if results.failures else 0)


def _replay(results: Report, vessel: str | None, name: str) -> Replay:
    """Return the report's logs in 3D from the replay plug-in `name`, or a sentence with the reason for no replay."""
    from xitl_cli.logs.report.page import Replay
    from xitl_cli.registry import PluginError, guarded

    try:
        made: Replay = guarded(LOG_REPLAYS, name, load(LOG_REPLAYS, name), results, vessel)
    except PluginError as error:
        return Replay(note=f"there is no 3D replay: {error}")
    return made


def plot(
    arguments: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE... SIGNAL...",
            help="Logs or directories of runs, then the signals to draw: ATT.Roll, 'IMU[1].AccX', RCOU, "
            "'/truth/state.position_ned_m[0]', or expressions of these: 'wrap180(ATT.DesYaw - ATT.Yaw)', "
            "'hypot(XKF1.VN, XKF1.VE)'.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", help="A page .html (default: <log>.plot.html right here), or .png, .svg or .pdf."
        ),
    ] = None,
    from_time: From = None,
    until_time: Until = None,
    raw: Raw = False,
    vessel: Vessel = None,
    open_it: OpenPage = False,
) -> None:
    """Plot signals of logs, and expressions of them, on one page: a plot for each unit, all on one time line.

    The suffix of --out gives the format: a page (.html), or an image (.png, .svg, .pdf; extra `figures`).

    Exit code 2 when a file cannot be read (the others are drawn).
    """
    from xitl_cli.logs.model.text import parse_optional_seconds
    from xitl_cli.logs.report import html
    from xitl_cli.logs.report.signal_page import is_image, refuse_other_image, signal_page, write_image

    files, signals = _files_and_signals(arguments)
    from_s, until_s = parse_optional_seconds(from_time), parse_optional_seconds(until_time)
    if from_s is not None and until_s is not None and until_s <= from_s:
        raise UserError(f"--until {until_time} is not after --from {from_time}; swap them")
    path = out or _page_path(files[0], "plot")
    drawn = is_image(path)
    (refuse_other_image if drawn else html.refuse_other)(path)
    page, refusals = signal_page(files, signals, from_s, until_s, raw=raw, vessel=vessel)
    (write_image if drawn else html.write_page)(page, path)
    typer.echo(str(path))
    for notice in page.notices[len(refusals) :]:
        typer.echo(printable(notice), err=True)
    for card in page.cards:
        if card.degraded:
            typer.echo(printable(f"{card.name}: degraded: {'; '.join(card.notes)}"), err=True)
    if open_it:
        open_in_browser(path)
    refuse([refusal.sentence for refusal in refusals])


def _files_and_signals(arguments: Sequence[str]) -> tuple[list[Path], list[str]]:
    """Split arguments: those up to the last existing path are files, the rest are signals."""
    there = [index for index, text in enumerate(arguments) if os.path.exists(text)]  # noqa: PTH110  never raises
    if not there:
        raise UserError(f"{arguments[0]}: does not exist; write a log first, then signals such as ATT.Roll")
    files, signals = list(arguments[: there[-1] + 1]), list(arguments[there[-1] + 1 :])
    if not signals:
        raise UserError("no signal to draw; add some after the file, such as ATT.Roll or GPS.Spd")
    return [Path(text) for text in files], signals


def _show(results: Report, page: Path | None, verbose: bool) -> None:
    """Show findings, and the facts of all sections without a page or on request."""
    from xitl_cli.commands.terminal import terminal
    from xitl_cli.logs.report.terminal import show

    show(terminal(), results, sections=verbose or page is None)
    if page is not None:
        typer.echo(f"\n{printable(str(page))}: all sections with plots; open it in a browser")


def _page_path(log: Path, kind: str) -> Path:
    """Return a page in the current directory: the directory of a log is often read-only."""
    return Path(f"{log.stem}.{kind}.html")
