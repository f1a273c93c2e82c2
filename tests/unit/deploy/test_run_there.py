"""What goes to a board over ssh, and the sentence for each answer. The ssh is a script that answers as told."""

from __future__ import annotations

import hashlib
import json
import stat
import sys
from pathlib import Path
from typing import Any

import pytest

from agent.board.receive import MARK
from xitl_cli.deploy.package import Package
from xitl_cli.deploy.ssh import CONNECT_TIMEOUT_S, REMOTE, Board, run_there
from xitl_cli.errors import UserError

PACKAGE = Package(b"the archive", hashlib.sha256(b"the archive").hexdigest(), (), ())


@pytest.fixture
def ssh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that says what ssh answers. It stores its words and its standard input in files."""
    program = tmp_path / "ssh"
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")

    def answers(out: bytes = b"", err: bytes = b"", code: int = 0) -> None:
        (tmp_path / "out").write_bytes(out)
        (tmp_path / "err").write_bytes(err)
        program.write_text(
            f"#!/bin/sh\ncd '{tmp_path}'\nfor word; do echo \"$word\"; done > words\ncat > sent\n"
            f"cat out\ncat err >&2\nexit {code}\n"
        )
        program.chmod(program.stat().st_mode | stat.S_IXUSR)

    return answers


def marked(outcome: Any) -> bytes:
    return (MARK + json.dumps(outcome) + "\n").encode()


def test_the_receiver_comes_first_then_header_archive_and_input(ssh: Any, tmp_path: Path) -> None:
    ssh(out=b"a greeting\n" + marked({"old": 1}) + marked({"machine": "armv7l"}) + b"bye\n")
    assert run_there(Board("a@b"), PACKAGE, ["install", "--x"], b"its input") == {"machine": "armv7l"}  # the last one
    words = (tmp_path / "words").read_text().splitlines()
    assert words[:2] == ["-T", "-o"]
    assert f"ConnectTimeout={CONNECT_TIMEOUT_S}" in words
    assert words[-3:] == ["--", "a@b", REMOTE]
    size, _, rest = (tmp_path / "sent").read_bytes().partition(b"\n")
    receiver, rest = rest[: int(size)], rest[int(size) :]
    compile(receiver, "receiver", "exec")
    header, _, rest = rest.partition(b"\n")
    assert json.loads(header) == {"bytes": 11, "sha256": PACKAGE.sha256, "arguments": ["install", "--x"]}
    assert rest == b"the archiveits input"


@pytest.mark.parametrize(
    ("code", "err", "said"),
    [
        (255, b"note\nHost key verification failed.\n", "its host key is unknown or has changed"),
        (255, b"a@b: Permission denied (publickey).\nbye\n", "it refused the login"),
        (255, b"Could not resolve hostname b: no\n", "the host name is unknown"),
        (255, b"connect to host b port 22: Connection refused\n", "without an ssh server"),
        (255, b"connect to host b: Connection timed out\n", "it does not answer; check cable"),
        (255, b"connect to host b: No route to host\n", "it does not answer; check cable"),
        (255, b"connect to host b: Network is unreachable\n", "this machine has no route to it"),
        (255, b"first\n  new words \n\n", r"ssh could not connect \(new words\); try to log in"),
        (255, b"", "ssh could not connect; try to log in"),
        (127, b"sh: python3: not found\n", r"python3 is not installed on the board \(sh: python3: not found\)"),
        (127, b"", "python3 is not installed on the board; on Debian"),
        (3, b"Permission denied\n", r"no answer, exit code 3 \(Permission denied\); check its python3"),
        (0, b"", "the board sent no answer, exit code 0; check"),
    ],
)
def test_without_an_answer_the_sentence_says_why(ssh: Any, code: int, err: bytes, said: str) -> None:
    ssh(err=err, code=code)
    with pytest.raises(UserError, match=f"^a@b: .*{said}"):
        run_there(Board("a@b"), PACKAGE, [], b"")


@pytest.mark.parametrize(
    ("out", "said"),
    [
        (marked({"error": "no space left"}), "a@b: no space left"),
        (MARK.encode() + b'{"machine": "arm', "a@b: the answer was cut off; try again"),
        (marked(["a list"]), "a@b: the answer was cut off; try again"),
    ],
)
def test_an_answer_that_is_an_error_or_none(ssh: Any, out: bytes, said: str) -> None:
    ssh(out=out, code=2)
    with pytest.raises(UserError) as refused:
        run_there(Board("a@b"), PACKAGE, [], b"")
    assert str(refused.value) == said


def test_a_board_that_does_not_answer_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ssh").write_text(f"#!{sys.executable}\nimport time; time.sleep(60)\n")
    (tmp_path / "ssh").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    with pytest.raises(UserError, match=r"^a@b: no answer within 0 s; check that the board is not overloaded$"):
        run_there(Board("a@b"), PACKAGE, [], b"", longest_s=0.1)


def test_a_machine_without_ssh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserError, match=r"^ssh is not installed on this machine; .*openssh-client"):
        run_there(Board("a@b"), PACKAGE, [], b"")
