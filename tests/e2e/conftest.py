"""The `xitl` command as a user runs it: a process of its own."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from tests.forked_xitl import run_xitl
from tests.free_ports import free_port as next_free_port
from tests.patience import PATIENCE_S

Xitl = Callable[..., subprocess.CompletedProcess[str]]
Payloads = dict[str, list[tuple[int, bytes]]]


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "xitl_cli.main", *arguments]


def environment() -> dict[str, str]:
    return {**os.environ, "NO_COLOR": "1", "COLUMNS": "80"}


@pytest.fixture
def xitl(tmp_path: Path) -> Xitl:
    """Run `xitl ARGUMENTS` in a temporary directory and wait for it."""

    def run(*arguments: str, timeout_s: float = 300.0) -> subprocess.CompletedProcess[str]:
        return run_xitl(arguments, tmp_path, environment(), timeout_s)

    return run


@contextmanager
def running(folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """`xitl sim ARGUMENTS --out run` from its first line of progress on; killed in the end if it is still there."""
    with subprocess.Popen(
        command("sim", *arguments, "--out", "run"),
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            assert any(line.startswith("t ") for line in process.stdout), "it is never under way"
            yield process
        finally:
            process.kill()


def patient(page: Any) -> Any:
    """A page of playwright's that waits, as do expectations of it, as long as drawing in software may take."""
    from playwright.sync_api import expect

    expect.set_options(timeout=3e3 * PATIENCE_S)
    page.set_default_timeout(3e3 * PATIENCE_S)
    return page


def unhurried(page: Any) -> Any:
    """The same, of a scene: a frame a second, as drawing in software would keep every processor busy all the time."""
    page.add_init_script(
        "const draw = window.requestAnimationFrame.bind(window);"
        "window.requestAnimationFrame = (frame) => setTimeout(() => draw(frame), 1000);"
        "window.cancelAnimationFrame = clearTimeout;"
    )
    return patient(page)


@pytest.fixture
def logs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Xitl:
    """Run `xitl logs ARGUMENTS` in a temporary directory, in this process: a new one takes longer than the work."""
    from xitl_cli.main import main

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("sys.argv", ["xitl", "logs", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        told = capsys.readouterr()
        return subprocess.CompletedProcess(arguments, int(ended.value.code or 0), told.out, told.err)

    return run


@pytest.fixture
def free_port() -> int:
    return next_free_port()


def newest_time_s(said: str) -> float:
    """Simulation time of the newest line of progress in what a run said; 0 before the first."""
    return float(["0", *re.findall(r"^t +([\d.]+) s", said, re.MULTILINE)][-1])


def summary(directory: Path) -> dict[str, Any]:
    return json.loads((directory / "summary.json").read_text())


def payloads(recording: Path) -> Payloads:
    """(stamp, payload) of every message by topic."""
    topics: Payloads = {}
    with recording.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            topics.setdefault(channel.topic, []).append((message.log_time, message.data))
    return topics


def differences(one: Payloads, other: Payloads) -> dict[str, tuple[object, object]]:
    """Of topics of one recording that are not the same in another: the first message that is not, in both."""
    return {
        topic: next(pair for pair in zip_longest(one[topic], other.get(topic, ())) if pair[0] != pair[1])
        for topic in one
        if one[topic] != other.get(topic)
    }


def assert_one_line_error(result: subprocess.CompletedProcess[str], *words: str) -> None:
    """Exit code 2, one line on stderr that holds the words, no traceback."""
    assert result.returncode == 2, result.stderr
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("error: ")
    for word in words:
        assert word in lines[0], (word, lines[0])
