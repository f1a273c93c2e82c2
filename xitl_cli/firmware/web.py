"""HTTP as the firmware server is asked: one request, one answer, one error that says what to do."""

from __future__ import annotations

import http.client
import socket
import ssl
from collections.abc import Mapping
from email.message import Message
from types import TracebackType
from typing import IO
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from agent import __version__
from xitl_cli.errors import UserError

TIMEOUT_S = 30.0
PAGE_BYTES = 4_000_000
NOT_MODIFIED, NOT_FOUND, RANGE_BEYOND = 304, 404, 416
CUT = (http.client.HTTPException, ConnectionError, TimeoutError, ssl.SSLError)
"""What a connection that breaks while it is read raises."""


class UnreachableError(UserError):
    """The server could not be asked at all, or did not answer."""


class RefusedError(UserError):
    """The server answered with an error; `status` says which."""

    def __init__(self, text: str, status: int) -> None:
        super().__init__(text)
        self.status = status


class Answer:
    """An open answer: `status`, `headers`, `url` after redirections. Close it, or use it in a `with`."""

    def __init__(self, status: int, headers: Mapping[str, str], url: str, body: IO[bytes]) -> None:
        self.status = status
        self.headers = headers
        self.url = url
        self._body = body

    def read(self, most: int) -> bytes:
        """At most so many bytes, empty at the end. Raises one of `CUT` when the connection breaks, however it does."""
        try:
            return self._body.read(most)
        except CUT:
            raise
        except OSError as error:
            raise ConnectionError(error.errno, error.strerror) from error

    def close(self) -> None:
        """Give the connection back."""
        self._body.close()

    def __enter__(self) -> Answer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class NoDowngrade(HTTPRedirectHandler):
    """Follows redirections, but not from https to anything else."""

    def redirect_request(
        self, req: Request, fp: IO[bytes], code: int, msg: str, headers: Message, newurl: str
    ) -> Request | None:
        """As the base, or URLError."""
        if urlsplit(req.full_url).scheme == "https" and urlsplit(newurl).scheme != "https":
            raise URLError(f"it points from https to {newurl}")
        return super().redirect_request(req, fp, code, msg, headers, newurl)  # type: ignore[arg-type]


def ask(url: str, headers: Mapping[str, str] | None = None, timeout_s: float = TIMEOUT_S) -> Answer:
    """Ask for a URL. Statuses 2xx, 304 and 416 are answers; others raise RefusedError, no answer UnreachableError."""
    if urlsplit(url).scheme not in ("http", "https"):
        raise UserError(f"{url}: is no web address; write it like https://firmware.ardupilot.org")
    request = Request(url, headers={"User-Agent": f"xitl/{__version__}", **(headers or {})})
    try:
        answer = build_opener(NoDowngrade()).open(request, timeout=timeout_s)
    except HTTPError as error:
        if error.code in (NOT_MODIFIED, RANGE_BEYOND):
            return Answer(error.code, dict(error.headers), url, error)
        error.close()
        raise RefusedError(
            f"{url}: the server answers {error.code} {error.reason}; check the address", error.code
        ) from None
    except (URLError, ValueError, *CUT) as error:
        raise UnreachableError(
            f"{url}: cannot be reached ({reason(error)}); check the network and the address"
        ) from None
    return Answer(answer.status, dict(answer.headers), answer.url, answer)


def text(url: str, timeout_s: float = TIMEOUT_S) -> str | None:
    """A small text; None where the server has none. Raises UnreachableError, and RefusedError for other refusals."""
    try:
        with ask(url, timeout_s=timeout_s) as answer:
            return answer.read(PAGE_BYTES).decode("utf-8", "replace")
    except RefusedError as error:
        if error.status == NOT_FOUND:
            return None
        raise
    except CUT as error:
        raise UnreachableError(f"{url}: broke off ({reason(error)}); try again") from None


def reason(error: BaseException) -> str:
    """Why, in a few words for people."""
    inner = error.reason if isinstance(error, URLError) else error
    if isinstance(inner, ssl.SSLCertVerificationError):
        return f"its certificate is not trusted here: {inner.verify_message}"
    if isinstance(inner, socket.gaierror):
        return "its name has no address; is there a network?"
    if isinstance(inner, TimeoutError):
        return "no answer in time"
    if isinstance(inner, OSError) and inner.strerror:
        return inner.strerror
    return str(inner) or type(inner).__name__
