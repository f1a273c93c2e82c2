"""The tables of speed in docs/figures.md and docs/logs.md, from the kept results of the bench: `make bench-pages`.

    python tools/write_bench.py                    # writes the tables from tests/bench/measured.json
    python tools/write_bench.py build/bench/x.json # keeps the figures of this file first

The tables are between two marks in each page: `<!-- speed -->` and `<!-- end of speed -->`. A kept figure stays until a
newer measurement of it is kept. Each row names the commit that was measured.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.bench.results import FULL, Measured, Results, ResultsError, read_results

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "tests" / "bench" / "measured.json"
FIGURES_PAGE, LOGS_PAGE = ROOT / "docs" / "figures.md", ROOT / "docs" / "logs.md"
BEGIN, END = "<!-- speed -->", "<!-- end of speed -->"
SIMULATOR, BOARD = "100 MB of a simulator", "100 MB of a board"


@dataclass(frozen=True)
class Row:
    """A row of a table."""

    label: str
    form: str
    """Text of a value, with {} for the number."""
    figures: tuple[str, ...]
    """Name of the figure in the bench for each column."""


def _logs(label: str, form: str, name: str) -> Row:
    return Row(label, form, (f"{SIMULATOR}: {name}", f"{BOARD}: {name}"))


SPEED = (
    Row(
        "`sitl`: 400 Hz physics with waves, gusts, four sensors, MAVLink, recording and DataFlash log",
        "{}× real time", ("sitl with waves, gusts, sensors and recording",),
    ),
    Row(
        "the same in lockstep, with the agent in a separate process", "{}× real time",
        ("hitl-loopback in lockstep, the agent in its own process",),
    ),
    Row("`mitl`: no sensors and no autopilot", "{}× real time", ("mitl with waves, gusts and recording",)),
    Row("a fleet of 8 vessels of `sitl` on two cores", "{}× real time", ("fleet of 8 vessels of sitl in lockstep",)),
    Row("a fleet of 32 vessels of `sitl` on two cores", "{}× real time", ("fleet of 32 vessels of sitl in lockstep",)),
    Row(
        "a run of 64 vessels of `mitl`, compared with one vessel", "{} times the time",
        ("run of 64 vessels of mitl over a run of one",),
    ),
    Row(
        "`sitl-perception`: lidar, sonar, KISS-ICP, avoidance and recording, on two cores", "{}× real time",
        ("sitl-perception with recording and KISS-ICP",),
    ),
    Row("`sitl-ardupilot`", "{}× real time", ("sitl-ardupilot at 1200 frames a second",)),
    Row(
        "the speed of `sitl-ardupilot`, compared with a bare echo of ArduPilot's frames", "{} times the echo",
        ("sitl-ardupilot, of a bare echo of the frames",),
    ),
    Row(
        "60 s of `sitl-ardupilot`: processor time, with ArduPilot", "{} s",
        ("sitl-ardupilot, 60 s: processor time",),
    ),
    Row(
        "60 s of `sitl-ardupilot-fast`: processor time, with ArduPilot", "{} s",
        ("sitl-ardupilot-fast, 60 s: processor time",),
    ),
    Row("`sitl-px4`", "{}× real time", ("sitl-px4",)),
    Row(
        "the lidar alone: 100 000 points/s into 113 640 triangles, one core", "{}× real time",
        ("lidar of 100 000 points/s, 100 000 triangles, waves",),
    ),
    Row(
        "its points per second, compared with Embree alone", "{} times the rate",
        ("points of a lidar a second, of bare embree's",),
    ),
    Row("one vessel step with current, waves and gusts", "{} µs", ("one vessel step with environment, N = 1",)),
    Row("one step of a batch of 1024 vessels in waves", "{} ms", ("a step of a batch of 1024 vessels in waves",)),
    Row(
        "vessel steps of 1024 vessels in a learning environment, with observations and rewards",
        "{} a second",
        ("vessel steps of 1024 in a learning environment",),
    ),
    Row(
        "the same in two threads",
        "{} a second",
        ("vessel steps of 1024 in a learning environment, two threads",),
    ),
    Row(
        "a campaign of 60 runs of 60 s on two cores", "{} s", ("campaign of 60 runs of 60 s, two workers",)
    ),
    Row("`xitl --help`", "{} s", ("xitl --help",)),
    Row("`xitl sim` from the command to the first step", "{} s", ("xitl sim until its first step",)),
    Row("agent process: time until it listens", "{} s", ("agent process until it listens",)),
    Row("agent process: resident memory", "{} MiB", ("agent process resident, waiting",)),
    Row("all parameters to a ground station", "{} s", ("all parameters to a ground station",)),
    Row(
        "longest gap of 50 Hz attitude to three ground stations at once", "{} ms",
        ("longest gap of 50 Hz attitude to three stations",),
    ),
    Row(
        "sensor → agent → actuator over UDP at 400 Hz, p50, compared with a Python echo", "{} times the echo",
        ("sensor to actuator at 400 Hz, p50, of an echo's",),
    ),
    Row("the same at p99", "{} times the echo", ("sensor to actuator at 400 Hz, p99, of an echo's",)),
    Row(
        "start lateness at 400 Hz under SCHED_FIFO, p99.9, compared with a bare `clock_nanosleep`", "{}×",
        ("start lateness at 400 Hz, p99.9, of a bare sleep's",),
    ),
    Row("the same with busy processors", "{}×", ("start lateness at 400 Hz under load, p99.9, of a bare sleep's",)),
    Row(
        "processor time of the agent in real time, IMU and exchanges at 100 Hz", "{} % of a core",
        ("agent's processor time at 100 Hz",),
    ),
)  # fmt: skip
LOGS = (
    _logs(
        "every message into scaled columns, opening included, compared with pymavlink's `recv_msg`",
        "{}× as fast", "every message, of pymavlink",
    ),
    _logs(
        "one dense type (IMU, all fields) of an open log, compared with its `recv_match`",
        "{}× as fast", "all fields of its IMU, of pymavlink",
    ),
    _logs(
        "one rare type (PM), opening included: pymavlink has an index too",
        "{}× as fast", "its PM alone with opening, of pymavlink",
    ),
    _logs("memory with every column held, without the file's size", "{} MiB",
          "every column held, memory over the file's size"),
    _logs("`xitl logs info`, the whole command", "{} s", "xitl logs info of it"),
    _logs("`xitl logs analyze --report`, without the replay", "{} s", "xitl logs analyze of it, with a report"),
)  # fmt: skip
OTHER_LOGS = (
    Row("`xitl logs info` of an MCAP of 1 GB", "{} s", ("xitl logs info of a 1 GB recording",)),
    Row("one regular topic of it", "{} % of the file read", ("one topic of a 1 GB recording, read of the file",)),
    Row("telemetry, every message", "{} MB/s", ("every message of a 20 MB telemetry log",)),
    Row(
        "the same, compared with pymavlink", "{}× as fast",
        ("every message of a 20 MB telemetry log, of pymavlink",),
    ),
)  # fmt: skip


def table(results: Results, rows: Sequence[Row], heads: Sequence[str]) -> str:
    """Return the rows whose figures were measured, in Markdown, with a column for the commit."""
    lines = [f"| {' | '.join(['figure', *heads, 'commit'])} |", "|" + "---|" * (len(heads) + 2)]
    for row in rows:
        measured = [results.figures.get(name) for name in row.figures]
        if any(measured):
            commits = dict.fromkeys(figure.run.commit[:8] for figure in measured if figure)
            cells = [_cell(figure, row.form) if figure else "–" for figure in measured]
            lines.append(f"| {' | '.join([row.label, *cells, ', '.join(commits)])} |")
    return "\n".join(lines)


def _cell(figure: Measured, form: str) -> str:
    text = form.format(_number(figure.median))
    if len(figure.values) > 1:
        text += f" ({_number(min(figure.values))} to {_number(max(figure.values))})"
    return text


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def machine_line(results: Results, rows: Sequence[Row]) -> str:
    """Return a sentence on the machines and versions of the rows."""
    names = [name for row in rows for name in row.figures if name in results.figures]
    runs = [results.figures[name].run for name in names]
    places = dict.fromkeys(
        f"{run.machine['processors']} cores of {run.machine['name']} (Python {_minor(run.versions['python'])})"
        for run in runs
    )
    return (
        f"`make bench` measured these medians on {' and on '.join(places)}. The last column names the commit. "
        "Least and most are in parentheses, where more than the median was kept."
    )


def _minor(version: str) -> str:
    return ".".join(version.split(".")[:2])


def pages(results: Results) -> dict[Path, str]:
    """Return the texts between the marks, by page."""
    return {
        FIGURES_PAGE: "\n\n".join([machine_line(results, SPEED), table(results, SPEED, ["median"])]),
        LOGS_PAGE: "\n\n".join(
            [
                machine_line(results, [*LOGS, *OTHER_LOGS]),
                table(results, LOGS, ["simulator", "board"]),
                table(results, OTHER_LOGS, ["median"]),
            ]
        ),
    }


def with_tables(page: str, text: str) -> str:
    """Return the page with this text between its marks. Raises ValueError for a page without marks."""
    pattern = re.compile(rf"({re.escape(BEGIN)}\n\n).*?(\n\n{re.escape(END)})", re.DOTALL)
    if not pattern.search(page):
        raise ValueError(f"has no place for the table; put the lines {BEGIN} and {END} where it belongs")
    return pattern.sub(lambda match: f"{match[1]}{text}{match[2]}", page)


def keep(kept: Results, new: Results) -> Results:
    """Return the kept results with the newer ones. Raises ValueError for results of no commit or of tiny sizes."""
    for figure in new.figures.values():
        run = figure.run
        if run.sizes != FULL or not run.commit or run.changed:
            raise ValueError(
                f"were measured with {run.sizes} sizes at {run.commit[:8] or 'no commit'}"
                f"{' with changes' if run.changed else ''}; commit first, then run `make bench`"
            )
    return kept.updated(new)


def main() -> None:
    try:
        results = read_results(KEPT)
        for name in sys.argv[1:]:
            try:
                results = keep(results, read_results(Path(name)))
            except ValueError as error:
                sys.exit(f"{name}: {error}")
    except ResultsError as error:
        sys.exit(str(error))
    results.write(KEPT)
    for page, text in pages(results).items():
        try:
            page.write_text(with_tables(page.read_text(encoding="utf-8"), text), encoding="utf-8")
        except ValueError as error:
            sys.exit(f"{page}: {error}")
        print(page)


if __name__ == "__main__":
    main()
