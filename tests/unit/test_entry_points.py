"""Entry points of packages in folders, compared with `importlib.metadata`."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from agent.entry_points import entry_points

Row = tuple[str, str, str, str, str]


def rows(prefix: str = "xitl.") -> list[Row]:
    return [(entry.group, entry.name, entry.target, entry.package, entry.version) for entry in entry_points(prefix)]


def rows_of_library(prefix: str = "xitl.") -> list[Row]:
    return [
        (entry.group, entry.name, entry.value, entry.dist.name, entry.dist.version)
        for group in sorted(importlib.metadata.entry_points().groups)
        if group.startswith(prefix)
        for entry in importlib.metadata.entry_points(group=group)
    ]


def described(package: str, version: str, entries: str) -> dict[str, bytes]:
    """Return the files of a package that has no code, by path."""
    info = f"{package.replace('-', '_')}-{version}.dist-info"
    head = f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n\nName: not-this\n"
    return {f"{info}/METADATA": head.encode(), f"{info}/entry_points.txt": entries.encode()}


def write(folder: Path, files: dict[str, bytes]) -> str:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return str(folder)


@pytest.fixture
def path(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A path for imports with the standard library alone."""
    only = [folder for folder in sys.path if folder and "site-packages" not in folder]
    monkeypatch.setattr(sys, "path", only)
    return only


@pytest.mark.medium
@pytest.mark.parametrize("prefix", ["", "xitl.", "console_scripts"])
def test_this_installation_has_the_entry_points_of_importlib(prefix: str) -> None:
    assert sorted(rows(prefix)) == sorted(rows_of_library(prefix))
    assert rows(prefix)


def test_sections_comments_and_extras_are_read_as_importlib_reads_them(tmp_path: Path, path: list[str]) -> None:
    text = "# none\n[other]\na = b:c\n\n[xitl.a]\n# x = y:z\n one=m.n:O.p [extra]\r\ntwo =m\n[xitl.b]\nthree = m:N\n"
    path.append(write(tmp_path, described("xitl-some.thing", "1.0", text)))
    assert rows() == rows_of_library()
    assert [row[1] for row in rows()] == ["one", "two", "three"]


def test_the_first_of_two_versions_on_the_path_counts(tmp_path: Path, path: list[str]) -> None:
    for version, entries in (("2.0", "[xitl.nodes]\nnew = m:N\n"), ("1.0", "[xitl.nodes]\nold = m:N\n")):
        path.append(write(tmp_path / version, described("Xitl-Thing", version, entries)))
    assert rows() == rows_of_library() == [("xitl.nodes", "new", "m:N", "Xitl-Thing", "2.0")]


def test_a_first_version_without_entry_points_hides_those_of_the_second(tmp_path: Path, path: list[str]) -> None:
    path.append(write(tmp_path / "a", described("xitl-thing", "2.0", "")))
    path.append(write(tmp_path / "b", described("xitl-thing", "1.0", "[xitl.nodes]\nold = m:N\n")))
    assert rows() == rows_of_library() == []


def test_a_package_in_development_has_an_egg_info_folder(tmp_path: Path, path: list[str]) -> None:
    files = {"PKG-INFO": b"Name: xitl-thing\nVersion: 3\n", "entry_points.txt": b"[xitl.nodes]\nthing = m:N\n"}
    path.append(write(tmp_path / "xitl_thing.egg-info", files) and str(tmp_path))
    assert rows() == rows_of_library() == [("xitl.nodes", "thing", "m:N", "xitl-thing", "3")]


def test_a_zip_file_on_the_path_has_entry_points_too(tmp_path: Path, path: list[str]) -> None:
    with zipfile.ZipFile(tmp_path / "things.zip", "w") as archive:
        for name, content in described("xitl-thing", "1.0", "[xitl.nodes]\nthing = m:N\n").items():
            archive.writestr(name, content)
    path.append(str(tmp_path / "things.zip"))
    assert rows() == rows_of_library() == [("xitl.nodes", "thing", "m:N", "xitl-thing", "1.0")]


@pytest.mark.parametrize("other", ["a folder", "a zip file"])
def test_a_damaged_package_hides_no_other(tmp_path: Path, path: list[str], other: str) -> None:
    path.append(write(tmp_path / "a", described("xitl-a", "1.0", "[xitl.nodes]\nno target\n= m:N\n")))
    path.append(write(tmp_path / "b", {"xitl_b-1.0.dist-info/entry_points.txt": b"[xitl.nodes]\n\xff = m:N\n"}))
    path.append(write(tmp_path / "c", {"xitl_c-1.0.dist-info/entry_points.txt": b"[xitl.nodes]\nc = m:N\n"}))
    path.append(write(tmp_path / "d", described("xitl-d", "1.0", "[xitl.nodes]\nd = m:N\n")))
    path.append(str(tmp_path / "missing"))
    if other == "a zip file":
        with zipfile.ZipFile(tmp_path / "empty.zip", "w"):
            path.append(str(tmp_path / "empty.zip"))
    assert ("xitl.nodes", "c", "m:N", "unknown", "?") in rows()
    assert ("xitl.nodes", "d", "m:N", "xitl-d", "1.0") in rows()
    broken = [entry for entry in entry_points("xitl.") if entry.package == "xitl-a"]
    assert [(entry.name, entry.target) for entry in broken] == [("no target", ""), ("", "m:N")]
    with pytest.raises(ValueError, match="is not module:object"):
        broken[0].load()


def test_an_object_inside_of_another_is_loaded(tmp_path: Path, path: list[str]) -> None:
    path.append(write(tmp_path, described("xitl-a", "1.0", "[xitl.nodes]\njoin = os:path.join\nos = os [extra]\n")))
    assert [entry.load() for entry in entry_points("xitl.")] == [os.path.join, os]


def test_an_ordinary_installation_is_read_without_importlib_metadata() -> None:
    program = (
        "import sys\nfrom xitl_cli.registry import COMMANDS, names\n"
        "assert 'logs' in names(COMMANDS)\nprint('importlib.metadata' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
