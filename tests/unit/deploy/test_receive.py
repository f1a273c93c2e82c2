"""The first thing that runs on a board: it trusts nothing that does not have the right checksum."""

from __future__ import annotations

import hashlib
import io
import json
import subprocess
import sys
import zipfile
from pathlib import Path

from agent.board.receive import MARK

RECEIVER = Path(__file__).parents[3] / "agent/board/receive.py"


def archive() -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as opened:
        opened.writestr("__main__.py", "import sys; print('ran', sys.argv[1:], sys.stdin.read()); sys.exit(3)")
    return made.getvalue()


def receive(data: bytes, tmp_path: Path, **header: object) -> subprocess.CompletedProcess[str]:
    wanted = {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest(), "arguments": ["a", "b c"], **header}
    done = subprocess.run(
        [sys.executable, "-I", str(RECEIVER)],
        input=json.dumps(wanted).encode() + b"\n" + data + b"given",
        capture_output=True,
        env={"TMPDIR": str(tmp_path)},
        check=False,
    )
    assert list(tmp_path.iterdir()) == []
    return subprocess.CompletedProcess(done.args, done.returncode, done.stdout.decode(), done.stderr.decode())


def said(done: subprocess.CompletedProcess[str]) -> str:
    line = done.stdout.strip()
    assert line.startswith(MARK), (done.stdout, done.stderr)
    return str(json.loads(line[len(MARK) :])["error"])


def test_it_runs_what_arrives_and_leaves_nothing(tmp_path: Path) -> None:
    done = receive(archive(), tmp_path)
    assert (done.stdout.strip(), done.returncode) == ("ran ['a', 'b c'] given", 3)


def test_another_checksum_is_not_run(tmp_path: Path) -> None:
    data = bytearray(archive())
    right = hashlib.sha256(data).hexdigest()
    data[40] ^= 1
    done = receive(bytes(data), tmp_path, sha256=right)
    assert done.returncode == 2
    assert f"instead of {right}; try again" in said(done)


def test_a_connection_that_ends_early_is_not_run(tmp_path: Path) -> None:
    done = receive(archive(), tmp_path, bytes=1_000_000)
    assert done.returncode == 2
    assert "of 1000000 bytes arrived" in said(done)
