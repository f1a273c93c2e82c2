"""Opens logs, lays them on one time line and runs every analysis on each."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from xitl_cli.logs.analyses import catalogue
from xitl_cli.logs.analyses.failure import Failure, failure
from xitl_cli.logs.errors import LogError
from xitl_cli.logs.log import Log
from xitl_cli.logs.query.names import match
from xitl_cli.logs.query.times import zero_ns
from xitl_cli.logs.report.model import FileReport, Overview, Refusal, Report
from xitl_cli.logs.report.thinning import thin
from xitl_cli.logs.report.words import vehicle_line
from xitl_cli.logs.sections import Plot, Section
from xitl_cli.logs.timeline.line import LaidLog, TimeLine

OVERVIEW = "overview"
VEHICLE = "vehicle"  # always asked: it heads every report
SECTIONS = (OVERVIEW, *catalogue.NAMES)

Progress = Callable[[str], None]


def build(paths: Sequence[Path], only: Collection[str] = (), told: Progress = lambda _: None) -> Report:
    """Of every file that can be opened; the others become refusals.

    only: names of SECTIONS; none means all. told: hears what is being done. Raises LogError for a section that does
    not exist.
    """
    wanted = sections_named(only)
    with ExitStack() as opened:
        logs, refusals = open_all(paths, opened)
        names = short_names([log.path for log in logs])
        laid = [LaidLog(log, time_line) for log, time_line in zip(logs, lay(logs), strict=True)]
        files = [_file(log, name, wanted, told) for log, name in zip(laid, names, strict=True)]
        overview = Overview()
        if OVERVIEW in wanted and files:
            told(OVERVIEW)
            files, overview = _with_overview(files, laid)
        # Damage inside of a recording is found when its topics are read.
        files = [replace(file, health=log.health) for file, log in zip(files, laid, strict=True)]
        return Report(tuple(files), tuple(refusals), overview)


def open_all(paths: Sequence[Path], opened: ExitStack) -> tuple[list[Log], list[Refusal]]:
    """In their order; a file that was given twice is opened once."""
    from xitl_cli.logs.opening import open_log

    logs: list[Log] = []
    refusals = []
    for path in dict.fromkeys(paths):
        try:
            logs.append(opened.enter_context(open_log(path)))
        except LogError as error:
            refusals.append(Refusal(path, str(error)))
    return logs, refusals


def lay(logs: Sequence[Log]) -> list[TimeLine]:
    """The time line of each log. One that could not be aligned counts from its own beginning, and says so."""
    if len(logs) < 2:
        return [TimeLine(zero_ns=zero_ns(log)) for log in logs]
    from xitl_cli.logs.timeline.alignment import align

    placements = align(logs)
    zero = next(zero_ns(place.log) for place in placements if place.reference)
    return [
        TimeLine(
            zero if place.aligned else zero_ns(place.log),
            place.stretches if place.aligned else (),
            place.offset_ns,
            place.drift_ppm,
            place.error_s,
            place.method,
            place.sentence,
            place.reference,
        )
        for place in placements
    ]


def short_names(paths: Sequence[Path]) -> list[str]:
    """The file's name, with as many of its folders as tell it from the others."""
    named = []
    for path in paths:
        parts = path.absolute().parts
        for many in range(1, len(parts) + 1):
            tail = parts[-many:]
            if sum(other.absolute().parts[-many:] == tail for other in paths) == 1 or many == len(parts):
                named.append("/".join(tail))
                break
    return named


def sections_named(only: Collection[str]) -> list[str]:
    """Of SECTIONS; none means all. Raises LogError for one that does not exist."""
    named = {match(name, SECTIONS, "there is no section", f"choose from {', '.join(SECTIONS)}") for name in only}
    return [name for name in SECTIONS if not named or name in named]


def _file(log: LaidLog, name: str, wanted: Collection[str], told: Progress) -> FileReport:
    sections: list[Section] = []
    failures: list[Failure] = []
    vehicle = ""
    for analysis in catalogue.NAMES:
        if analysis not in wanted and analysis != VEHICLE:
            continue
        told(f"{name}: {analysis}")
        try:
            found = catalogue.analysis(analysis)(log)
        except Exception as error:  # noqa: BLE001  the user still gets what the others found, and this as a failure
            failures.append(failure(analysis, error))
            continue
        if found is None:
            continue
        if analysis == VEHICLE:
            vehicle = vehicle_line([found])
        if analysis in wanted:
            sections.append(_thinned(found))
    return FileReport(
        name,
        log.path,
        log.format,
        log.base,
        log.span_ns,
        log.health,
        dict(log.facts),
        tuple(sections),
        log.time_line,
        vehicle,
        tuple(failures),
    )


def _with_overview(files: list[FileReport], logs: Sequence[Log]) -> tuple[list[FileReport], Overview]:
    from xitl_cli.logs.report.overview import overview

    try:
        return files, overview(logs, files)
    except Exception as error:  # noqa: BLE001  as above
        failed = replace(files[0], failures=(*files[0].failures, failure(OVERVIEW, error)))
        return [failed, *files[1:]], Overview()


def _thinned(section: Section) -> Section:
    """Arrays of its own and no more points than are drawn: the log they came from is closed later."""
    plots = (
        replace(plot, traces=tuple(thin(trace, over_time=plot.kind == "time") for trace in plot.traces))
        for plot in section.plots
    )
    return replace(section, plots=tuple[Plot, ...](plots))
