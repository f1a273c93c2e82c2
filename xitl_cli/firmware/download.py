"""One file from the web to a path: whole or not at all, going on where an earlier attempt was cut off."""

from __future__ import annotations

import fcntl
import json
import os
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from xitl_cli.errors import UserError
from xitl_cli.firmware import web

CHUNK_BYTES = 1 << 16
ATTEMPTS = 5
MOST_BYTES = 500_000_000
PAUSE_S = 1.0
_LENGTH = re.compile(r"[0-9]{1,18}")
_CONTENT_RANGE = re.compile(r"bytes ([0-9]{1,18})-[0-9]{1,18}/([0-9]{1,18}|\*)")
_RANGED, _WHOLE = 206, 200

Progress = Callable[[int, int | None], None]
"""Told with how many bytes are here, and of how many where that is known."""


@dataclass(frozen=True, slots=True)
class Downloaded:
    """size: bytes of the file. etag: what the server calls this version of it, ETag or else the date, or empty.

    resumed: bytes that earlier attempts had brought. unchanged: the server still has the version that was asked about,
    and nothing was downloaded.
    """

    size: int = 0
    etag: str = ""
    resumed: int = 0
    unchanged: bool = False


@dataclass
class _Part:
    """What is here so far: `file` holds the first bytes of the version of `url` that the server calls `tag`."""

    url: str
    file: IO[bytes]
    notes: Path
    tag: str = ""
    resumed: int = 0

    def size(self) -> int:
        return self.file.seek(0, 2)

    def recall(self) -> None:
        """Keep what an earlier attempt left if it can be gone on from, else start anew."""
        try:
            noted = json.loads(self.notes.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            noted = {}
        if isinstance(noted, dict) and noted.get("url") == self.url and noted.get("tag") and self.size():
            self.tag, self.resumed = str(noted["tag"]), self.size()
        else:
            self.restart("")

    def restart(self, tag: str) -> None:
        self.file.truncate(0)
        self.tag, self.resumed = tag, 0
        self.notes.write_text(json.dumps({"url": self.url, "tag": tag}), encoding="utf-8")


def download(
    url: str,
    to: Path,
    progress: Progress = lambda done, total: None,
    known_etag: str = "",
    accept: Callable[[Path], None] = lambda part: None,
    pause_s: float = PAUSE_S,
    anew: bool = False,
) -> Downloaded:
    """Bring a URL to a path. `accept` sees the whole file before it gets its name, and may refuse it by raising.

    `anew` drops what an earlier attempt left. `known_etag` of the version that is there already makes the server say so
    instead of sending it again. A connection that breaks is tried `ATTEMPTS` times, as long as each brings something;
    what is here then stays for the next call.
    Raises UnreachableError, RefusedError, or UserError when this machine cannot keep the file; what `accept` raises
    goes through, and what was downloaded is dropped.
    """
    part_path = to.with_name(to.name + ".part")
    notes = to.with_name(to.name + ".part.json")
    try:
        to.parent.mkdir(parents=True, exist_ok=True)
        with part_path.open("ab") as file:
            _alone(file, part_path)
            part = _Part(url, file, notes)
            if anew:
                part.restart("")
            else:
                part.recall()
            got = _attempts(part, progress, known_etag, pause_s)
            if got.unchanged:
                _drop(part_path, notes)
                return got
            file.flush()
            try:
                accept(part_path)
            except BaseException:
                _drop(part_path, notes)
                raise
            part_path.replace(to)
            notes.unlink(missing_ok=True)
            return got
    except OSError as error:
        where = error.filename or to
        raise UserError(
            f"{where}: cannot be written ({error.strerror}); free or choose another place: XITL_CACHE"
        ) from None


def _attempts(part: _Part, progress: Progress, known_etag: str, pause_s: float) -> Downloaded:
    """Until the file is whole."""
    left, furthest = ATTEMPTS, part.size()
    while True:
        try:
            return _attempt(part, progress, known_etag)
        except web.CUT as error:
            left = ATTEMPTS if part.size() > furthest else left - 1
            furthest = max(furthest, part.size())
            if left <= 0:
                raise web.UnreachableError(
                    f"{part.url}: broke off after {part.size()} bytes ({web.reason(error)}); run it again, "
                    "it goes on from there"
                ) from None
            time.sleep(pause_s)


def _attempt(part: _Part, progress: Progress, known_etag: str) -> Downloaded:
    headers = {"Accept-Encoding": "identity"}
    start = part.size() if part.tag else 0
    if start:
        headers |= {"Range": f"bytes={start}-", "If-Range": part.tag}
    elif known_etag:
        headers["If-None-Match" if known_etag.endswith('"') else "If-Modified-Since"] = known_etag
    with web.ask(part.url, headers) as answer:
        if answer.status == web.NOT_MODIFIED:
            return Downloaded(etag=known_etag, unchanged=True)
        if answer.status == web.RANGE_BEYOND:
            part.restart("")
            raise ConnectionError("the server has less than was here; starting anew")
        total = _length(answer)
        etag = _header(answer, "ETag") or _header(answer, "Last-Modified")
        if answer.status == _RANGED:
            total = _total(answer, start)
        elif answer.status == _WHOLE:
            part.restart(_validator(answer))
            start = 0
        else:
            raise web.RefusedError(f"{part.url}: the server answers {answer.status}; check the address", answer.status)
        if total is not None and total > MOST_BYTES:
            raise UserError(f"{part.url}: has {total} bytes, which is no firmware; check the address")
        size = _copy(answer, part.file, start, total, progress)
    if total is not None and size != total:
        if size > total:
            part.restart("")
        raise ConnectionError(f"{size} of {total} bytes came")
    return Downloaded(size, etag, part.resumed)


def _copy(answer: web.Answer, file: IO[bytes], start: int, total: int | None, progress: Progress) -> int:
    size = start
    progress(size, total)
    try:
        while chunk := answer.read(CHUNK_BYTES):
            file.write(chunk)
            size += len(chunk)
            progress(size, total)
            if size > MOST_BYTES:
                raise UserError(f"{answer.url}: does not end, which is no firmware; check the address")
    finally:
        file.flush()
    return size


def _validator(answer: web.Answer) -> str:
    """What a later request may go on with: a strong ETag, else the date, else nothing."""
    etag = _header(answer, "ETag")
    return etag if etag.startswith('"') else _header(answer, "Last-Modified")


def _total(answer: web.Answer, start: int) -> int | None:
    found = _CONTENT_RANGE.fullmatch(_header(answer, "Content-Range"))
    if found is None or int(found[1]) != start:
        raise web.RefusedError(
            f"{answer.url}: the server sends another part than was asked for; use --force", answer.status
        )
    return None if found[2] == "*" else int(found[2])


def _length(answer: web.Answer) -> int | None:
    told = _header(answer, "Content-Length")
    return int(told) if _LENGTH.fullmatch(told) else None


def _header(answer: web.Answer, name: str) -> str:
    headers: Mapping[str, str] = {key.lower(): value for key, value in answer.headers.items()}
    return headers.get(name.lower(), "").strip()


def _alone(file: IO[bytes], path: Path) -> None:
    """Lock it, as long as it still has its name: another xitl that has just finished gave it that of the whole file."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        here = path.stat().st_ino == os.fstat(file.fileno()).st_ino
    except OSError:
        here = False
    if not here:
        raise UserError(f"{path}: another xitl is downloading it; wait for it, or end it") from None


def _drop(part: Path, notes: Path) -> None:
    part.unlink(missing_ok=True)
    notes.unlink(missing_ok=True)
