"""Bring a firmware into the cache: find it on the server, download it, look at it, note where it is from."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from pathlib import Path

from xitl_cli.errors import UserError
from xitl_cli.firmware import cache, server, web
from xitl_cli.firmware.cache import Kept, Record
from xitl_cli.firmware.download import PAUSE_S, Downloaded, Progress, download
from xitl_cli.firmware.verify import DamagedError, sha256, verify

_CHECKSUM_SUFFIX = ".sha256"


@dataclass(frozen=True, slots=True)
class Got:
    """What was asked for and is there now. fresh: it was downloaded. resumed: bytes that were here before.

    note: what the user should know besides, or empty.
    """

    kept: Kept
    fresh: bool
    resumed: int = 0
    note: str = ""


def default_board() -> str:
    """The simulator that this machine can run."""
    return cache.SITL_ARMHF if platform.machine().startswith(("arm", "aarch64")) else cache.SITL


def get(
    vehicle: str,
    version: str = "stable",
    board: str | None = None,
    base: str = server.BASE,
    force: bool = False,
    progress: Progress = lambda done, total: None,
    pause_s: float = PAUSE_S,
) -> Got:
    """Have a firmware in the cache. A numbered release that is there is not asked for again, unless `force`.

    Of `stable`, `beta` and `latest` the server is asked whether there is a newer one. Raises UserError.
    """
    board = board or default_board()
    try:
        at = server.place(base, vehicle, version, board)
        here = _here(at)
        if here is not None and at.version not in server.MOVING and not force:
            return Got(here, fresh=False)
        return _get(at, None if force else here, force, progress, pause_s)
    except web.UnreachableError as error:
        old = (
            None
            if force or version not in server.MOVING or vehicle not in cache.PROGRAMS
            else _at(vehicle, version, board)
        )
        if old is not None:
            return Got(old, fresh=False, note=f"what is here was kept, for the server was not asked: {error}")
        raise web.UnreachableError(f"{error}; {_by_hand(vehicle, version, board, base)}") from None


def _get(at: server.Place, here: Kept | None, force: bool, progress: Progress, pause_s: float) -> Got:
    about = server.about(at)
    to = cache.folder(at.vehicle, at.version, at.board)
    for name in cache.names(at.vehicle, at.board):
        etag = (
            here.record.etag if here is not None and here.file.name == name and here.record.url == at.url + name else ""
        )
        try:
            return _get_file(at, about, to / name, etag, force, progress, pause_s)
        except web.RefusedError as error:
            if error.status != web.NOT_FOUND:
                raise
            _tidy(to / name)
    raise server.missing(at)


def _get_file(
    at: server.Place, about: server.About, to: Path, etag: str, force: bool, progress: Progress, pause_s: float
) -> Got:
    url = at.url + to.name
    published = web.text(url + _CHECKSUM_SUFFIX)
    checked: list[str] = []

    def accept(part: Path) -> None:
        image = to.suffix == cache.IMAGE_SUFFIX
        try:
            checked.extend(verify(part, image, at.board, about.git, published))
        except DamagedError as error:
            raise UserError(f"{url}: {error}; try again, or another version") from None
        if not image:
            part.chmod(0o755)

    done: Downloaded = download(url, to, progress, etag, accept, pause_s, anew=force)
    if done.unchanged:
        kept = _at(at.vehicle, at.version, at.board)
        assert kept is not None
        return Got(kept, fresh=False)
    record = Record(url, done.etag, sha256(to), done.size, about.version, about.git, tuple(checked))
    _write(to.parent / cache.RECORD, cache.record_text(record))
    note = "" if not about.git or f"commit {about.git[:8]}" in checked else f"commit {about.git[:8]} is not found in it"
    return Got(Kept(at.vehicle, at.version, at.board, to, record), True, done.resumed, note)


def _here(at: server.Place) -> Kept | None:
    return _at(at.vehicle, at.version, at.board)


def _at(vehicle: str, version: str, board: str) -> Kept | None:
    return next((one for one in cache.kept(vehicle) if (one.version, one.board) == (version, board)), None)


def _by_hand(vehicle: str, version: str, board: str, base: str) -> str:
    if vehicle not in cache.PROGRAMS:
        return "check the vehicle"
    name = cache.names(vehicle, board)[0]
    known = version in server.MOVING or server.is_release(version)
    url = server.Place(base.rstrip("/"), vehicle, version, board).url + name if known else base
    return (
        f"or by hand: bring {url} from a machine with a network to {cache.folder(vehicle, version, board) / name} "
        "and make it executable, or name its path with --firmware"
    )


def _tidy(to: Path) -> None:
    """Leave no empty folders for what the server does not have."""
    for suffix in (".part", ".part.json"):
        to.with_name(to.name + suffix).unlink(missing_ok=True)
    at = to.parent
    while at != cache.firmware_root() and at.is_dir() and not any(at.iterdir()):
        at.rmdir()
        at = at.parent


def _write(path: Path, text: str) -> None:
    new = path.with_name(path.name + ".new")
    new.write_text(text, encoding="utf-8")
    new.replace(path)
