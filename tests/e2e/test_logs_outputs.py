"""What `xitl logs` writes, and what it must not write over."""

from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import assert_one_line_error, command, environment

from tests.golden import Golden
from tests.recorded import CALM

Run = Callable[..., subprocess.CompletedProcess[str]]

pytestmark = pytest.mark.slow


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A copy of the first half megabyte: some of these commands try to write over it."""
    path = tmp_path / "run.bin"
    path.write_bytes(CALM.read_bytes()[:500_000])
    return path


TAKEN = "exists and is not a page; choose another file name"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("analyze", "run.bin", "--report", "other.bin"), TAKEN),
        (("plot", "run.bin", "ATT.Roll", "--out", "other.bin"), "cannot plot to .bin"),
        (("compare", "run.bin", "run.bin", "--report", "other.bin"), TAKEN),
        (("plot", "run.bin", "ATT.Roll", "--out", "run.bin"), "cannot plot to .bin"),
    ],
)
def test_a_page_is_not_written_over_a_log(arguments: tuple[str, ...], said: str, logs: Run, log: Path) -> None:
    other = shutil.copy(log, log.with_name("other.bin"))
    before = log.read_bytes()
    told = logs(*arguments)
    assert (told.returncode, told.stdout) == (2, "")
    assert_one_line_error(told, said)
    assert log.read_bytes() == Path(other).read_bytes() == before


@pytest.mark.parametrize(
    "arguments",
    [
        ("plot", "run.bin", "ATT.Roll", "--out", "special"),
        ("export", "run.bin", "ATT", "--format", "mcap", "--overwrite", "--out", "special"),
    ],
)
def test_what_is_no_regular_file_is_not_replaced(arguments: tuple[str, ...], logs: Run, log: Path) -> None:
    special = log.with_name("special")
    os.mkfifo(special)
    told = logs(*arguments)
    assert told.returncode == 2
    assert_one_line_error(told)
    assert stat.S_ISFIFO(special.stat().st_mode)


def test_a_page_replaces_a_page_and_goes_where_a_link_leads(logs: Run, log: Path) -> None:
    link, page = log.with_name("link.html"), log.with_name("page.html")
    link.symlink_to(page.name)
    for signal in ("ATT.Roll", "ATT.Pitch"):
        assert logs("plot", "run.bin", signal, "--out", "link.html").returncode == 0
        assert link.is_symlink()
        assert signal in page.read_text(encoding="utf-8")


def test_an_export_over_a_link_leaves_the_link(logs: Run, log: Path) -> None:
    link, there = log.with_name("link.mcap"), log.with_name("there.mcap")
    link.symlink_to(there.name)
    there.write_bytes(b"old")
    assert logs("export", "run.bin", "ATT", "--format", "mcap", "--overwrite", "--out", "link.mcap").returncode == 0
    assert link.is_symlink()
    assert there.read_bytes().startswith(b"\x89MCAP0\r\n")


def test_names_of_files_command_no_terminal(logs: Run, log: Path) -> None:
    hostile = log.rename(log.with_name("\x1b[31mred.bin"))
    assert "\x1b" not in logs("info", hostile.name).stdout
    assert "\x1b" not in logs("analyze", hostile.name, "--section", "vehicle").stdout
    told = logs("info", "\x1b[31mnone.bin", "\x1b[31mnor.bin")
    assert "\x1b" not in told.stderr
    assert told.stderr.count("does not exist") == 2


def test_a_name_that_is_no_utf_8(log: Path) -> None:
    name = b"caf\xe9.bin"
    os.rename(log, os.path.join(os.fsencode(log.parent), name))  # noqa: PTH104, PTH118  bytes
    strict = {**environment(), "PYTHONIOENCODING": "utf-8:strict"}
    told = subprocess.run([*command("logs", "info", "--json"), name], cwd=log.parent, env=strict, capture_output=True)
    assert told.returncode == 0
    assert json.loads(told.stdout)["logs"][0]["file"] == "caf\udce9.bin"
    drawn = subprocess.run(
        [*command("logs", "plot"), name, "ATT.Roll", "--out", "page.html"], cwd=log.parent, capture_output=True
    )
    assert drawn.returncode == 0, drawn.stderr
    assert "caf?.bin" in (log.parent / "page.html").read_text(encoding="utf-8")


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="needs /dev/full")
@pytest.mark.parametrize("asked", [("info",), ("dump", "ATT")])
def test_a_full_disk_under_the_output_is_a_sentence(asked: tuple[str, ...], log: Path, golden: Golden) -> None:
    program, *rest = asked
    with Path("/dev/full").open("wb") as full:
        told = subprocess.run(
            [*command("logs", program), str(log), *rest],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(),
        )
    assert told.returncode == 2
    golden("stderr", told.stderr)
    assert "Traceback" not in told.stderr
