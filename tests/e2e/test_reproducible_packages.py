"""Wheel, sdist and zipapp are the same bytes wherever, whenever and by whom they are built.

The two builds differ in folder, times and permissions of the files, umask, time zone, language and hash seed.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OTHER = {"TZ": "Pacific/Chatham", "LC_ALL": "C", "PYTHONHASHSEED": "4711"}
UNUSUAL_S = 1_000_000_000.0
pytestmark = [
    pytest.mark.slow,
    pytest.mark.nightly,
    pytest.mark.skipif(find_spec("hatchling") is None, reason="needs hatchling: pip install 'xitl[test]'"),
]


def tree(folder: Path, unusual: bool = False) -> Path:
    """Copy the files of the project that git knows. unusual: with old times, and closed to others."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.decode()
    for name in filter(None, names.split("\0")):
        copy = folder / name
        if (ROOT / name).exists():
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, copy)
            shutil.copymode(ROOT / name, copy)
    if unusual:
        for path in folder.rglob("*"):
            path.chmod(path.stat().st_mode & 0o700)
            os.utime(path, (UNUSUAL_S, UNUSUAL_S))
    return folder


def build(folder: Path, out: Path, *targets: str, environment: dict[str, str] | None = None) -> dict[str, bytes]:
    """Build with hatchling in a process with a usual or, with another environment, a strict umask."""
    subprocess.run(
        [
            sys.executable,
            "-m",
            "hatchling",
            "build",
            "-d",
            str(out),
            *(word for name in targets for word in ("-t", name)),
        ],
        cwd=folder,
        env={**{key: value for key, value in os.environ.items() if key != "SOURCE_DATE_EPOCH"}, **(environment or {})},
        umask=0o077 if environment else 0o022,
        check=True,
        capture_output=True,
    )
    return {path.name: path.read_bytes() for path in sorted(out.iterdir())}


def digests(files: dict[str, bytes]) -> dict[str, str]:
    return {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}


@pytest.fixture(scope="module")
def trees(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("trees")
    return tree(folder / "one"), tree(folder / "elsewhere" / "another tree", unusual=True)


def test_wheel_and_sdist_are_the_same_bytes_twice(trees: tuple[Path, Path], tmp_path: Path) -> None:
    here = build(trees[0], tmp_path / "here", "sdist", "wheel")
    there = build(trees[1], tmp_path / "there", "sdist", "wheel", environment=OTHER)
    assert [Path(name).suffix for name in here] == [".whl", ".gz"]
    assert digests(here) == digests(there)
    sdist = next(path for path in (tmp_path / "here").iterdir() if path.suffix == ".gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    from_sdist = build(tmp_path / sdist.name.removesuffix(".tar.gz"), tmp_path / "from sdist", "wheel")
    assert digests(from_sdist).items() <= digests(here).items()


def test_the_date_of_the_sources_is_in_the_wheel_when_it_is_stated(trees: tuple[Path, Path], tmp_path: Path) -> None:
    dated = {"SOURCE_DATE_EPOCH": "1700000000"}
    here = build(trees[0], tmp_path / "here", "wheel", environment=dated)
    there = build(trees[1], tmp_path / "there", "wheel", environment=OTHER | dated)
    assert digests(here) == digests(there)
    import zipfile

    (name,) = here
    with zipfile.ZipFile(tmp_path / "here" / name) as wheel:
        assert {entry.date_time for entry in wheel.infolist()} == {(2023, 11, 14, 22, 13, 20)}


def test_the_zipapp_is_the_same_bytes_twice(trees: tuple[Path, Path], tmp_path: Path) -> None:
    archives = []
    for number, (folder, other) in enumerate(zip(trees, ({}, OTHER), strict=True)):
        place = tmp_path / str(number)
        place.mkdir()
        words = [sys.executable, "-m", "xitl_cli.main", "agent", "package"]
        environment = {**os.environ, "PYTHONPATH": str(folder), **other}
        subprocess.run(
            words, cwd=place, env=environment, umask=0o077 if other else 0o022, check=True, capture_output=True
        )
        archives.append((place / "xitl-agent.pyz").read_bytes())
    assert hashlib.sha256(archives[0]).hexdigest() == hashlib.sha256(archives[1]).hexdigest()
