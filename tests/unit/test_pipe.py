"""What goes between a run and its view."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from xitl_cli.pipe import Pipe, PipeClosedError
from xitl_cli.plugins.view.messages import ViewEnd, ViewUpdate

Ends = tuple[Pipe, Pipe]


@pytest.fixture
def ends() -> Iterator[Ends]:
    run, view = socket.socketpair()
    pipes = Pipe.of_run(run), Pipe.of_process(view)
    yield pipes
    for pipe in pipes:
        pipe.close()


def test_messages_arrive_in_their_order(ends: Ends) -> None:
    run, view = ends
    run.send(ViewUpdate(b"one"))
    run.send(ViewEnd("two"))
    assert view.receive(5.0) == [ViewUpdate(b"one"), ViewEnd("two")]
    view.send({"ask": True})
    assert run.receive(5.0) == [{"ask": True}]
    assert run.receive() == []


def test_who_does_not_read_stops_nobody(ends: Ends) -> None:
    run, view = ends
    large = ViewUpdate(bytes(4_000_000))
    run.send(large)
    run.send(large)
    assert run.waiting_bytes > 4_000_000
    found: list[object] = []
    while len(found) < 2:
        run.flush()
        found += view.receive(5.0)
    assert found == [large, large]
    assert run.waiting_bytes == 0


def test_an_end_that_is_gone_is_told(ends: Ends) -> None:
    run, view = ends
    view.send({"ask": True})
    view.close()
    assert run.receive() == [{"ask": True}]
    with pytest.raises(PipeClosedError):
        run.receive()
    with pytest.raises(PipeClosedError):
        run.send(ViewEnd(""))


def test_an_end_that_sends_no_more_is_told(ends: Ends) -> None:
    run, view = ends
    run.send(ViewEnd("over"))
    run.close_sending()
    assert view.receive(5.0) == [ViewEnd("over")]
    with pytest.raises(PipeClosedError):
        view.receive(5.0)
