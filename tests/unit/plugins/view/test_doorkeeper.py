"""Requests to the view: with the token in their path, of this host and without it."""

from __future__ import annotations

from typing import Any

import pytest
from websockets.datastructures import Headers

from xitl_cli.plugins.view.server import Doorkeeper, ViewAddress


class Connection:
    """Keeps the answer of a refused request."""

    def respond(self, status: Any, text: str) -> tuple[int, str]:
        return int(status), text


class Request:
    def __init__(self, path: str, *headers: tuple[str, str]) -> None:
        self.path = path
        self.headers = Headers([("Host", "127.0.0.1:8080"), *headers])


def answered(token: str, request: Request) -> Any:
    """Return the path that viser is asked for, or the refusal."""
    asked = Doorkeeper(ViewAddress("127.0.0.1", 8080, token), lambda connection, request: None, "boat")
    answer = asked(Connection(), request)
    return request.path if answer is None else answer


@pytest.mark.parametrize(
    ("token", "path", "passed"),
    [
        ("", "/", "/"),
        ("", "/assets/a.js", "/assets/a.js"),
        ("secret", "/secret", "/"),
        ("secret", "/secret/", "/"),
        ("secret", "/secret/assets/a.js", "/assets/a.js"),
        ("secret", "/secret?websocket=1", "?websocket=1"),
    ],
)
def test_the_token_is_taken_off_the_path(token: str, path: str, passed: str) -> None:
    assert answered(token, Request(path)) == passed


@pytest.mark.parametrize("path", ["/", "/assets/a.js", "/secre", "/secrets/a.js", "/other/secret/", "//other/secret"])
def test_a_request_without_the_token_is_refused(path: str) -> None:
    assert answered("secret", Request(path)) == (
        403,
        "the token in the address of this view is missing or wrong\n",
    )


def test_a_page_of_another_site_and_a_doubled_header_are_refused() -> None:
    assert answered("", Request("/", ("Origin", "http://127.0.0.1:8080"))) == "/"
    assert answered("", Request("/", ("Origin", "http://elsewhere.example")))[0] == 403
    assert answered("", Request("/", ("Host", "127.0.0.1:8080"))) == (403, "it has two headers Host\n")
