"""A serial line that goes away with half a chunk in hand."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from agent.wire.transport import open_transport
from tests.patience import wait_until

pytest.importorskip("serial")


def test_half_a_chunk_is_not_the_first_thing_a_line_that_is_back_carries(tmp_path: Path) -> None:
    name = tmp_path / "tty"
    far, near = os.openpty()
    name.symlink_to(os.ttyname(near))
    os.close(near)
    with open_transport(f"serial://{name}?baud=921600", listen=True) as transport:
        assert transport.send(b"x" * 200_000)  # more than the system holds: the rest waits
        os.close(far)
        assert not transport.send(b"to whom?")
        name.unlink()
        far, near = os.openpty()
        name.symlink_to(os.ttyname(near))
        wait_until(lambda: transport.send(b"first\n"))
        assert os.read(far, 4096).replace(b"\r\n", b"\n") == b"first\n"
    os.close(near)
    os.close(far)
