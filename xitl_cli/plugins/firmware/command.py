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
Version = Annotated[str, typer.Option(help="stable, beta, latest, or a number: 4.6.3, or 4.6 for its newest release.")]
Board = Annotated[
    str | None,
    typer.Option(help="sitl, sitl-armhf, or a board's folder on the server (default: the sitl of this machine)."),
]
Url = Annotated[str | None, typer.Option("--url", metavar="BASE", help="Mirror of https://firmware.ardupilot.org.")]


def get(
    vehicle: VehicleArgument,
    version: Version = "stable",
    board: Board = None,
    url: Url = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Download the file again and replace the existing one.")
    ] = False,
    pinned: Annotated[
        str,
        typer.Option("--sha256", metavar="HEX", help="Accept only the file with this SHA-256."),
    ] = "",
    as_json: Json = False,
) -> None:
    """Download ArduPilot firmware from the project's public server into the cache, where `xitl sim` finds it."""
    from xitl_cli.plugins.firmware.download import fetch_firmware
    from xitl_cli.plugins.firmware.server import BASE

    if pinned and not re.fullmatch(r"[0-9a-fA-F]{64}", pinned):
        raise UserError(f"--sha256 {pinned}: is not a SHA-256; write its 64 hexadecimal digits")
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
        fetched = fetch_firmware(vehicle, version, board, url or BASE, overwrite, progress, pinned)
    finally:
        if shown:
            bar.stop()
    if as_json:
        _print_json({**_row(fetched.cached), "fresh": fetched.fresh, "note": fetched.note})
        return
    cached = fetched.cached
    record = cached.record
    state = "downloaded" if fetched.fresh else "exists already"
    console.print(f"{vehicle} {record.version or cached.version} for {cached.board}: {state}", markup=False)
    console.print(f"  {cached.file}", markup=False)
    if record.verified:
        console.print(f"  checked: {', '.join(record.verified)}", markup=False)
    if fetched.note:
        console.print(f"  note: {fetched.note}", markup=False)


def list_firmware(
    available: Annotated[
        str | None, typer.Option("--available", metavar="VEHICLE", help="List the releases of the server.")
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
            raise UserError(f"{available}: is not a vehicle with firmware; use one of {', '.join(PROGRAMS)}")
        releases = list_releases(url or BASE, available, read_text)
        if as_json:
            _print_json({"vehicle": available, "releases": [*MOVING_VERSIONS, *releases]})
        else:
            console.print("  ".join([*MOVING_VERSIONS, *releases]), markup=False)
        return
    all_cached = list_cached()
    if as_json:
        _print_json({"folder": str(firmware_root()), "firmware": [_row(cached) for cached in all_cached]})
        return
    if not all_cached:
        console.print(f"{firmware_root()}: no firmware yet; download some with `xitl firmware get rover`", markup=False)
        return
    rows = []
    for cached in all_cached:
        record = cached.record
        size = str(record.size or cached.file.stat().st_size)
        version = record.version or "copied by hand"
        rows.append([cached.vehicle, cached.version, cached.board, version, size, record.git[:8]])
    show_rows(console, ("vehicle", "version", "board", "is", "bytes", "commit"), rows, text=(0, 1, 2, 3, 5))


def path(
    vehicle: VehicleArgument = "rover",
    version: Annotated[str | None, typer.Option(help="Only this version.")] = None,
    board: Annotated[str | None, typer.Option(help="Only for this board.")] = None,
) -> None:
    """Print the path of a firmware in the cache; by default, the one that `xitl sim` would use."""
    from xitl_cli.firmware.cache import find_program, firmware_root, list_cached

    if version is None and board is None:
        chosen = find_program(vehicle, "sitl")
    else:
        matching = (
            cached.file
            for cached in list_cached(vehicle)
            if version in (None, cached.version) and board in (None, cached.board)
        )
        chosen = next(matching, None)
    if chosen is None:
        raise UserError(
            f"{firmware_root()}: has no such firmware of {vehicle}; download it with `xitl firmware get {vehicle}`"
        )
    typer.echo(chosen)


def _row(cached: CachedFirmware) -> dict[str, Any]:
    row: dict[str, Any] = {
        "vehicle": cached.vehicle,
        "asked_version": cached.version,
        "board": cached.board,
        "file": str(cached.file),
    }
    return {**row, **asdict(cached.record)}


def _print_json(row: dict[str, Any]) -> None:
    typer.echo(json.dumps(row, indent=2, ensure_ascii=False))
