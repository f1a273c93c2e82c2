"""CONTRIBUTING.md holds: the diffs that it shows apply to the tree, and the files that it names are there."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
DIFFS = re.findall(r"^```diff\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
NAMED = re.compile(r"`((?:agent|sim_core|xitl|xitl_cli|docs|tests|profiles|firmware_params)/[\w./-]+)`")


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git, whose apply reads a diff (apt install git)")
@pytest.mark.parametrize("diff", DIFFS, ids=["a sensor", "a field of a message"])
def test_a_diff_applies(diff: str) -> None:
    done = subprocess.run(
        ["git", "apply", "--check"], input=diff, text=True, capture_output=True, cwd=ROOT, check=False
    )
    assert done.returncode == 0, done.stderr


def test_the_files_that_are_named_are_there() -> None:
    prose = re.sub(r"^```.*?^```$", "", TEXT, flags=re.MULTILINE | re.DOTALL)
    named = NAMED.findall(prose)
    assert len(named) > 30
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_the_classes_of_the_glossary_are_there() -> None:
    named = set(re.findall(r"`([A-Z][A-Za-z]+)`", (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")))
    packages = ("agent", "sim_core", "xitl_cli")
    code = "\n".join(file.read_text(encoding="utf-8") for name in packages for file in (ROOT / name).rglob("*.py"))
    assert len(named) > 40
    assert named - set(re.findall(r"^class (\w+)", code, re.MULTILINE)) == set()
