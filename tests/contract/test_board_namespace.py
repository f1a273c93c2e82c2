"""The network namespace of a board, with another program in place of its emulator: made, entered, connected to."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S, wait_until
from xitl_cli.errors import UserError
from xitl_cli.plugins.board import namespace, network
from xitl_cli.plugins.board.namespace import emulator_process
from xitl_cli.plugins.board.places import NAMESPACE, EmulatedBoard

ANSWERS = """\
import os, socket, sys
with socket.create_server(("192.168.7.1", 0)) as server:
    with open(sys.argv[2], "w") as file:
        file.write(str(server.getsockname()[1]))
    with open(sys.argv[1], "w") as file:
        file.write(str(os.getpid()))
    while True:
        with server.accept()[0] as caller:
            caller.sendall(b"it is me")
"""


@pytest.fixture(params=["as who runs the tests", "in a user namespace"])
def board(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[EmulatedBoard]:
    """What runs in its namespace answers at a port of 192.168.7.1, which is in the file `port` of its folder."""
    monkeypatch.setenv("XITL_CACHE", str(tmp_path))
    if request.param == "in a user namespace":
        monkeypatch.setattr(os, "geteuid", lambda: 1000)
    made = EmulatedBoard("boat", "bookworm", "", 1, 512, 14700, NAMESPACE)
    made.folder.mkdir(parents=True)
    try:
        network.check_network(made)
    except UserError as error:
        pytest.skip(f"no network namespace with a tap can be made here: {error}")
    words = [sys.executable, "-c", ANSWERS, str(made.pid_file), str(made.folder / "port")]
    with subprocess.Popen(network.started_in(made, words)) as emulator:
        try:
            wait_until(lambda: emulator_process(made.pid_file), "nothing runs in the namespace")
            yield made
        finally:
            emulator.send_signal(signal.SIGKILL)


def inside(board: EmulatedBoard, *words: str) -> subprocess.CompletedProcess[str]:
    pid = emulator_process(board.pid_file)
    assert pid is not None
    assert not network.is_reached(board, pid)
    return subprocess.run(
        network.entering(board, pid, words), capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )


def test_its_network_is_a_tap_with_the_hosts_address(board: EmulatedBoard) -> None:
    shown = inside(board, "ip", "-brief", "-4", "address", "show").stdout.split()
    assert {"lo", "127.0.0.1/8", "tap0", "192.168.7.1/24"} <= set(shown)
    assert "UP" in inside(board, "ip", "link", "show", "dev", "tap0").stdout
    outside = subprocess.run(["ip", "link", "show", "dev", "tap0"], capture_output=True, check=False)
    assert outside.returncode != 0


def test_who_enters_is_where_the_emulator_is(board: EmulatedBoard) -> None:
    its = [str((Path("/proc") / board.pid_file.read_text() / "ns" / kind).readlink()) for kind in ("net", "user")]
    assert inside(board, "readlink", "/proc/self/ns/net", "/proc/self/ns/user").stdout.split() == its


@pytest.mark.medium
def test_what_is_within_needs_not_enter_and_has_the_commands_exit_code(board: EmulatedBoard) -> None:
    code = (
        "import sys; from xitl_cli.plugins.board.namespace import shares_network as shares; "
        "sys.exit(40 + shares(sys.argv[1]))"
    )
    pid = board.pid_file.read_text()
    assert inside(board, sys.executable, "-c", code, pid).returncode == 41
    assert subprocess.run([sys.executable, "-c", code, pid], check=False).returncode == 40


def proxied(board: EmulatedBoard, port: int) -> tuple[bytes, str]:
    """What comes through the connection that ssh would be given, and what is said where there is none."""
    words = [sys.executable, "-IS", namespace.__file__, str(board.pid_file), "192.168.7.1", str(port)]
    ours, theirs = socket.socketpair()
    with ours, theirs:
        done = subprocess.run(
            words, stdout=theirs.fileno(), stderr=subprocess.PIPE, text=True, timeout=PATIENCE_S, check=False
        )
        theirs.close()
        passed = socket.recv_fds(ours, 1, 1)[1]
        assert len(passed) == (done.returncode == 0)
        if not passed:
            return b"", done.stderr
        with socket.socket(fileno=passed[0]) as connection:
            assert connection.getpeername() == ("192.168.7.1", port)
            connection.settimeout(PATIENCE_S)
            return connection.recv(100), done.stderr


@pytest.mark.medium
def test_ssh_is_given_a_connection_made_in_the_namespace(board: EmulatedBoard) -> None:
    port = int((board.folder / "port").read_text())
    assert proxied(board, port) == (b"it is me", "")
    assert proxied(board, 9) == (b"", "Connection refused\n")
    board.pid_file.unlink()
    assert proxied(board, port) == (b"", f"{board.pid_file}: the emulator does not run\n")
