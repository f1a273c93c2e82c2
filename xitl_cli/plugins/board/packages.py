"""Debian's packages for another processor, fetched by apt with a private package database and lists.

Nothing is installed on this machine, and no root is needed. Downloaded packages are kept, and an interrupted download
continues.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from xitl_cli.errors import UserError
from xitl_cli.plugins.board import recipe
from xitl_cli.plugins.board.tools import checked_run

KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
LONGEST_S = 900.0
_OTHER = "set a Debian mirror with --mirror URL"
_KERNEL = re.compile(r"Depends: (linux-image-\S+)")


@dataclass(frozen=True, slots=True)
class FetchedPackages:
    """Archives on this machine: packages to install, the kernel's, and the shell for the time before the disk is
    mounted.
    """

    installed: tuple[Path, ...]
    kernel: Path
    busybox: Path


def fetch(suite: str, mirror: str | None, work: Path) -> FetchedPackages:
    """Fetch the packages of an image of `suite` to the folder `work`, from `mirror` or from apt's mirror. Raises
    UserError.
    """
    if not KEYRING.is_file():
        raise UserError(f"{KEYRING}: missing, with Debian's keys; install it: apt install debian-archive-keyring")
    if mirror is None:
        targets = ["indextargets", "--no-release-info", "--format", "$(REPO_URI)", "Created-By: Packages"]
        lines = checked_run(["apt-get", *targets], "apt does not list its mirrors", _OTHER).splitlines()
        mirror = next((line.strip() for line in lines if line.rstrip("/").endswith("/debian")), None)
        if mirror is None:
            raise UserError(f"apt has no Debian mirror here (an address that ends in /debian); {_OTHER}")
    apt = _Apt(work, suite, mirror)
    apt.update()
    return FetchedPackages(apt.fetch_all(recipe.packages_of(suite)), apt.fetch_kernel(), apt.fetch_one(recipe.BUSYBOX))


class _Apt:
    """apt-get with a private configuration under a folder."""

    def __init__(self, work: Path, suite: str, mirror: str) -> None:
        for folder in ("lists/partial", "archives/partial", "etc/preferences.d"):
            (work / folder).mkdir(parents=True, exist_ok=True)
        self._sources = work / "sources.list"
        self._sources.write_text(f"deb [signed-by={KEYRING}] {mirror} {suite} main\n", encoding="utf-8")
        (work / "status").write_text("", encoding="utf-8")
        self._archives = work / "archives"
        self._suite = suite
        self._empty = work / "empty" / "partial"
        settings = {
            "Dir::State": work,
            "Dir::State::lists": work / "lists",
            "Dir::State::status": work / "status",
            "Dir::Cache": work,
            "Dir::Cache::archives": self._archives,
            "Dir::Etc": work / "etc",
            "Dir::Etc::sourcelist": self._sources,
            "Dir::Etc::sourceparts": "-",
            "APT::Architecture": recipe.ARCHITECTURE,
            "APT::Architectures": recipe.ARCHITECTURE,
            "APT::Sandbox::User": "",
            "APT::Install-Recommends": "false",
            "APT::Update::Error-Mode": "any",
            "Acquire::Languages": "none",
            "Acquire::Check-Valid-Until": "false",
            "Acquire::Retries": "3",
        }
        self._options = [word for name, value in settings.items() for word in ("-o", f"{name}={value}")]

    def update(self) -> None:
        self._get(["update"], "the list of its packages cannot be fetched")

    def fetch_all(self, packages: tuple[str, ...]) -> tuple[Path, ...]:
        """Fetch the essential packages, these, and all their dependencies."""
        wanted = ["install", "--yes", "--download-only", "?essential", *packages]
        self._get(wanted, "its packages cannot be fetched")
        self._empty.mkdir(parents=True, exist_ok=True)
        output = self._get(
            [*wanted, "--print-uris", "-o", f"Dir::Cache::archives={self._empty.parent}"], "cannot be listed"
        )
        names = re.findall(r"^'[^']*' (\S+\.deb) ", output, re.MULTILINE)
        return tuple(sorted(self._archives / name for name in names))

    def fetch_kernel(self) -> Path:
        output = checked_run(
            ["apt-cache", *self._options, "depends", recipe.KERNEL], "the kernel's package does not exist", _OTHER
        )
        named = _KERNEL.search(output)
        if named is None:
            raise UserError(
                f"Debian {self._suite}: has no {recipe.KERNEL} at this mirror; use another mirror with --mirror URL"
            )
        return self.fetch_one(named[1])

    def fetch_one(self, package: str) -> Path:
        """Fetch one package without its dependencies."""
        output = self._get(["download", "--print-uris", package], "does not exist")
        named = re.search(r"^'[^']*' (\S+\.deb) ", output, re.MULTILINE)
        if named is None:
            raise UserError(f"Debian {self._suite}: has no package {package} for {recipe.ARCHITECTURE} at this mirror")
        file = self._archives / named[1]
        if not file.is_file():
            self._get(["download", package], "cannot be fetched", cwd=self._archives)
        return file

    def _get(self, arguments: list[str], failure: str, cwd: Path | None = None) -> str:
        return checked_run(
            ["apt-get", "-q", *self._options, *arguments],
            f"Debian {self._suite}: {failure}",
            "check the network, or use another mirror with --mirror URL; completed downloads are kept",
            cwd=cwd,
            timeout_s=LONGEST_S,
        )
