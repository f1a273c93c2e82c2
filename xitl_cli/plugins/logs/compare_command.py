"""`xitl logs compare`."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from xitl_cli.commands.options import Json, OpenPage, Vessel
from xitl_cli.commands.output import open_in_browser, quiet_pipe, tell_damage, tell_vessels
from xitl_cli.errors import UserError
from xitl_cli.logs.model.text import printable

if TYPE_CHECKING:
    from xitl_cli.logs.compare.comparison import Comparison
    from xitl_cli.logs.model.log import Log
    from xitl_cli.logs.report.page import FileCard, Page


AlignMethod = StrEnum("AlignMethod", {"NONE": "none", "ORIGIN": "origin", "SE3": "se3", "SIM3": "sim3"})
PathKind = StrEnum("PathKind", {"ESTIMATE": "estimate", "TRUTH": "truth"})


class StartMethod(StrEnum):
    AUTO = "auto"
    CLOCKS = "clocks"
    MISSION = "mission"
    ARMED = "armed"
    MOTION = "motion"
    CORRELATION = "correlation"


def compare(
    a: Annotated[
        Path, typer.Argument(metavar="A", help="The reference: a .bin, .tlog or MCAP file, or a run's directory.")
    ],
    b: Annotated[Path, typer.Argument(metavar="B", help="The log to compare with it; may be the same file.")],
    align: Annotated[
        AlignMethod,
        typer.Option(
            help="Align B's path with A's: by the first poses (origin) or by least squares (se3, with scale sim3)."
        ),
    ] = AlignMethod.NONE,
    start: Annotated[
        StartMethod, typer.Option(help="Align B's time with A's by clocks, or by an event in both.")
    ] = StartMethod.AUTO,
    shift: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="B begins this much later than A; replaces --start.")
    ] = None,
    of_a: Annotated[
        PathKind, typer.Option("--of-a", help="A's path: the autopilot's estimate, or the simulated truth.")
    ] = (PathKind.ESTIMATE),
    of_b: Annotated[PathKind, typer.Option("--of-b", help="B's path, likewise.")] = PathKind.ESTIMATE,
    from_time: Annotated[
        str | None,
        typer.Option("--from", metavar="TIME", help="Compare from this time after the zero, named at first."),
    ] = None,
    until_time: Annotated[
        str | None, typer.Option("--until", metavar="TIME", help="Compare up to this time: 90, 1:30.5 or 1:02:03.")
    ] = None,
    armed: Annotated[bool, typer.Option("--armed", help="Compare only while both were armed.")] = False,
    vessel: Vessel = None,
    vessel_b: Annotated[
        str | None, typer.Option("--vessel-b", metavar="NAME", help="Vessel of B, if it is another one.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FILE", help="Write the plots and tables as one HTML page.")
    ] = None,
    tum: Annotated[
        Path | None,
        typer.Option("--tum", metavar="DIRECTORY", help="Write both compared paths for evo: a.tum and b.tum."),
    ] = None,
    open_page: OpenPage = False,
    as_json: Json = False,
) -> None:
    """Compare two logs: paths, errors, profiles, channels, events, scheduler, time bases."""
    from xitl_cli.log_analyses import log_analyses
    from xitl_cli.logs import open_log
    from xitl_cli.logs.compare.comparison import OVERLAID
    from xitl_cli.logs.compare.comparison import compare as compare_logs
    from xitl_cli.logs.model.text import parse_optional_seconds
    from xitl_cli.logs.report import html

    if report is None and open_page:
        report = Path("compare.html")
    if report is not None:
        html.refuse_other(report)
    with open_log(a, vessel or "") as log_a, open_log(b, vessel_b or vessel or "") as log_b:
        if vessel is None:
            tell_vessels(*((log.path, log.vessel, log.vessels) for log in ([log_a] if a == b else [log_a, log_b])))
        comparison = compare_logs(
            log_a,
            log_b,
            align=align.value,
            start=start.value,
            shift_s=shift,
            of_a=of_a.value,
            of_b=of_b.value,
            from_s=parse_optional_seconds(from_time),
            until_s=parse_optional_seconds(until_time),
            armed=armed,
            analyses=log_analyses(OVERLAID),
        )
        page = _page(log_a, log_b, comparison) if report is not None else None
        tell_damage(*([log_a] if a == b else [log_a, log_b]))
    if tum is not None:
        _write_tum(tum, comparison)
    if page is not None and report is not None:
        html.write_page(page, report)
    with quiet_pipe():
        if as_json:
            print(json.dumps(_document(a, b, comparison), indent=2, allow_nan=False))
        else:
            _show(a, b, comparison, report)
    if open_page and report is not None:
        open_in_browser(report)


def _document(a: Path, b: Path, comparison: Comparison) -> dict[str, Any]:
    from xitl_cli.logs.clocks.time_line import TimeLine
    from xitl_cli.logs.report.json import section_document

    line = TimeLine(comparison.zero_ns)
    return {
        "a": str(a),
        "b": str(b),
        "time": {
            "method": comparison.pairing.method,
            "sentence": comparison.pairing.sentence,
            "error_s": comparison.pairing.error_s,
            "zero_ns": comparison.zero_ns,
        },
        "sections": {section.key: section_document(section, line) for section in comparison.sections},
    }


def _page(a: Log, b: Log, comparison: Comparison) -> Page:
    from xitl_cli.logs.clocks.time_line import TimeLine
    from xitl_cli.logs.report.build import short_names
    from xitl_cli.logs.report.page import Page, PageMark, PagePart

    line = TimeLine(comparison.zero_ns)
    names = [a.path.name] * 2 if a.path == b.path else short_names([a.path, b.path])
    return Page(
        " and ".join(names),
        f"{comparison.pairing.sentence}; {comparison.zero_sentence}",
        tuple(PagePart(section, line) for section in comparison.sections),
        (_card("A", a), _card("B", b)),
        marks=tuple(
            PageMark(
                "armed" if state.text == "armed" else "mode",
                line.second(state.from_ns),
                line.second(state.until_ns),
                f"A: {state.text}",
            )
            for state in comparison.states
        ),
    )


def _card(name: str, log: Log) -> FileCard:
    from xitl_cli.logs.model.text import duration_text
    from xitl_cli.logs.report.page import FileCard
    from xitl_cli.logs.report.wording import FORMAT_NAMES, damage_sentences

    facts = [("file", str(log.path)), ("format", FORMAT_NAMES[log.format])]
    if log.span_ns is not None:
        facts.append(("duration", duration_text((log.span_ns[1] - log.span_ns[0]) * 1e-9)))
    return FileCard(name, tuple(facts), damage_sentences(log.health))


def _show(a: Path, b: Path, comparison: Comparison, report: Path | None) -> None:
    from xitl_cli.commands.terminal import show_facts, terminal
    from xitl_cli.logs.model.sections import Severity, by_severity
    from xitl_cli.logs.report.terminal import show_section

    console = terminal()
    show_facts(
        console, [("A", str(a)), ("B", str(b)), ("time", comparison.pairing.sentence), ("", comparison.zero_sentence)]
    )
    findings = by_severity(comparison.sections)
    if findings:
        console.print()
        words = ["" if finding.severity == Severity.OK else finding.severity.name for finding in findings]
        sentences = [f"{finding.sentence} {finding.next_step}".rstrip() for finding in findings]
        show_facts(console, list(zip(words, sentences, strict=True)))
    for section in comparison.sections:
        show_section(console, section)
    if report is not None:
        typer.echo(f"\n{printable(str(report))}")


def _write_tum(directory: Path, comparison: Comparison) -> None:
    from xitl_cli.logs.compare.trajectories import tum_text

    if comparison.trajectories is None:
        raise UserError("no trajectories to write, because a log has no positions; omit --tum")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name, trajectory in zip(("a.tum", "b.tum"), comparison.trajectories, strict=True):
            (directory / name).write_text(tum_text(trajectory), encoding="ascii")
    except OSError as error:
        raise UserError(
            f"{directory}: cannot be written ({error.strerror}); choose another directory for --tum"
        ) from error
