"""`xitl logs info|dump|export|tasks`."""

from __future__ import annotations

import json
import os
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.commands.options import From, Json, Overwrite, Raw, SigningKey, Until, VehicleAddress, Vessel
from xitl_cli.commands.output import quiet_pipe, refuse, tell_damage
from xitl_cli.errors import UserError
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.text import printable

if TYPE_CHECKING:
    from xitl_cli.logs.export.exporting import ExportResult
    from xitl_cli.params.vehicle import VehicleFiles

_ASK_AGAIN_S = 2.0
_TRIES = 9

FileArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help="A DataFlash .bin, a .tlog, an .mcap, or the directory of a run.")
]


def info(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="DataFlash .bin, .tlog, .mcap, bag of ROS, or a run's directory."),
    ],
    fields: Annotated[bool, typer.Option("--fields", help="All fields of each message, with their units.")] = False,
    vessel: Vessel = None,
    as_json: Json = False,
) -> None:
    """Show what logs contain: time, vehicle, damage, messages.

    Exit code 2 when one of them cannot be read; the others are shown.
    """
    from xitl_cli.logs import open_log
    from xitl_cli.logs.formats.run_directory import logs_in
    from xitl_cli.logs.summary import summarize_log
    from xitl_cli.plugins.logs.info_command import summary_lines

    summaries, refusals = [], []
    with quiet_pipe():
        for path in dict.fromkeys(log for file in files for log in logs_in(file, vessel or "")):
            try:
                with open_log(path, vessel) as log:
                    summary = summarize_log(log, every_field=fields)
            except LogError as error:
                refusals.append(str(error))
                continue
            if as_json:
                summaries.append(summary.as_json())
                continue
            if summaries:
                print()
            summaries.append({})
            for line in summary_lines(summary, every_field=fields):
                print(line)
        if as_json:
            print(json.dumps({"logs": summaries, "refused": refusals}, allow_nan=False, ensure_ascii=False))
    refuse(refusals)


def dump(
    file: FileArgument,
    messages: Annotated[
        list[str],
        typer.Argument(metavar="MESSAGE...", help="Names of messages or topics, separated by spaces or commas."),
    ],
    fields: Annotated[str, typer.Option(metavar="A,B", help="Only these fields, in this order.")] = "",
    where: Annotated[
        str, typer.Option(metavar="CONDITION", help="Only rows that meet this condition: 'Roll > 5 and I == 0'.")
    ] = "",
    from_time: From = None,
    until_time: Until = None,
    raw: Raw = False,
    limit: Annotated[int | None, typer.Option(min=0, metavar="N", help="At most this many rows.")] = None,
    vessel: Vessel = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object a row.")] = False,
) -> None:
    """Print rows of messages in the order of the file, their time in seconds first.

    A condition has names of fields and time_s, numbers, 'texts', comparisons, and, or, not, + - * / % **, [0] for an
    element of an array, and functions such as abs, hypot, wrap180, derivative and smooth. A signal of another message,
    such as XKF1[0].VN, has its value at the time of the row.
    """
    from xitl_cli.logs import open_log
    from xitl_cli.logs.model.query import RowCondition, stamps_between, tables_named
    from xitl_cli.logs.model.text import parse_optional_seconds
    from xitl_cli.plugins.logs.dump_command import Asked, row_lines

    condition = RowCondition(where) if where.strip() else None
    written = False
    with open_log(file, vessel) as log, quiet_pipe():
        named = tables_named(log, messages)
        tables = named.tables
        for name in named.rowless:
            typer.echo(f"{log.path}: has no row of {name}", err=True)
        if not tables:
            return
        condition = condition.within(log) if condition is not None else None
        names = tuple(name.strip() for name in fields.split(",") if name.strip())
        span_ns = stamps_between(log, parse_optional_seconds(from_time), parse_optional_seconds(until_time))
        for name, lacked in (condition.lacked(tables) if condition is not None else {}).items():
            typer.echo(f"{name} has no {', '.join(lacked)}: comparisons with it are false there", err=True)
        for text in row_lines(log, tables, Asked(names, condition, span_ns, raw, limit, as_json, _width())):
            sys.stdout.write(text)
            written = True
        for note in condition.notes if condition is not None else ():
            typer.echo(printable(note), err=True)
        tell_damage(log)
    if not written:
        typer.echo(f"{file}: no row of {', '.join(table.name for table in tables)} matches", err=True)


def export(
    file: FileArgument,
    messages: Annotated[
        list[str] | None, typer.Argument(metavar="[MESSAGE...]", help="Names of messages or topics; all without any.")
    ] = None,
    file_format: Annotated[
        str,
        typer.Option(
            "--format",
            help="csv, parquet, mcap, rosbag2-mcap, rosbag2-sqlite3, rosbag1, coco, yolo or a format of a package.",
        ),
    ] = "csv",
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="PATH", help="Directory of the files; for mcap and bags the file or bag itself."),
    ] = None,
    from_time: From = None,
    until_time: Until = None,
    raw: Raw = False,
    overwrite: Overwrite = False,
    vessel: Vessel = None,
    as_json: Json = False,
) -> None:
    """Write messages to CSV (a file each), Parquet (a file each), one MCAP with a ROS 2 topic each, or a bag of ROS.

    PlotJuggler reads all of them. Foxglove and Lichtblick read MCAP and bags. The bag of a recording has the topics and
    ROS types of the live run. The bag of another log has its positions, attitudes and inertial data with ROS types, and
    a topic for each message. For a bag, MESSAGE may also be a ROS topic, such as imu/data.
    """
    from xitl_cli.logs import open_log
    from xitl_cli.logs.export.exporting import FORMATS, ExportSelection, export_log
    from xitl_cli.logs.model.query import stamps_between, tables_named
    from xitl_cli.logs.model.text import parse_optional_seconds
    from xitl_cli.registry import LOG_EXPORTS, names

    if file_format not in FORMATS and file_format in names(LOG_EXPORTS):
        _export_added(file, messages or [], file_format, out, (from_time, until_time), raw, overwrite, vessel, as_json)
        return
    with open_log(file, vessel) as log:
        named = tables_named(log, messages or list(log.tables))
        if not named.tables:
            raise LogError(
                f"{file}: has no row of {', '.join(named.rowless)}; `xitl logs info` lists the messages with rows"
            )
        from_ns, until_ns = stamps_between(log, parse_optional_seconds(from_time), parse_optional_seconds(until_time))
        done = export_log(log, ExportSelection(named.tables, from_ns, until_ns, raw), file_format, out, overwrite)
        tell_damage(log)
    for name in named.rowless:
        typer.echo(f"{file}: has no row of {name}", err=True)
    _tell_export(done, as_json)


def _export_added(
    file: Path,
    names: list[str],
    file_format: str,
    out: Path | None,
    between: tuple[str | None, str | None],
    raw: bool,
    overwrite: bool,
    vessel: str | None,
    as_json: bool,
) -> None:
    from xitl_cli.logs import open_log
    from xitl_cli.logs.export.exporting import ExportSelection
    from xitl_cli.logs.model.query import stamps_between
    from xitl_cli.logs.model.text import parse_optional_seconds
    from xitl_cli.registry import LOG_EXPORTS, guarded, load

    write = load(LOG_EXPORTS, file_format)

    with open_log(file, vessel) as log:
        named = {name.strip("/") for name in names}
        tables = tuple(table for table in log.tables.values() if not names or table.name.strip("/") in named)
        from_ns, until_ns = stamps_between(log, *(parse_optional_seconds(text) for text in between))
        selection = ExportSelection(tables, from_ns, until_ns, raw)
        done = guarded(LOG_EXPORTS, file_format, write, log, selection, names, file_format, out, overwrite)
        tell_damage(log)
    _tell_export(done, as_json)


def _tell_export(done: ExportResult, as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(done.as_json(), ensure_ascii=False))
        return
    for note in done.notes:
        typer.echo(note, err=True)
    typer.echo(done.sentence)


def repair(
    file: Annotated[
        Path, typer.Argument(metavar="MCAP", help="A recording that is damaged or was never closed, or its directory.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="Output file (default: <name>-repaired.mcap next to it)."),
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write a complete copy of a damaged recording: all readable data, with the indexes for seeking.

    Use it for a recording of a run that was killed. Sound chunks, attachments and metadata are copied; lost data is
    counted. A complete file stays unchanged.
    """
    from xitl_cli.logs import open_log
    from xitl_cli.logs.export.repair import repair_log
    from xitl_cli.logs.report.wording import loss_sentences

    with open_log(file) as log:
        done = repair_log(log, out, overwrite)
    if as_json:
        typer.echo(json.dumps(done.as_json(), ensure_ascii=False))
        return
    typer.echo(printable(done.sentence))
    for sentence in () if done.out is None else loss_sentences(done.health):
        typer.echo(f"  {printable(sentence)}")


def tasks(
    vehicle: VehicleAddress,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Also save the file unchanged.")] = None,
    overwrite: Overwrite = False,
    signing_key: SigningKey = None,
    as_json: Json = False,
) -> None:
    """Show the execution time of each task of ArduPilot's scheduler, from @SYS/tasks.txt of the vehicle.

    This sets bit 0 of SCHED_OPTIONS, so that the vehicle counts until it restarts.
    """
    from xitl_cli.logs.export.files import part_of, refuse_present
    from xitl_cli.logs.model.system_files import parse_tasks, tasks_counted
    from xitl_cli.params.values import is_vehicle
    from xitl_cli.signing import read_key_file

    if not is_vehicle(vehicle):
        raise UserError(
            f"{vehicle!r} is not the address of a vehicle; write tcp://host:port, udp://host:port or serial:///dev/ttyACM0"
        )
    if out is not None:
        refuse_present([out], overwrite)
    text = fetch_tasks(vehicle, None if signing_key is None else read_key_file(str(signing_key)))
    if out is not None:
        with part_of(out, overwrite) as part:
            part.write_text(text, encoding="utf-8")
    task_times = parse_tasks(text)
    counted = tasks_counted(task_times)
    if as_json:
        rows = [asdict(task) for task in task_times]
        typer.echo(json.dumps({"vehicle": vehicle, "counted": counted, "tasks": rows}, ensure_ascii=False))
        return
    width = max(len("task"), *(len(task.name) for task in task_times))
    typer.echo(f"{'task':<{width}} {'fast':>4} {'min us':>7} {'mean us':>7} {'max us':>7} {'overruns':>8} {'share':>7}")
    for task in task_times:
        typer.echo(
            f"{task.name:<{width}} {'yes' if task.fast else '':>4} {task.least_us:>7} {task.mean_us:>7} "
            f"{task.most_us:>7} {task.overruns:>8} {task.share_percent:>6.2f}%"
        )
    if not counted:
        typer.echo("no time was measured, because the clock of a simulator stops while a task runs", err=True)


def fetch_tasks(url: str, signing_key: bytes | None = None) -> str:
    """Return @SYS/tasks.txt of the vehicle at `url`. It starts the vehicle's task counter if necessary, which takes up
    to 12 s.

    Like each request for the file, it sets bit 0 of SCHED_OPTIONS on the vehicle until it restarts. Raises UserError if
    the vehicle does not answer, has no such file, or does not count.
    """
    from xitl_cli.params.vehicle import VehicleFiles, connect

    with connect(url, signing_key) as vehicle:
        return read_tasks(VehicleFiles(vehicle), url)


def read_tasks(files: VehicleFiles, url: str, again_s: float = _ASK_AGAIN_S) -> str:
    """Return the file once it lists tasks, which begins with the vehicle's next PM record, up to 10 s later."""
    from agent.mavlink.ftp import FtpRefusedError, read_file
    from xitl_cli.logs.model.system_files import TASKS_MOST_BYTES, TASKS_PATH, parse_tasks

    for attempt in range(_TRIES):
        if attempt:
            time.sleep(again_s)
        try:
            text = files.run(read_file(TASKS_PATH, TASKS_MOST_BYTES)).decode("utf-8", "replace")
        except FtpRefusedError as refusal:
            raise UserError(
                f"{url}: {TASKS_PATH} cannot be read: {refusal}; it needs ArduPilot 4.1 or newer"
            ) from refusal
        if parse_tasks(text):
            return text
    raise UserError(f"{url}: {TASKS_PATH} lists no tasks; set SCHED_OPTIONS to 1 and try again after 10 s")


def _width() -> int | None:
    """Return the columns of the terminal; None for other outputs, which are not folded."""
    if not sys.stdout.isatty():
        return None
    try:
        return os.get_terminal_size(sys.stdout.fileno()).columns
    except (OSError, ValueError):
        return 80
