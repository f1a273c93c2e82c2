"""What is in the archive of the agent, from installed packages that are made for the test."""

from __future__ import annotations

import hashlib
import io
import shutil
import sys
import zipfile
from importlib.metadata import PackageNotFoundError, PathDistribution
from pathlib import Path

import pytest

import agent
from xitl_cli.deploy import package as packaging
from xitl_cli.errors import UserError

NEEDED = ("pyserial", "python-can", "packaging", "typing_extensions", "wrapt")


def install(site: Path, name: str, files: dict[str, str], requires: str | None = None, version: str = "1.2") -> None:
    """Write a package as pip leaves it."""
    info = f"{name.replace('-', '_')}-{version}.dist-info"
    line = f"Requires-Python: {requires}\n" if requires else ""
    files = {
        **files,
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{line}",
        f"{info}/licenses/LICENSE.txt": f"licence of {name}",
        f"{info}/COPYING": "copy",
        f"{info}/entry_points.txt": "",
    }
    for path, text in files.items():
        (site / path).parent.mkdir(parents=True, exist_ok=True)
        (site / path).write_text(text)
    record = "".join(f"{path},,\n" for path in (*files, "../../bin/tool.py", f"{info}/RECORD"))
    (site / info / "RECORD").write_text(record)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder in which all needed packages are installed."""

    def distribution(name: str) -> PathDistribution:
        found = list(tmp_path.glob(f"{name.replace('-', '_')}-*.dist-info"))
        if not found:
            raise PackageNotFoundError(name)
        return PathDistribution(found[0])

    monkeypatch.setattr(packaging, "distribution", distribution)
    monkeypatch.setattr(packaging, "_own_files", lambda: {"agent/__init__.py": b"own"}.items())
    for name in NEEDED:
        module = "serial" if name == "pyserial" else name.replace("-", "_")
        install(tmp_path, name, {f"{module}/__init__.py": f"# {name}\n"})
    return tmp_path


def test_modules_and_licences_are_in_and_tests_are_not(site: Path) -> None:
    install(
        site,
        "pyserial",
        {
            "serial/__init__.py": "# serial\n",
            "serial/tools/miniterm.py": "",
            "serial/tools/list_ports.py": "ports",
            "serial/data.bin": "",
            "test/x.py": "",
            "serial/tests/y.py": "",
        },
    )
    made = packaging.build()
    assert made.data.startswith(b"#!/usr/bin/env python3\nPK")
    assert made.sha256 == hashlib.sha256(made.data).hexdigest()
    assert made.parts == (f"xitl agent {agent.__version__}", *(f"{name} 1.2" for name in NEEDED))
    assert made.notes == ()
    with zipfile.ZipFile(io.BytesIO(made.data)) as archive:
        names = archive.namelist()
        assert names == sorted(names)
        of_packages = {f"{name.replace('-', '_')}/__init__.py" for name in NEEDED[1:]}
        licences = {f"licences/{name}/{file}" for name in NEEDED for file in ("METADATA", "LICENSE.txt", "COPYING")}
        own = {"__main__.py", "agent/__init__.py", "serial/__init__.py", "serial/tools/list_ports.py"}
        assert set(names) == own | of_packages | licences
        assert archive.read("agent/__init__.py") == b"own"
        assert archive.read("licences/wrapt/LICENSE.txt") == b"licence of wrapt"
        for entry in archive.infolist():
            assert (entry.date_time, entry.create_system) == ((1980, 1, 1, 0, 0, 0), 3)
            assert entry.external_attr >> 16 == 0o100644
            assert entry.compress_type == zipfile.ZIP_DEFLATED


def test_a_part_that_needs_a_newer_python_is_noted(site: Path) -> None:
    shutil.rmtree(site / "wrapt-1.2.dist-info")
    install(site, "wrapt", {"wrapt/__init__.py": ""}, requires=">=3.10", version="2.0")
    install(site, "packaging", {"packaging/__init__.py": ""}, requires=">=3.9")
    assert packaging.build().notes == ("can:// links need Python >=3.10 on the board, because of wrapt 2.0",)


def test_what_is_installed_goes_along_and_what_is_needed_must_be_there(
    site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "msgpack 1.0" not in packaging.build().parts
    install(site, "msgpack", {"msgpack/__init__.py": ""}, version="1.0")
    assert packaging.build().parts[-1] == "msgpack 1.0"
    install(site, "python-can", {"can/data.bin": ""})
    (site / "python_can-1.2.dist-info/RECORD").write_text("can/data.bin,,\n")
    with pytest.raises(
        UserError, match=r"^python-can: its Python files cannot be found .* --force-reinstall python-can"
    ):
        packaging.build()
    monkeypatch.setattr(packaging, "_NEEDED", {"none-such": "serial:// links"})
    with pytest.raises(
        UserError, match=r"^none-such is not installed, .* for serial:// links; .*pip install none-such"
    ):
        packaging.build()


def test_the_agents_own_files_and_licence() -> None:
    root = Path(agent.__file__).parents[1]
    own = dict(packaging._own_files())
    assert own["agent/node.py"] == (root / "agent/node.py").read_bytes()
    assert own["licences/xitl/LICENSE"] == (root / "LICENSE").read_bytes()
    assert {f"agent/{path.relative_to(root / 'agent').as_posix()}" for path in (root / "agent").rglob("*.py")} == {
        name for name in own if not name.startswith("licences/")
    }


def test_the_archive_refuses_an_older_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 8, 9))
    with pytest.raises(SystemExit, match=r"needs Python 3\.9 or newer, this is 3\."):
        exec(packaging.START, {"__name__": "started"})
