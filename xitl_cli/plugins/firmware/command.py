"""`xitl firmware get|list|path`."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

from xitl_cli.commands.options import Json
from xitl_cli.commands.terminal import show_rows, terminal
from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from xitl_cli.firmware.cache import CachedFirmware

VehicleArgument = Annotated[str, typer.Argument(metavar="VEHICLE", help="rover (boats too), plane, copter or sub.")]
Version = Annotated[str, typer.Option(help="stable, beta, latest, or numbers: 4.6.3, or 4.6 for the newest of them.")]
Board = Annotated[
    str | None,
    typer.Option(help="sitl, sitl-armhf, or a board's folder on the server (default: the sitl of this machine)."),
]
Url = Annotated[str | None, typer.Option("--url", metavar="BASE", help="A mirror of https://firmware.ardupilot.org.")]


def get(
    vehicle: VehicleArgument,
    version: Version = "stable",
    board: Board = None,
    url: Url = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Download it again, from the start, over what is there.")
    ] = False,
    pinned: Annotated[
        str,
        typer.Option("--sha256", metavar="HEX", help="Refuse any other file than the one with this SHA-256."),
    ] = "",
    as_json: Json = False,
) -> None:
    """Download ArduPilot firmware from the project's public server into the cache, where `xitl sim` finds it."""
    from xitl_cli.plugins.firmware.download import fetch_firmware
    from xitl_cli.plugins.firmware.server import BASE

    console = terminal(stderr=as_json, soft_wrap=True)
    shown = console.is_terminal and not as_json
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    bar = Progress(*columns, TimeRemainingColumn(), console=console, transient=True)
    task = bar.add_task(f"{vehicle} {version}", total=None)

    def progress(done: int, total: int | None) -> None:
        if shown:
            bar.start()
            bar.update(task, completed=done, total=total)

    try:
        fetched = fetch_firmware(vehicle, version, board, url or BASE, overwrite, progress, _digest(pinned))
    finally:
        if shown:
            bar.stop()
    if as_json:
        _print_json({**_row(fetched.cached), "fresh": fetched.fresh, "note": fetched.note})
        return
    cached = fetched.cached
    record = cached.record
    what = f"{vehicle} {record.version or cached.version} for {cached.board}"
    how = "downloaded" if fetched.fresh else "is here already"
    console.print(f"{what}: {how}", markup=False)
    console.print(f"  {cached.file}", markup=False)
    if record.verified:
        console.print(f"  checked: {', '.join(record.verified)}", markup=False)
    if fetched.note:
        console.print(f"  note: {fetched.note}", markup=False)


def list_firmware(
    available: Annotated[
        str | None, typer.Option("--available", metavar="VEHICLE", help="Ask the server which releases there are.")
    ] = None,
    url: Url = None,
    as_json: Json = False,
) -> None:
    """List the firmware in the cache, or the releases of the server."""
    from xitl_cli.firmware.cache import PROGRAMS, firmware_root, list_cached
    from xitl_cli.plugins.firmware.download import read_text
    from xitl_cli.plugins.firmware.server import BASE, MOVING_VERSIONS, list_releases

    console = terminal(soft_wrap=True)
    if available is not None:
        if available not in PROGRAMS:
            raise UserError(f"{available}: no firmware is known for it; use one of {', '.join(PROGRAMS)}")
        found = list_releases(url or BASE, available, read_text)
        if as_json:
            _print_json({"vehicle": available, "releases": [*MOVING_VERSIONS, *found]})
        else:
            console.print("  ".join([*MOVING_VERSIONS, *found]), markup=False)
        return
    all_cached = list_cached()
    if as_json:
        _print_json({"folder": str(firmware_root()), "firmware": [_row(one) for one in all_cached]})
        return
    if not all_cached:
        console.print(f"{firmware_root()}: no firmware yet; bring some with `xitl firmware get rover`", markup=False)
        return
    rows = []
    for one in all_cached:
        record = one.record
        size = str(record.size or one.file.stat().st_size)
        version = record.version or "put there by hand"
        rows.append([one.vehicle, one.version, one.board, version, size, record.git[:8]])
    show_rows(console, ("vehicle", "version", "board", "is", "bytes", "commit"), rows, text=(0, 1, 2, 3, 5))


def path(
    vehicle: VehicleArgument = "rover",
    version: Annotated[str | None, typer.Option(help="Only this version.")] = None,
    board: Annotated[str | None, typer.Option(help="Only for this board.")] = None,
) -> None:
    """Print the path of a firmware in the cache, the one that `xitl sim` would take unless more is said."""
    from xitl_cli.firmware.cache import find_program, firmware_root, list_cached

    if version is None and board is None:
        chosen = find_program(vehicle, "sitl")
    else:
        fitting = (one for one in list_cached(vehicle) if version in (None, one.version) and board in (None, one.board))
        chosen = next((one.file for one in fitting), None)
    if chosen is None:
        raise UserError(
            f"{firmware_root()}: holds no such firmware of {vehicle}; bring it with `xitl firmware get {vehicle}`"
        )
    typer.echo(chosen)


def _row(one: CachedFirmware) -> dict[str, Any]:
    row: dict[str, Any] = {
        "vehicle": one.vehicle,
        "asked_version": one.version,
        "board": one.board,
        "file": str(one.file),
    }
    return {**row, **asdict(one.record)}


def _print_json(row: dict[str, Any]) -> None:
    typer.echo(json.dumps(row, indent=2, ensure_ascii=False))


def _digest(text: str) -> str:
    if text and not re.fullmatch(r"[0-9a-fA-F]{64}", text):
        raise UserError(f"--sha256 {text}: is no SHA-256; give its 64 hexadecimal digits")
    return text
