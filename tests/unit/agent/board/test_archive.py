"""The archive with bytecode: the same program, for this Python and for others."""

from __future__ import annotations

import io
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import agent.board.archive as module
from agent.board.archive import compiled, origin, origin_of

SHEBANG = b"#!/usr/bin/env python3\n"
MAIN = "import sys, inner.part; print(inner.part.NAME, inner.part.__file__, *sys.argv[1:])"


def archive(extra: dict[str, str] | None = None) -> bytes:
    made = io.BytesIO()
    made.write(SHEBANG)
    files = {"__main__.py": MAIN, "inner/__init__.py": "", "inner/part.py": "NAME = 'part'", **(extra or {})}
    with zipfile.ZipFile(made, "a") as opened:
        for name, content in files.items():
            opened.writestr(name, content)
    return made.getvalue()


def test_it_runs_from_its_bytecode(tmp_path: Path) -> None:
    path = tmp_path / "a.pyz"
    path.write_bytes(compiled(archive()))
    with zipfile.ZipFile(path) as opened:
        assert opened.testzip() is None
        assert {"inner/part.py", "inner/part.pyc", "__main__.py"} <= set(opened.namelist())
    ran = subprocess.run([sys.executable, str(path), "x"], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["part", f"{path}/inner/part.pyc", "x"]
    assert path.read_bytes().startswith(SHEBANG)


def test_a_program_knows_its_archive_and_one_in_a_folder_has_none(tmp_path: Path) -> None:
    path, code = tmp_path / "a.pyz", Path(module.__file__).read_text(encoding="utf-8")
    main = "import inner.archive; print(inner.archive.own_archive())"
    path.write_bytes(archive({"__main__.py": main, "inner/archive.py": code}))
    ran = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == str(path)
    with pytest.raises(module.NotAnArchiveError, match="xitl agent package"):
        module.own_archive()


def test_bytecode_of_another_python_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "a.pyz"
    with zipfile.ZipFile(io.BytesIO(compiled(archive()))) as opened:
        files = {name: opened.read(name) for name in opened.namelist()}
    files["inner/part.pyc"] = b"\0\0\0\0" + files["inner/part.pyc"][4:]
    with zipfile.ZipFile(path, "w") as opened:
        for name, content in files.items():
            opened.writestr(name, content)
    ran = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["part", f"{path}/inner/part.py"]


def test_a_part_for_a_newer_python_stays_as_source() -> None:
    with zipfile.ZipFile(io.BytesIO(compiled(archive({"newer.py": "def f(:"})))) as opened:
        assert "newer.py" in opened.namelist()
        assert "newer.pyc" not in opened.namelist()


def test_it_says_what_it_was_made_of(tmp_path: Path) -> None:
    path = tmp_path / "a.pyz"
    assert origin(path) == ""
    path.write_bytes(b"no archive")
    assert origin(path) == ""
    path.write_bytes(archive())
    assert origin(path) == ""
    path.write_bytes(compiled(archive()))
    assert origin(path) == origin_of(archive())
    assert origin(path) != origin_of(archive({"more.py": ""}))
