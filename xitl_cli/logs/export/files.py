"""Output files: names, and atomic writing."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from xitl_cli.logs.model.errors import LogError

_LONGEST_FILE_NAME = 120


def refuse_present(paths: Collection[Path], overwrite: bool) -> None:
    """Check before writing that no file would be replaced. Raises LogError."""
    for path in paths:
        if path.is_dir():
            raise LogError(f"{path}: is a directory; choose another path with --out")
        if path.exists() and not path.is_file():  # a device would be replaced by a file
            raise LogError(f"{path}: is not a regular file; choose another path with --out")
        if not overwrite and path.exists():
            raise LogError(f"{path}: already exists; choose another path with --out, or add --overwrite")


def make_directory(path: Path) -> None:
    """Make a directory and its parents. Raises LogError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise LogError(f"{path}: is not a directory; choose another path with --out") from error
    except OSError as error:
        raise _refusal(path, error) from error


@contextmanager
def part_of(final: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary path next to `final`. At the end the file is renamed to `final`, or removed after an error.

    Raises LogError if the directory is not writable, if the disk is full, or if `final` was created meanwhile.
    """
    target = Path(os.path.realpath(final)) if overwrite else final  # the target of a link, not the link
    part = target.with_name(f".{target.name[:200]}.{os.getpid()}.part")
    try:
        yield part
        with part.open("rb") as written:
            os.fsync(written.fileno())
        if overwrite:
            part.replace(target)
        else:
            _named_if_free(part, final)
    except OSError as error:
        raise _refusal(final, error) from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _named_if_free(part: Path, final: Path) -> None:
    try:
        os.link(part, final)
    except FileExistsError as error:
        raise LogError(f"{final}: already exists; choose another path with --out, or add --overwrite") from error
    except OSError:  # a file system without links
        refuse_present([final], overwrite=False)
        part.replace(final)


def _refusal(path: Path, error: OSError) -> LogError:
    return LogError(
        f"{path}: cannot be written ({error.strerror or error}); free space or choose another path with --out"
    )


def file_names(messages: Iterable[str], reserved: Iterable[str] = ()) -> dict[str, str]:
    """File names without ending: "/link/agent/rx:ATTITUDE" → "link_agent_rx_ATTITUDE". Unique regardless of case."""

    def named(message: str) -> str:
        return re.sub(r"[^A-Za-z0-9_.-]+", "_", message).strip("._")[:_LONGEST_FILE_NAME]

    return unique_names(messages, named, reserved=reserved)


def unique_names(
    names: Iterable[str], named: Callable[[str], str], joined: str = "_", reserved: Iterable[str] = ()
) -> dict[str, str]:
    """`named(name)` by name. A number behind the name makes it unique, regardless of case."""
    taken = set(reserved)
    result: dict[str, str] = {}
    for name in names:
        base = named(name) or "message"
        made, number = base, 2
        while made.casefold() in taken:
            made, number = f"{base}{joined}{number}", number + 1
        taken.add(made.casefold())
        result[name] = made
    return result
