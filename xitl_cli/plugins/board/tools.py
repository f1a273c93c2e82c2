"""Programs of this machine that make and run boards: a check for missing ones, and a function that runs one."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from xitl_cli.errors import UserError

FOR_RUNNING = {"qemu-system-arm": "qemu-system-arm", "ssh": "openssh-client"}
"""Programs by name, with the Debian package of each."""
FOR_MAKING = {
    **FOR_RUNNING,
    "apt-get": "apt",
    "dpkg-deb": "dpkg",
    "fakeroot": "fakeroot",
    "mke2fs": "e2fsprogs",
    "qemu-img": "qemu-utils",
    "ssh-keygen": "openssh-client",
    "tar": "tar",
}
FOR_NAMESPACE = {"ip": "iproute2", "nsenter": "util-linux", "setpriv": "util-linux", "unshare": "util-linux"}
_ALSO = "/usr/sbin:/sbin"  # folders that only root's PATH contains
_LAST_LINES = 3


def require(programs: dict[str, str], feature: str = "an emulated board") -> None:
    """Raise UserError with the packages of all missing programs. feature: it needs them."""
    missing = {name: package for name, package in programs.items() if find_program(name) is None}
    if missing:
        *others, last = sorted(missing)
        names = f"{', '.join(others)} and {last}" if others else last
        raise UserError(
            f"{feature} needs {names}, which this machine does not have; install it, on Debian or Ubuntu: "
            f"apt install {' '.join(sorted(set(missing.values())))}"
        )


def find_program(name: str) -> str | None:
    """Return the path of a program, also from root's PATH."""
    return shutil.which(name) or shutil.which(name, path=_ALSO)


def checked_run(
    command: Sequence[str], failure: str, todo: str, cwd: Path | None = None, timeout_s: float | None = None
) -> str:
    """Return its standard output. Raises UserError with the sentence `failure`, its last lines, and the fix `todo`."""
    words = [find_program(command[0]) or command[0], *command[1:]]
    try:
        done = subprocess.run(
            words, cwd=cwd, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace",
            timeout=timeout_s, check=False,
        )  # fmt: skip
    except FileNotFoundError:
        raise UserError(f"{failure}: there is no {command[0]} on this machine; {todo}") from None
    except subprocess.TimeoutExpired:
        raise UserError(f"{failure}: {command[0]} did not end within {timeout_s:.0f} s; {todo}") from None
    if done.returncode:
        raise UserError(
            f"{failure} ({last_words(done.stderr or done.stdout) or f'exit code {done.returncode}'}); {todo}"
        )
    return done.stdout


def last_words(text: str) -> str:
    """Return the last lines of a program's output in one line."""
    return " / ".join([line.strip() for line in text.splitlines() if line.strip()][-_LAST_LINES:])
