"""A process beside a run: what goes between them, why it ended, and that it never outlives its patience."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from xitl_cli.run.core.side_process import SideProcess, spawn

PATIENCE_S = 30.0
HEAD = """import os, signal, socket, sys, time
from xitl_cli.pipe import Pipe, PipeClosedError
pipe = Pipe.of_process(socket.socket(fileno=int(sys.argv[-1])))
"""


class Beside:
    """A SideProcess of a module that the test writes. why: it was lost, each time that was said."""

    def __init__(self, module: str, patience_s: float) -> None:
        self.why: list[str] = []
        self.process = SideProcess(module, self.why.append, patience_s)

    def next(self) -> object:
        until_s = time.monotonic() + PATIENCE_S
        while not (found := self.process.receive(0.1)):
            assert time.monotonic() < until_s
            assert not self.process.gone
        return found[0]

    def wait_for_loss(self) -> str:
        until_s = time.monotonic() + PATIENCE_S
        while not self.process.gone:
            assert time.monotonic() < until_s
            self.process.receive(0.1)
        (why,) = self.why
        return why


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Beside]]:
    monkeypatch.syspath_prepend(tmp_path)
    processes: list[Beside] = []

    def make(code: str, patience_s: float = PATIENCE_S) -> Beside:
        (tmp_path / "beside.py").write_text(HEAD + code)
        processes.append(Beside("beside", patience_s))
        return processes[-1]

    yield make
    for one in processes:
        one.process.close()


def test_it_has_the_sockets_and_is_in_a_session_of_its_own(made: Callable[..., Beside]) -> None:
    beside = made(
        "own = os.getsid(0) == os.getpid()\npipe.send([socket.socket(fileno=int(sys.argv[1])).getsockname()[1], own])\n"
    )
    with socket.create_server(("127.0.0.1", 0)) as listener:
        beside.process.start([listener])
        assert beside.next() == [listener.getsockname()[1], True]


def test_the_last_line_of_one_that_fails_is_why_it_is_lost(made: Callable[..., Beside]) -> None:
    beside = made("raise OSError('no domain')\n")
    beside.process.start()
    assert beside.wait_for_loss() == " (OSError: no domain)"
    beside.process.send("to nobody")
    assert beside.process.receive() == []
    assert len(beside.why) == 1


def test_what_it_said_before_its_end_arrives_also_when_the_end_shows_at_a_message_to_it(
    made: Callable[..., Beside],
) -> None:
    beside = made("pipe.send('its problem')\n")
    beside.process.start()
    until_s = time.monotonic() + PATIENCE_S
    while not beside.process.gone:
        assert time.monotonic() < until_s
        beside.process.send("to nobody")
        time.sleep(0.01)
    assert beside.process.receive() == ["its problem"]
    assert beside.process.receive() == []
    assert len(beside.why) == 1


def test_threads_of_libraries_do_not_have_the_last_word(made: Callable[..., Beside]) -> None:
    beside = made("""
import atexit
from xitl_cli.pipe import until_closed
atexit.register(print, "RuntimeError: told to end", file=sys.stderr)
with until_closed():
    raise OSError("no domain")
""")
    beside.process.start()
    assert beside.wait_for_loss() == " (OSError: no domain)"


def test_the_signal_that_ended_it_is_why_it_is_lost(made: Callable[..., Beside]) -> None:
    beside = made("print('last', file=sys.stderr, flush=True)\nos.kill(os.getpid(), signal.SIGKILL)\n")
    beside.process.start()
    assert beside.wait_for_loss() == " (signal 9)"


@pytest.mark.medium
def test_what_still_waits_is_given_at_the_end(made: Callable[..., Beside], tmp_path: Path) -> None:
    code = """
import pathlib
taken = 0
try:
    while True:
        taken += sum(map(len, pipe.receive(1.0)))
        time.sleep(0.02)
except PipeClosedError:
    pathlib.Path("TAKEN").write_text(str(taken))
""".replace("TAKEN", str(tmp_path / "taken"))
    beside = made(code)
    beside.process.start()
    beside.process.send(bytes(8_000_000))
    assert beside.process.waiting_bytes > 0
    beside.process.close()
    assert (tmp_path / "taken").read_text() == "8000000"
    assert beside.why == []


def test_its_last_words_are_taken_in_and_its_end_is_no_loss(made: Callable[..., Beside]) -> None:
    beside = made("pipe.receive_first()\npipe.send('one')\npipe.send('two')\n")
    beside.process.start()
    beside.process.send("over")
    assert list(beside.process.receive_last()) == ["one", "two"]
    assert beside.process.gone
    assert beside.why == []


def test_one_that_does_not_end_is_killed(made: Callable[..., Beside]) -> None:
    beside = made("pipe.send(os.getpid())\ntime.sleep(1000.0)\n", patience_s=0.2)
    beside.process.start()
    number = beside.next()
    beside.process.close()
    assert not Path(f"/proc/{number}").exists()
    beside.process.close()


def test_before_its_start_nothing_comes_and_nothing_is_lost() -> None:
    beside = Beside("nowhere", 0.0)
    beside.process.send("to nobody")
    assert beside.process.receive() == []
    assert beside.process.gone
    beside.process.close()
    assert beside.why == []


def test_a_variable_of_the_process_gives_way_to_one_of_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("XITL_TEST_SET", "user")
    (tmp_path / "beside.py").write_text(
        "import os, sys\nprint(os.environ['XITL_TEST_SET'], os.environ['XITL_TEST_UNSET'], file=sys.stderr)\n"
    )
    words = tmp_path / "words"
    with words.open("wb") as file:
        spawn("beside", [], file, {"XITL_TEST_SET": "default", "XITL_TEST_UNSET": "default"}).wait()
    assert words.read_text() == "user default\n"
