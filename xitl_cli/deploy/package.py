"""`xitl-agent.pyz`: the agent in one file for any Python 3.9 or newer, with the packages for serial and CAN links."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import agent
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError

BOARD_PYTHON = "3.9"
SHEBANG = b"#!/usr/bin/env python3\n"
START = '''\
"""Entry of xitl-agent.pyz. An older Python can read this file and prints an error."""

import sys

if sys.version_info < (3, 9):
    sys.exit("error: xitl-agent.pyz needs Python 3.9 or newer, this is %s" % sys.version.split()[0])

from agent.board.startup import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "xitl-agent.pyz"))
'''
_NEEDED = {
    "pyserial": "serial:// links",
    "python-can": "can:// links",
    "packaging": "can:// links",
    "typing_extensions": "can:// links",
    "wrapt": "can:// links",
}
_WHERE_INSTALLED = {"msgpack": "can://udp_multicast links"}
_LEFT_OUT = {"test", "tests", "serial/tools/miniterm.py"}
_EPOCH = (1980, 1, 1, 0, 0, 0)
_FILE_MODE = 0o100644


@dataclass(frozen=True, slots=True)
class Package:
    """The finished archive."""

    data: bytes
    sha256: str
    parts: tuple[str, ...]
    """Included packages, "name version" each."""
    notes: tuple[str, ...]
    """Sentences for the user."""


def build() -> Package:
    """Build the archive: the same versions give the same bytes. Raises UserError when a part is not installed."""
    from packaging.specifiers import SpecifierSet

    files: dict[str, bytes] = {"__main__.py": START.encode()}
    files.update(_own_files())
    parts, notes = [f"xitl agent {agent.__version__}"], []
    for name, purpose in {**_NEEDED, **_WHERE_INSTALLED}.items():
        package = _installed(name, purpose, optional=name in _WHERE_INSTALLED)
        if package is None:
            continue
        files.update(_files_of(package, name))
        parts.append(f"{name} {package.version}")
        required = package.metadata["Requires-Python"]
        if not SpecifierSet(required or "").contains(BOARD_PYTHON):
            notes.append(f"{purpose} need Python {required} on the board, because of {name} {package.version}")
    archive = io.BytesIO()
    archive.write(SHEBANG)
    with zipfile.ZipFile(archive, "a", zipfile.ZIP_DEFLATED, compresslevel=9) as entries:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3
            entry.external_attr = _FILE_MODE << 16
            entries.writestr(entry, files[name], compresslevel=9)
    data = archive.getvalue()
    return Package(data, hashlib.sha256(data).hexdigest(), tuple(parts), tuple(notes))


def _own_files() -> Iterator[tuple[str, bytes]]:
    root = Path(agent.__file__).parent
    for path in root.rglob("*.py"):
        yield f"agent/{path.relative_to(root).as_posix()}", path.read_bytes()
    licence = root.parent / "LICENSE"
    if licence.is_file():
        yield "licences/xitl/LICENSE", licence.read_bytes()
        return
    own = _installed("xitl", "the agent", optional=True)
    if own is not None:
        yield from ((name, data) for name, data in _files_of(own, "xitl") if name.endswith("/LICENSE"))


def _installed(name: str, purpose: str, optional: bool) -> Distribution | None:
    try:
        return distribution(name)
    except PackageNotFoundError:
        if optional:
            return None
        raise UserError(
            f"{name} is not installed, and the agent needs it for {purpose}; install it with: pip install {name}"
        ) from None


def _files_of(package: Distribution, name: str) -> Iterator[tuple[str, bytes]]:
    """Yield the package's pure Python modules, and its licence and description under `licences/`."""
    modules = 0
    for path in package.files or ():
        parts = path.parts
        if ".." in parts or path.as_posix() in _LEFT_OUT or _LEFT_OUT.intersection(parts):
            continue
        if parts[0].endswith(".dist-info"):
            if path.name == "METADATA" or path.name.upper().startswith(("LICENSE", "COPYING", "NOTICE", "AUTHORS")):
                yield f"licences/{name}/{path.name}", Path(str(package.locate_file(path))).read_bytes()
        elif path.suffix == ".py":
            modules += 1
            yield path.as_posix(), Path(str(package.locate_file(path))).read_bytes()
    if not modules and name != "xitl":
        raise UserError(
            f"{name}: its Python files cannot be found in this environment; install it again with: "
            f"pip install --force-reinstall {name}"
        )
