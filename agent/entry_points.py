"""Entry points of installed packages, read from their `entry_points.txt`: on the host, and on a board.

`importlib.metadata` gives the same answer, but its import and its scan take a seventh of the start of `xitl`. It is
used only where packages are not folders: in zip files, in eggs and with importers of other packages.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any, Callable

INTERFACE = 1
"""Version of the interface between xitl and plug-ins. A plug-in module may state its own as `XITL_INTERFACE`."""

OWN_PACKAGE = "xitl"

_TARGET = re.compile(r"(?P<module>[\w.]+)\s*(?::\s*(?P<object>[\w.]+)\s*)?(?:\[.*\]\s*)?")

_Read = Callable[[str], str]
"""Returns the text of a file that describes a package, empty when it cannot be read."""


@dataclass(frozen=True)
class EntryPoint:
    """An object that an installed package registers under a name in a group."""

    group: str
    name: str
    target: str
    """`module:object`."""
    package: str
    version: str

    @property
    def module(self) -> str:
        """Name of the module. Raises ValueError when the target is not `module:object`."""
        return self._parts()[0]

    def load(self) -> Any:
        """Import and return the object. Raises whatever the import raises."""
        module, names = self._parts()
        value = import_module(module)
        for name in filter(None, names.split(".")):
            value = getattr(value, name)
        return value

    def load_error(self) -> str:
        """Return the reason why the object cannot be loaded, as one sentence; empty when it can."""
        who = f"{self.name}: the plug-in of {self.package} {self.version}"
        again = f"pip install --force-reinstall {self.package}"
        try:
            self.load()
            wanted = getattr(sys.modules[self.module], "XITL_INTERFACE", INTERFACE)
        except (Exception, SystemExit) as problem:  # noqa: BLE001  the code of a plug-in may raise anything when imported
            reason = " ".join(f"{type(problem).__name__}: {problem}".split())
            return f"{who} cannot be loaded ({reason}); correct it, or reinstall it: {again}"
        if wanted != INTERFACE:
            return (
                f"{who} is made for interface {wanted} of xitl, and this is interface {INTERFACE}; "
                "install a version for it"
            )
        return ""

    def _parts(self) -> tuple[str, str]:
        match = _TARGET.fullmatch(self.target)
        if match is None:
            raise ValueError(f"{self.target!r} is not module:object")
        return match["module"], match["object"] or ""


def ranked_entry_points(prefix: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of xitl first, then those of other packages by package and name.

    If two packages register one name in a group, the first counts.
    """
    entries = entry_points(prefix)
    return tuple(sorted(entries, key=lambda entry: (entry.package != OWN_PACKAGE, entry.package, entry.name)))


def entry_points(prefix: str) -> list[EntryPoint]:
    """Return the entry points in groups whose names begin with `prefix`, in the order of `sys.path`.

    If a package is on the path twice, the first counts, as it does for imports.
    """
    known: set[str] = set()
    entries: list[EntryPoint] = []
    finders = [finder for finder in sys.meta_path if hasattr(finder, "find_distributions")]
    beyond_folders = finders != [PathFinder] or any(path.endswith(".egg") or Path(path).is_file() for path in sys.path)
    for package, read in _packages_of_library() if beyond_folders else _packages_in_folders():
        normalized = re.sub(r"[-_.]+", "-", package).lower()
        if normalized in known:
            continue
        if normalized:  # a damaged package may lack its name
            known.add(normalized)
        text = read("entry_points.txt")
        if f"[{prefix}" not in text:
            continue
        metadata = read("METADATA") or read("PKG-INFO")
        name_and_version = _field("Name", metadata) or "unknown", _field("Version", metadata) or "?"
        group = ""
        for line in map(str.strip, text.splitlines()):
            if line.startswith("[") and line.endswith("]"):
                group = line[1:-1]
            elif line and not line.startswith("#") and group.startswith(prefix):
                name, _, target = map(str.strip, line.partition("="))
                entries.append(EntryPoint(group, name, target, *name_and_version))
    return entries


def _packages_of_library() -> Iterator[tuple[str, _Read]]:
    from importlib.metadata import Distribution, distributions

    def text(package: Distribution, file: str) -> str:
        try:
            return package.read_text(file) or ""
        except (OSError, UnicodeDecodeError):
            return ""

    for package in distributions():
        read = partial(text, package)
        yield _field("Name", read("METADATA") or read("PKG-INFO")), read


def _packages_in_folders() -> Iterator[tuple[str, _Read]]:
    def text(folder: str, file: str) -> str:
        try:
            return Path(folder + file).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            return ""

    for folder in dict.fromkeys(sys.path):
        try:
            files = os.listdir(folder or ".")  # noqa: PTH208  half the time of Path
        except OSError:
            continue
        for file in files:
            if file.endswith((".dist-info", ".egg-info")):
                yield file.rpartition(".")[0].partition("-")[0], partial(text, f"{folder or '.'}/{file}/")


def _field(key: str, metadata: str) -> str:
    """Return a field of the head of a METADATA file, empty when it is missing."""
    match = re.search(rf"(?im)^{key}:[ \t]*(.*?)[ \t]*$", metadata.partition("\n\n")[0])
    return match[1] if match else ""
