"""Finds the file of a profile by its path or by the name of a shipped one."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from xitl_cli.errors import UserError
from xitl_cli.paths import user_path
from xitl_cli.registry import PROFILES, load_all
from xitl_cli.shipped import profiles_dir

SUFFIXES = (".yaml", ".yml")
PROFILE = "profile.yaml"


def shipped_profiles() -> dict[str, Path]:
    """Return every shipped profile by its name (`sitl`, `environments/calm`), sorted: the runnable top ones first.

    Profiles of plug-ins follow. They cannot replace a name that xitl ships.
    """
    return dict(each_shipped_profile())


def each_shipped_profile() -> Iterator[tuple[str, Path]]:
    """Yield the items of `shipped_profiles`. Plug-ins are loaded only when those that xitl ships are exhausted."""
    names: set[str] = set()
    for root in _roots():
        added = {name: path for name, path in _profiles_below(root).items() if name not in names}
        yield from added.items()
        names |= set(added)


def is_shipped(name: str) -> bool:
    """Return whether `name` is one of `shipped_profiles`. Plug-ins are loaded only for a name that xitl lacks."""
    return any(name in _profiles_below(root) for root in _roots())


def _roots() -> Iterator[Path]:
    """Yield the folders of profiles: those of xitl, then those of plug-ins, loaded as they are needed."""
    yield profiles_dir()
    for _, folder in load_all(PROFILES):
        yield Path(folder)


@cache
def _profiles_below(root: Path) -> dict[str, Path]:
    """Return the profiles below a folder.

    The result is cached: shipped files do not change, and extended profiles use it too.
    """
    names = {path.relative_to(root).with_suffix("").as_posix(): path for path in root.rglob("*.yaml")}
    return dict(sorted(names.items(), key=lambda item: (item[0].count("/"), item[0])))


def find_profile(name: str, beside: Path | None = None) -> Path:
    """Return the file of the profile `name`.

    A name that ends in .yaml is a path, relative to the folder `beside` (default: the working directory). Any other
    name is a shipped profile, by its full name or its last part if that is unique. Otherwise it is the path of a file,
    or of a folder with a profile.yaml, as `xitl init` and a run create. Raises UserError with suggestions.
    """
    path = (beside or Path()) / user_path(name)
    if name.endswith(SUFFIXES):
        if not _is_file(path):
            problem = "does not exist"
            if os.path.exists(path):  # noqa: PTH110 - never raises
                problem = "is a folder" if os.path.isdir(path) else "is not a regular file"  # noqa: PTH112 - never raises
            raise UserError(
                f"{shown_path(path)} {problem}; check the path, or name a shipped profile (`xitl profiles list`)"
            )
        return path
    for root in _roots():
        if name in _profiles_below(root):
            return _profiles_below(root)[name]
    shipped = shipped_profiles()
    same = [full for full in shipped if full.rsplit("/", 1)[-1] == name]
    if len(same) == 1:
        return shipped[same[0]]
    if same:
        raise UserError(f"{name!r} matches {len(same)} profiles; write {' or '.join(same)}")
    if _is_file(path):
        return path
    if _is_file(path / PROFILE):
        return path / PROFILE
    last_parts = {full.rsplit("/", 1)[-1]: full for full in shipped}
    close = difflib.get_close_matches(name, shipped, n=2)
    close += [last_parts[part] for part in difflib.get_close_matches(name.rsplit("/", 1)[-1], last_parts, n=2)]
    close = list(dict.fromkeys(close))[:3]
    hint = f" did you mean {' or '.join(map(repr, close))}?" if close else ""
    raise UserError(f"there is no profile {name!r};{hint} `xitl profiles list` shows all")


def profile_name(path: Path) -> str:
    """Return a name for the profile at `path`: the shipped name, or the file's stem."""
    for root in _roots():
        try:
            return path.resolve().relative_to(root.resolve()).with_suffix("").as_posix()
        except ValueError:
            continue
    return path.stem


def shown_path(path: Path) -> str:
    """Return `path` as errors show it: relative if it is in the working directory."""
    absolute = Path(os.path.abspath(path))  # noqa: PTH100 - resolve() would replace links in the user's path
    try:
        return str(absolute.relative_to(Path.cwd()))
    except (ValueError, OSError):
        return str(absolute)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # not a valid file name: too long, or with a null byte
        return False
