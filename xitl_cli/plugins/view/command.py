"""`xitl view`."""

from __future__ import annotations

import os
import re
import signal
import threading
from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from xitl_cli.commands.options import Vessel, renamed
from xitl_cli.commands.output import tell_damage
from xitl_cli.end_signals import end_signals_handled
from xitl_cli.errors import UserError
from xitl_cli.logs.model.text import duration_text, printable

if TYPE_CHECKING:
    from xitl_cli.plugins.view.recording import LogScene

CameraView = StrEnum("CameraView", {"BEHIND": "behind", "BESIDE": "beside", "ABOVE": "above", "ALL": "all"})
_PNG, _GIF, _WEBP, _PAGE = b"\x89PNG", b"GIF8", b"RIFF", b"<!doctype"


def view(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG", help="run.mcap, .bin, .tlog or other MCAP files, or runs' folders."),
    ],
    vessel: Vessel = None,
    at: Annotated[
        str | None, typer.Option("--at", metavar="TIME", help="Start paused at this time; also the instant of --png.")
    ] = None,
    from_time: Annotated[
        str | None, typer.Option("--from", metavar="TIME", help="Start of --html and --gif: 90, 1:30.5 or 1:02:03.")
    ] = None,
    until_time: Annotated[str | None, typer.Option("--until", metavar="TIME", help="End of --html and --gif.")] = None,
    to_time: Annotated[str | None, typer.Option("--to", hidden=True)] = None,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the replay as one HTML page that opens from the disk.")
    ] = None,
    png: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a picture of the instant --at.")] = None,
    gif: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write an animated picture of the span: .gif or .webp.")
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Size in pixels; by default 1280x720 for --png, 640x360 for --gif."),
    ] = None,
    camera: Annotated[CameraView, typer.Option(help="Camera of a picture or page.")] = CameraView.BEHIND,
    of: Annotated[
        str | None, typer.Option("--of", metavar="NAME", help="Vessel that the camera of a picture looks at.")
    ] = None,
    speed: Annotated[float, typer.Option(metavar="TIMES", help="Speed of --gif as a multiple of real time.")] = 4.0,
    chart: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="FILE",
            help="Draw this on the water: GeoJSON, MBTiles, or a folder of tiles {z}/{x}/{y}.png.",
        ),
    ] = None,
    dark: Annotated[bool, typer.Option("--dark", help="Use night colours.")] = False,
    host: Annotated[str, typer.Option("--view-host", metavar="HOST", help="Address to listen at.")] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(
            "--view-port", "--port", metavar="PORT", min=1, max=65535, help="Port to listen at; by default a free one."
        ),
    ] = None,
    open_page: Annotated[bool, typer.Option("--open/--no-open", help="Open a browser if there is a desktop.")] = True,
) -> None:
    """Play recordings of runs and vehicles in 3D, or write them as a page or pictures."""
    from xitl_cli.logs.formats.run_directory import recording_in
    from xitl_cli.logs.model.text import parse_optional_seconds
    from xitl_cli.plugins.view import pictures
    from xitl_cli.plugins.view.recording import open_scene
    from xitl_cli.plugins.view.replay_page import checked_span, replay_html
    from xitl_cli.plugins.view.server import check_view_extra

    check_view_extra()
    at_s, from_s, to_s = (
        parse_optional_seconds(text) for text in (at, from_time, renamed(to_time, until_time, "--to", "--until"))
    )
    pixels = _size(size)
    if not 0.0 < speed < float("inf"):
        raise UserError(f"--speed {speed:g}: is not a speed; give a number above 0, such as 4")
    film_kind: Literal["gif", "webp"] = "webp" if gif is not None and gif.suffix.lower() == ".webp" else "gif"
    for path, beginning in ((html, _PAGE), (png, _PNG), (gif, _WEBP if film_kind == "webp" else _GIF)):
        if path is not None:
            _refuse_other(path, beginning)
    with open_scene([recording_in(path) for path in logs], vessel, chart) as recording:
        for note in recording.scene.notes:
            typer.echo(printable(f"note: {note}"), err=True)
        tell_damage(*recording.logs)
        if html is None and png is None and gif is None:
            _serve(recording, host, port, at_s, dark, open_page)
            return
        span = checked_span(recording, from_s, to_s)
        if html is not None:
            page = replay_html(recording, from_s=from_s, to_s=to_s, view=camera.value, at_s=at_s, dark=dark)
            _write_whole(html, page.encode())
            length = duration_text(span.length_s)
            typer.echo(f"{printable(str(html))}: {_megabytes(html)}, {length}; opens in any browser")
        if png is not None:
            instant_s = (span.from_s + span.to_s) / 2.0 if at_s is None else at_s
            size_px = pixels or (1280, 720)
            shot = pictures.picture(recording, instant_s, size=size_px, camera=camera.value, vessel=of, dark=dark)
            _write_whole(png, shot)
            typer.echo(f"{printable(str(png))}: {_megabytes(png)}, at {instant_s:.2f} s")
        if gif is not None:
            size_px = pixels or (640, 360)
            look: dict[str, Any] = {"camera": camera.value, "vessel": of, "dark": dark}
            film = pictures.moving_picture(recording, from_s, to_s, size=size_px, speed=speed, kind=film_kind, **look)
            _write_whole(gif, film)
            typer.echo(f"{printable(str(gif))}: {_megabytes(gif)}, {duration_text(span.length_s)} at {speed:g} ×")


def _serve(recording: LogScene, host: str, port: int | None, at_s: float | None, dark: bool, open_page: bool) -> None:
    from xitl_cli.plugins.view.server import has_desktop, listen, open_browser
    from xitl_cli.plugins.view.timeline import RecordingPage

    listener, address = listen(host, port, "--view-host", "--view-port")
    ended = threading.Event()
    with end_signals_handled(lambda number, frame: ended.set(), signal.SIGINT):
        page = RecordingPage(recording, listener, address, at_s=at_s, dark=dark)
        typer.echo(f"{recording.scene.title}: {address.url} (end with Ctrl+C)")
        if open_page and has_desktop():
            open_browser(address.url)

        def analyse() -> None:
            with suppress(Exception):  # a failed or interrupted analysis does not end the page
                page.find()

        threading.Thread(target=analyse, daemon=True).start()
        try:
            page.serve(ended)
        finally:
            page.close()


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    match = re.fullmatch(r"(\d{1,5})[x×](\d{1,5})", text.strip().lower())
    if match is None:
        raise UserError(f"--size {text}: is not a size; write it like 1280x720")
    return int(match[1]), int(match[2])


def _refuse_other(path: Path, beginning: bytes) -> None:
    """Refuse to overwrite a file of another kind, such as a log that was named by mistake."""
    try:
        if path.is_dir():
            raise UserError(f"{path}: is a directory; name a file in it")
        if path.exists():
            with path.open("rb") as file:
                head = file.read(len(beginning)).lower()
            if head not in (b"", beginning.lower()):
                raise UserError(f"{path}: already exists and is another kind of file; choose another name")
        elif not path.absolute().parent.is_dir():
            raise UserError(f"{path}: its folder does not exist; create it, or choose another place")
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}); choose another place") from error


def _write_whole(path: Path, content: bytes) -> None:
    """Write a file completely or not at all."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(content)
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        raise UserError(f"{path}: cannot be written ({error.strerror}); free space or choose another place") from error


def _megabytes(path: Path) -> str:
    size = path.stat().st_size
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.0f} kB"
