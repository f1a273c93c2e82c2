"""Everything that README and docs have readers type is typed here, page by page, in its order, in an empty directory.

What cannot be had in a test is marked in the page and only parsed: tests/unit/test_documented_commands.py. Runs are cut
short, except where the page shows what they print.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from conftest import environment
from ros2 import own_domain

from tests.documentation import (
    CODE,
    COMMANDS,
    CONSOLE,
    FILE,
    OUTPUT,
    PAGES,
    ROOT,
    SHAPE,
    Block,
    Command,
    blocks,
    holds,
    suppose,
)  # fmt: skip
from tests.forked_xitl import run_xitl
from tests.recorded import CALM, GUST
from tests.recorded_run import FOLDER, recorded_run

LONG_PAGES = (
    "docs/boards.md",
    "docs/campaigns.md",
    "docs/controller.md",
    "docs/features.md",
    "docs/fleets.md",
    "docs/learning.md",
    "docs/logs.md",
    "docs/own-profile.md",
    "docs/paper.md",
    "docs/recording.md",
    "docs/ros.md",
)
"""Their commands take more than ten seconds of an idle machine."""
PARSED_ONLY = ("pip", "git", "cd", "make", "ip", "mavproxy.py", "ardurover")
RUN_S, ENOUGH_S = 1, 300.0
END_OF_BLOCK = "that was a block"
CONSOLE_OF_BLOCKS = """\
import json, sys
for line in sys.stdin:
    exec(json.loads(line), globals())
    print("\\n" + sys.argv[1], flush=True)
"""
LOGS = {"autopilot.bin": "runs/x/autopilot.bin", "run.mcap": "runs/x/run.mcap", "simulated.bin": "runs/x/autopilot.bin"}


class Reader:
    """Somebody who types what a page says."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.typed: dict[str, str] = {}
        self.python: subprocess.Popen[str] | None = None
        commands = directory.parent / f"{directory.name}-commands"
        commands.mkdir()
        script = commands / "xitl"
        script.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m xitl_cli.main "$@"\n')
        script.chmod(0o755)
        path = f"{commands}{os.pathsep}{os.environ['PATH']}"
        self.environment = {
            **environment(),
            "PATH": path,
            "PYTHONPATH": str(ROOT),
            "XITL_CACHE": str(Path(os.environ[FOLDER]) / "cache"),  # one for all pages: it keeps the compiled physics
            "ROS_DOMAIN_ID": str(own_domain()),
        }

    def write(self, block: Block) -> None:
        text = short_plan(block.text) if block.is_plan else block.text
        (self.directory / block.file).write_text(text, encoding="utf-8")

    def run(self, command: Command, short: bool = True) -> str:
        """Everything that it prints. A run that is cut short completes nothing."""
        line = self._line(command.text, short)
        is_campaign = command.words[:2] == ["xitl", "campaign"]  # which starts processes that begin as its own did
        enough_s = ENOUGH_S * (8 if is_campaign else 1)
        if re.fullmatch(r"xitl [^|<>;&$`*?~]+", line.partition(" #")[0]) and not is_campaign:
            words = shlex.split(line, comments=True)[1:]
            told = run_xitl(words, self.directory, self.environment, enough_s)
        else:
            told = subprocess.run(
                line, shell=True, cwd=self.directory, env=self.environment, capture_output=True, text=True,
                timeout=enough_s, check=False,
            )  # fmt: skip
        printed = told.stdout + told.stderr
        wrong = "Traceback" in printed or not self._ended_well(command, told.returncode)
        assert not wrong, f"{command}\n{line}\n{printed}"
        self.typed[line.partition(" #")[0].rstrip()] = printed
        return printed

    def shown(self, command: Command) -> str:
        """What it printed when it was typed, or prints now."""
        return self.typed.get(self._line(command.text, short=False)) or self.run(command, short=False)

    def _ended_well(self, command: Command, code: int) -> bool:
        if command.words[:2] in (["xitl", "sim"], ["xitl", "doctor"], ["xitl", "campaign"], ["xitl", "paper"]):
            return code in (0, 1)  # not completed, not fit, not passed
        if command.words[:2] == ["xitl", "agent"]:
            return code in (0, 124)
        return code == 0

    def _line(self, text: str, short: bool) -> str:
        text = text.replace("<the run>", self._latest_run()).replace("LOG...", "autopilot.bin run.mcap")
        text = re.sub(r"\bLOG\b", "flight.bin", text)
        command, comment, rest = text.partition(" #")
        if command.startswith("xitl campaign") and "--out" not in command and "compare" not in command:
            command += " --dry-run"  # a shipped one: an hour and more
        elif command.startswith("xitl sim") and (short or "ground-station" in command):  # where nobody arms it
            command = f"{command} --duration {RUN_S}"
        elif command.startswith("xitl paper 4"):
            command = f"{command} --duration 5"
        elif command.startswith("xitl agent --"):
            command = f"timeout -s INT 3 {command} --link udp://127.0.0.1:0"
        return f"{command.rstrip()}{comment}{rest}"

    def _latest_run(self) -> str:
        runs = [run for run in (self.directory / "runs").glob("*") if (run / "run.mcap").exists()]
        return max(runs, key=lambda run: run.stat().st_mtime).name if runs else "none"

    def run_code(self, block: Block) -> None:
        """Each block of a page begins where the one before it has ended: one process runs them all."""
        if self.python is None:
            words = [sys.executable, "-c", CONSOLE_OF_BLOCKS, END_OF_BLOCK]
            self.python = subprocess.Popen(
                words, cwd=self.directory, env=self.environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT, text=True,
            )  # fmt: skip
        assert self.python.stdin is not None
        assert self.python.stdout is not None
        text = block.text.replace('xitl.simulate("sitl",', f'xitl.simulate("sitl", duration_s={RUN_S},')
        self.python.stdin.write(f"{json.dumps(text)}\n")
        self.python.stdin.flush()
        printed = []
        for line in self.python.stdout:
            if line == f"{END_OF_BLOCK}\n":
                return
            printed.append(line)
        raise AssertionError(f"{block}\n{''.join(printed)}")

    def close(self) -> None:
        """End the process of the code blocks, as Python ends after its last line."""
        if self.python is not None:
            printed, _ = self.python.communicate(timeout=ENOUGH_S)
            assert self.python.returncode == 0, printed


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=[pytest.mark.nightly] if page in LONG_PAGES else []) for page in PAGES]
)
def test_what_a_page_has_typed_works(page: str, tmp_path: Path) -> None:
    """A reader has a run from before, in runs/x."""
    directory = tmp_path / "here"
    directory.mkdir()
    suppose(directory)
    shutil.copytree(recorded_run("sitl", 20.0), directory / "runs/x")
    for name, source in LOGS.items():
        (directory / name).symlink_to(directory / source)
    (directory / "real.bin").symlink_to(CALM)
    (directory / "flight.bin").symlink_to(GUST)
    for name in ("mine.csv", "pool-test.csv"):
        shutil.copy(ROOT / "profiles/replays/zigzag.csv", directory / name)
    shutil.copy(directory / "autopilot.bin", directory / "runs/mine/autopilot.bin")
    with closing(Reader(directory)) as reader:
        for block in blocks(page):
            follow(reader, block)


def follow(reader: Reader, block: Block) -> None:
    """Do what a block of its page says."""
    kind = block.kind
    if block.note == "needs":
        return
    if kind == FILE:
        reader.write(block)
    elif kind == CODE:
        reader.run_code(block)
    elif kind == COMMANDS:
        for command in block.commands:
            if command.program not in PARSED_ONLY:
                reader.run(command, short=not is_shown(block.page, command))
    elif kind == CONSOLE:
        check_console(reader, block)
    elif kind in (OUTPUT, SHAPE):
        printed = reader.shown(Command(block.page, block.line, block.about))
        missing = holds(block.text, printed, shape=kind == SHAPE)
        assert not missing, f"{block}: not printed:\n{missing}\n\nbut:\n{printed}"


def short_plan(text: str) -> str:
    """Of a second a run, two seeds, and a search that gives up after its first points."""
    seeds = "1" if "sensitivity:" in text else "1-2"
    text = re.sub(r"^seeds: .*$", f"seeds: {seeds}", text, flags=re.MULTILINE)
    if not re.search(r"^  autopilot\.", text, re.MULTILINE):
        text = text.replace("base: sitl\n", "base: mitl\n")
    text = re.sub(r"^(search|sensitivity): \{.*$", _fewest_runs, text, flags=re.MULTILINE)
    return f"{text}\nset: {{clock.duration_s: {RUN_S}}}\n"


def _fewest_runs(line: re.Match[str]) -> str:
    few = {"search": "{points: 2, runs_per_point: 1, most_runs: 1}", "sensitivity": "{samples: 2}"}
    return f"{line[1]}: {few[line[1]]}"


def is_shown(page: str, command: Command) -> bool:
    """Whether the page shows what is read from the directory of this run."""
    out = re.search(r"--out (\S+)", command.text)
    return out is not None and any(out[1] in block.about for block in blocks(page) if block.kind in (OUTPUT, SHAPE))


def check_console(reader: Reader, block: Block) -> None:
    """A command and, up to the next one, what it prints; its exit code may be an error's."""
    for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
        line, _, expected = part.partition("\n")
        told = subprocess.run(
            line, shell=True, cwd=reader.directory, env=reader.environment, capture_output=True, text=True,
            timeout=ENOUGH_S, check=False,
        )  # fmt: skip
        missing = holds(expected, told.stdout + told.stderr)
        assert not missing, f"{block}: not printed:\n{missing}\n\nbut:\n{told.stdout}{told.stderr}"
