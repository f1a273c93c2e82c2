"""MAVProxy against a boat in real time, typed at as a person would."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from live_boat import Boat, boat

from agent.fcu.parameters import TABLE
from tests.patience import PATIENCE_S, let_pass, wait_until

PROGRAM = Path(sys.executable).with_name("mavproxy.py")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("MAVProxy") is None or not PROGRAM.exists(),
        reason="MAVProxy is not installed: pip install MAVProxy",
    ),
]

MISSION = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t-8.8000000\t-63.9500000\t70\t1
1\t0\t3\t16\t0\t0\t0\t0\t-8.7999000\t-63.9500000\t0\t1
2\t0\t3\t178\t1\t2.5\t-1\t0\t0\t0\t0\t1
3\t0\t3\t16\t0\t0\t0\t0\t-8.7998000\t-63.9499000\t0\t1
4\t0\t3\t206\t5\t0\t1\t0\t0\t0\t0\t1
5\t0\t3\t114\t8\t0\t0\t0\t0\t0\t0\t1
6\t0\t3\t183\t5\t1700\t0\t0\t0\t0\t0\t1
7\t0\t10\t18\t2\t0\t-12\t0\t-8.7998000\t-63.9498000\t0\t1
8\t0\t3\t93\t20\t-1\t-1\t-1\t0\t0\t0\t1
9\t0\t3\t178\t1\t-1\t-1\t0\t0\t0\t0\t1
10\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1
"""


class Prompt:
    """What a person sees and types."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._seen = ""
        self._mark = 0
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        while character := self._process.stdout.read(1):
            self._seen += character

    def type(self, line: str) -> None:
        """A line; `wait` looks from here on."""
        assert self._process.stdin is not None
        self._mark = len(self._seen)
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def wait(self, pattern: str) -> str:
        try:
            return wait_until(lambda: re.search(pattern, self._seen[self._mark :]))[0]
        except AssertionError:
            raise AssertionError(f"{pattern!r} was not seen in:\n{self._seen[self._mark :]}") from None

    def close(self) -> None:
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.close()
        process.terminate()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:  # its prompt may not let go
            process.kill()
            process.wait()
        self._reader.join(5.0)
        process.stdout.close()


@contextmanager
def mavproxy(found: Boat, folder: Path) -> Iterator[Prompt]:
    process = subprocess.Popen(
        [
            *(sys.executable, str(PROGRAM), "--master", found.tcp, "--state-basedir", str(folder)),
            *("--default-modules", "wp,param,arm,mode,fence,misc"),
        ],
        cwd=folder,
        env={**os.environ, "HOME": str(folder), "PYTHONWARNINGS": "ignore"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    prompt = Prompt(process)
    try:
        yield prompt
    finally:
        prompt.close()


def test_parameters_mission_mode_and_arming(tmp_path: Path) -> None:
    (tmp_path / "mission.txt").write_text(MISSION)
    with boat() as found, mavproxy(found, tmp_path) as prompt:
        prompt.wait(rf"Received {len(TABLE)} parameters")
        saved = tmp_path / "mav.parm"  # it tells before it writes
        wait_until(lambda: saved.exists() and len(saved.read_text().splitlines()) == len(TABLE))
        prompt.type("param set WP_SPEED 2")
        let_pass(1.0)  # MAVProxy sends a set once more after this time
        prompt.type("param fetch WP_SPEED")
        prompt.wait(r"WP_SPEED\s*=\s*2\.0")

        prompt.type("wp load mission.txt")
        prompt.wait("MISSION_ACK: TYPE_MISSION: ACCEPTED")
        prompt.type("wp list")
        prompt.wait(r"Saved 11 waypoints")
        saved = [line.split("\t") for line in (tmp_path / "way.txt").read_text().splitlines()[1:]]
        sent = [line.split("\t") for line in MISSION.splitlines()[1:]]
        assert [line[3] for line in saved] == [line[3] for line in sent]
        for ours, theirs in zip(saved[1:], sent[1:], strict=True):
            assert [float(value) for value in ours[4:8]] == [float(value) for value in theirs[4:8]]
        assert saved[7][2] == "10"
        assert float(saved[1][8]) == pytest.approx(-8.7999, abs=1e-6)
        assert float(saved[2][5]) == 2.5

        prompt.type("wp set 3")
        prompt.wait("waypoint 3")
        prompt.type("mode LOITER")
        prompt.wait("Mode LOITER")
        until_s = time.monotonic() + PATIENCE_S
        while True:  # it is not ready at once, and says why
            prompt.type("arm throttle")
            answer = prompt.wait(r"COMPONENT_ARM_DISARM: \w+")
            if answer.endswith("ACCEPTED"):
                break
            prompt.wait("Arm: ")
            assert time.monotonic() < until_s
            let_pass(2.5)  # MAVProxy does not print a text again sooner
        prompt.wait("ARMED")
        prompt.type("mode AUTO")
        prompt.wait("Mode AUTO")
        prompt.type("disarm")
        prompt.wait("DISARMED")
