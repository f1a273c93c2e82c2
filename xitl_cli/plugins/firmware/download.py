"""Firmware from the server into the cache: into a temporary file, verified, then moved into place."""

from __future__ import annotations

import http.client
import platform
import socket
import ssl
import tempfile
from collections.abc import Callable
from contextlib import closing
from email.message import Message
from pathlib import Path
from typing import IO, Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from agent import __version__
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.firmware import cache
from xitl_cli.firmware.cache import CachedFirmware, FirmwareRecord, sha256
from xitl_cli.firmware.verify import DamagedError, check_pin, verify
from xitl_cli.plugins.firmware import server
from xitl_cli.plugins.firmware.server import FirmwareFolder, PublishedVersion

TIMEOUT_S = 30.0
CHUNK_BYTES = 1 << 16
PAGE_BYTES = 4_000_000
MAX_FIRMWARE_BYTES = 500_000_000
_NOT_FOUND = 404
_CHECKSUM_SUFFIX = ".sha256"
_BROKEN = (http.client.HTTPException, OSError)

Progress = Callable[[int, int | None], None]
"""Called with the number of received bytes, and the total if it is known."""


class UnreachableError(UserError):
    """The server did not answer, or the connection broke."""


class RefusedError(UserError):
    """The server answered with an error; `status` is its HTTP status."""

    def __init__(self, text: str, status: int) -> None:
        super().__init__(text)
        self.status = status


@dataclass(frozen=True, slots=True)
class FetchedFirmware:
    """The requested firmware, now in the cache."""

    cached: CachedFirmware
    fresh: bool
    """True if it was downloaded."""
    note: str = ""
    """Remark for the user."""


def default_board() -> str:
    """Return the simulator build that this machine can run."""
    return cache.SITL_ARMHF if platform.machine().startswith(("arm", "aarch64")) else cache.SITL


def fetch_firmware(
    vehicle: str,
    version: str = "stable",
    board: str | None = None,
    base: str = server.BASE,
    force: bool = False,
    progress: Progress = lambda done, total: None,
    pinned: str = "",
) -> FetchedFirmware:
    """Ensure that a firmware is in the cache.

    pinned: the SHA-256 that the file must have, in hexadecimal digits. Without it, a numbered release that is
    downloaded again must be identical to the first download.

    A numbered release in the cache is not downloaded again. `stable`, `beta` and `latest` are downloaded only if the
    server's commit differs from that of the copy in the cache. `force` downloads in any case. Raises UserError; an
    earlier copy in the cache then stays unchanged.
    """
    board = board or default_board()
    try:
        folder = server.find_folder(base, vehicle, version, board, read_text)
        cached = cache.find_cached(vehicle, folder.version, board)
        if cached is not None and not force and folder.version not in server.MOVING_VERSIONS:
            return _cached(cached, pinned)
        published = server.published_version(folder, read_text)
        if cached is not None and not force and cached.record.git and cached.record.git == published.git:
            return _cached(cached, pinned)
        if cached is not None and not pinned and folder.version not in server.MOVING_VERSIONS:
            pinned = cached.record.sha256
        target = cache.cache_folder(vehicle, folder.version, board)
        for name in cache.file_names(vehicle, board):
            try:
                return _download_file(folder, published, target / name, progress, pinned)
            except RefusedError as error:
                if error.status != _NOT_FOUND:
                    raise
        raise server.not_found(folder, read_text)
    except UnreachableError as error:
        known = version in server.MOVING_VERSIONS and vehicle in cache.PROGRAMS and not force
        cached = cache.find_cached(vehicle, version, board) if known else None
        if cached is not None:
            return _cached(cached, pinned, note=f"the copy in the cache is used: {error}")
        raise UnreachableError(f"{error}; {_manual_way(vehicle, version, board, base)}") from None


def _cached(cached: CachedFirmware, pinned: str, note: str = "") -> FetchedFirmware:
    """Return the copy in the cache. Raises UserError if it is not the pinned file."""
    try:
        check_pin(cached.file, pinned)
    except DamagedError as error:
        raise UserError(f"{cached.file}: {error}; download it again with --overwrite") from None
    return FetchedFirmware(cached, fresh=False, note=note)


def read_text(url: str) -> str | None:
    """Return the text at a URL, None if the server has none. Raises UnreachableError, RefusedError for other errors."""
    try:
        with closing(_open(url)) as answer:
            data: bytes = answer.read(PAGE_BYTES)
            return data.decode("utf-8", "replace")
    except RefusedError as error:
        if error.status == _NOT_FOUND:
            return None
        raise
    except _BROKEN as error:
        raise UnreachableError(f"{url}: the connection broke ({_reason(error)}); try again") from None


def _download_file(
    folder: FirmwareFolder, published: PublishedVersion, target: Path, progress: Progress, pinned: str
) -> FetchedFirmware:
    url = folder.url + target.name
    checksum = read_text(url + _CHECKSUM_SUFFIX)
    image = target.suffix == cache.IMAGE_SUFFIX
    root = cache.firmware_root()
    try:
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".download-", dir=root) as temporary:
            file = Path(temporary) / target.name
            size = _receive(url, file, progress)
            try:
                verified = (*verify(file, image, folder.board, published.git, checksum), *check_pin(file, pinned))
            except DamagedError as error:
                raise UserError(f"{url}: {error}; try again, or another version") from None
            if not image:
                file.chmod(0o755)
            record = FirmwareRecord(url, sha256(file), size, published.version, published.git, verified)
            (file.parent / cache.RECORD).write_text(cache.record_text(record), encoding="utf-8")
            target.parent.mkdir(parents=True, exist_ok=True)
            file.replace(target)
            (file.parent / cache.RECORD).replace(target.parent / cache.RECORD)
    except OSError as error:
        where = error.filename or target
        raise UserError(
            f"{where}: cannot be written ({error.strerror}); free space, or choose another folder with XITL_CACHE"
        ) from None
    missing = published.git and f"commit {published.git[:8]}" not in verified
    note = f"commit {published.git[:8]} does not occur in the file" if missing else ""
    return FetchedFirmware(CachedFirmware(folder.vehicle, folder.version, folder.board, target, record), True, note)


def _receive(url: str, file: Path, progress: Progress) -> int:
    """Return the number of bytes. Raises UnreachableError for an incomplete file, UserError for invalid firmware."""
    with closing(_open(url)) as answer, file.open("wb") as out:
        announced = answer.headers.get("Content-Length", "")
        total = int(announced) if announced.isascii() and announced.isdigit() and len(announced) < 18 else None
        if total is not None and total > MAX_FIRMWARE_BYTES:
            raise UserError(f"{url}: has {total} bytes, which is too large for firmware; check the address")
        size = 0
        progress(size, total)
        while True:
            try:
                chunk = answer.read(CHUNK_BYTES)
            except _BROKEN as error:
                raise UnreachableError(
                    f"{url}: the connection broke after {size} bytes ({_reason(error)}); try again"
                ) from None
            if not chunk:
                break
            out.write(chunk)
            size += len(chunk)
            progress(size, total)
            if size > MAX_FIRMWARE_BYTES:
                raise UserError(
                    f"{url}: exceeds {MAX_FIRMWARE_BYTES} bytes, which is too large for firmware; check the address"
                )
    if total is not None and size != total:
        raise UnreachableError(f"{url}: the connection broke after {size} of {total} bytes; try again")
    return size


def _open(url: str) -> Any:
    """Open a URL. Raises UserError for an invalid address, RefusedError for an error status, UnreachableError for no
    answer.
    """
    if urlsplit(url).scheme not in ("http", "https"):
        raise UserError(f"{url}: is not a web address; write it like https://firmware.ardupilot.org")
    request = Request(url, headers={"User-Agent": f"xitl/{__version__}", "Accept-Encoding": "identity"})
    try:
        return build_opener(NoDowngrade()).open(request, timeout=TIMEOUT_S)
    except HTTPError as error:
        error.close()
        raise RefusedError(
            f"{url}: the server answers {error.code} {error.reason}; check the address", error.code
        ) from None
    except (URLError, ValueError, *_BROKEN) as error:
        raise UnreachableError(
            f"{url}: cannot be reached ({_reason(error)}); check the network and the address"
        ) from None


class NoDowngrade(HTTPRedirectHandler):
    """Follows redirections, but not from https to another scheme."""

    def redirect_request(
        self, req: Request, fp: IO[bytes], code: int, msg: str, headers: Message, newurl: str
    ) -> Request | None:
        """Redirect like the base class, or raise URLError."""
        if urlsplit(req.full_url).scheme == "https" and urlsplit(newurl).scheme != "https":
            raise URLError(f"it redirects from https to {newurl}")
        return super().redirect_request(req, fp, code, msg, headers, newurl)  # type: ignore[arg-type]


def _reason(error: BaseException) -> str:
    inner = error.reason if isinstance(error, URLError) else error
    if isinstance(inner, ssl.SSLCertVerificationError):
        return f"its certificate is not trusted here: {inner.verify_message}"
    if isinstance(inner, socket.gaierror):
        return "its name has no address; check the network"
    if isinstance(inner, TimeoutError):
        return "no answer in time"
    if isinstance(inner, OSError) and inner.strerror:
        return inner.strerror
    return str(inner) or type(inner).__name__


def _manual_way(vehicle: str, version: str, board: str, base: str) -> str:
    if vehicle not in cache.PROGRAMS:
        return "check the vehicle"
    name = cache.file_names(vehicle, board)[0]
    known = version in server.MOVING_VERSIONS or server.is_release(version)
    url = FirmwareFolder(base.rstrip("/"), vehicle, version, board).url + name if known else base
    target = cache.cache_folder(vehicle, version, board) / name
    return (
        f"or copy {url} by hand from a machine with a network to {target} "
        "and make it executable, or set its path with --firmware"
    )
