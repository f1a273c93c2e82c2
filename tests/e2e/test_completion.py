"""Tab in bash: the script that `--show-completion` prints, asked as bash asks it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BASH = shutil.which("bash")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(BASH is None, reason="there is no bash on this machine")]


@pytest.fixture
def offered(tmp_path: Path):
    """What Tab offers behind these words."""
    program = tmp_path / "bin/xitl"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m xitl_cli.main "$@"\n')
    program.chmod(0o755)
    root = str(Path(__file__).parents[2])
    environment = {**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}", "PYTHONPATH": root}
    (tmp_path / "work").mkdir()

    def ask(*words: str) -> list[str]:
        asked = " ".join(f"'{word}'" for word in words)
        script = (
            'eval "$(_XITL_COMPLETE=source_bash xitl)"; '
            f"COMP_WORDS=({asked}); COMP_CWORD={len(words) - 1}; _xitl_completion xitl; "
            'printf "%s\\n" "${COMPREPLY[@]}"'
        )
        told = subprocess.run(
            [str(BASH), "-c", script],
            cwd=tmp_path / "work",
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        assert told.stderr == ""
        return told.stdout.split()

    return ask


def test_commands_and_options(offered) -> None:
    assert {"sim", "doctor", "profiles", "logs"} <= set(offered("xitl", ""))
    assert offered("xitl", "logs", "ana") == ["analyze"]
    assert "--duration" in offered("xitl", "sim", "--d")
    assert offered("xitl", "logs", "analyze", "run.mcap", "--section", "sched") == ["scheduler"]


def test_profiles_and_files(offered, tmp_path: Path) -> None:
    assert {"sitl", "sitl-ardupilot"} <= set(offered("xitl", "sim", "sit"))
    assert "faults/link-cut" in offered("xitl", "profiles", "show", "faults/")
    (tmp_path / "work/my-boat.yaml").touch()
    assert offered("xitl", "sim", "--profile", "my-") == ["my-boat.yaml"]
    assert offered("xitl", "wdri", "my-") == ["my-boat.yaml"]
    assert offered("xitl", "logs", "info", "wo") == []  # bash completes the names of files by itself


def test_keys_of_the_profile_with_their_values(offered) -> None:
    assert "clock.seed=1" in offered("xitl", "sim", "sitl", "--set", "clock.")
    assert "autopilot.kind=ardupilot" in offered("xitl", "sim", "sitl-ardupilot", "--set", "autopilot.k")
