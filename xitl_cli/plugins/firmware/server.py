"""Layout of ArduPilot's firmware server: BASE/Rover/VERSION/BOARD/ holds the file and two text files about it.

VERSION is `stable`, `beta`, `latest` (built from the development branch) or `stable-4.6.3` for each release. BOARD is
the name of the build; the simulator for a PC is SITL_x86_64_linux_gnu, for 32-bit ARM SITL_arm_linux_gnueabihf.
firmware-version.txt holds `4.6.3-FIRMWARE_VERSION_TYPE_OFFICIAL`, git-version.txt the commit. Folders list their
contents as links. Sources: the scripts that fill the server, Tools/scripts/build_binaries.py and gen_stable.py.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from difflib import get_close_matches
from urllib.parse import quote, unquote, urljoin, urlsplit

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.firmware.cache import PROGRAMS, SITL, SITL_ARMHF

BASE = "https://firmware.ardupilot.org"
MOVING_VERSIONS = ("stable", "beta", "latest")
_FOLDERS = {"rover": "Rover", "plane": "Plane", "copter": "Copter", "sub": "Sub"}
_BUILDS = {SITL: "SITL_x86_64_linux_gnu", SITL_ARMHF: "SITL_arm_linux_gnueabihf"}
_NUMBERS = re.compile(r"(\d+)\.(\d+)(?:\.(\d+|x))?")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,63}")
_LINK = re.compile(r"""<a\s[^>]*?href\s*=\s*["']([^"']+)["']""", re.IGNORECASE)
_RELEASE = re.compile(r"stable-(\d+\.\d+\.\d+)")
_COMMIT = re.compile(r"^commit ([0-9a-f]{8,40})\b", re.MULTILINE)
_VERSION = re.compile(r"(\d+\.\d+\.\d+)-(?:FIRMWARE_VERSION_TYPE_)?(\w+)")

ReadText = Callable[[str], str | None]
"""Reads the text at a URL; None if the server has none."""


@dataclass(frozen=True, slots=True)
class FirmwareFolder:
    """A folder of the server with one firmware. `version` is one of MOVING_VERSIONS or three numbers."""

    base: str
    vehicle: str
    version: str
    board: str

    @property
    def url(self) -> str:
        """URL with a slash at the end."""
        version = self.version if self.version in MOVING_VERSIONS else f"stable-{self.version}"
        return f"{_top(self.base, self.vehicle)}{version}/{quote(_BUILDS.get(self.board, self.board), safe='')}/"


@dataclass(frozen=True, slots=True)
class PublishedVersion:
    """The server's information about a firmware; empty if unknown. `git` is the whole commit."""

    version: str = ""
    git: str = ""


def find_folder(base: str, vehicle: str, version: str, board: str, read_text: ReadText) -> FirmwareFolder:
    """Return the folder of a firmware. Asks the server for the newest release of `4.6` or `4.6.x`. Raises UserError."""
    if vehicle not in PROGRAMS:
        raise UserError(f"{vehicle}: is not a vehicle with firmware; use one of {', '.join(PROGRAMS)}")
    if not _NAME.fullmatch(board):
        raise UserError(f"{board}: is not a name of a board; use {SITL}, {SITL_ARMHF} or a folder of {base}")
    return FirmwareFolder(base.rstrip("/"), vehicle, _version(base, vehicle, version, read_text), board)


def is_release(version: str) -> bool:
    """Return True for a release number of three numbers."""
    numbers = _NUMBERS.fullmatch(version)
    return numbers is not None and numbers[3] not in (None, "x")


def published_version(folder: FirmwareFolder, read_text: ReadText) -> PublishedVersion:
    """Read the two text files. Raises UnreachableError."""
    version, git = (read_text(folder.url + name) or "" for name in ("firmware-version.txt", "git-version.txt"))
    numbers, commit = _VERSION.match(version.strip()), _COMMIT.search(git)
    named = "" if numbers is None else f"{numbers[1]} {numbers[2].lower()}"
    return PublishedVersion(named, "" if commit is None else commit[1])


def list_releases(base: str, vehicle: str, read_text: ReadText) -> list[str]:
    """Return all numbered releases, the newest first; empty if the server has no list. Raises UnreachableError."""
    releases = {release[1] for name in _listed(_top(base, vehicle), read_text) if (release := _RELEASE.fullmatch(name))}
    return sorted(releases, key=lambda release: [int(part) for part in release.split(".")], reverse=True)


def not_found(folder: FirmwareFolder, read_text: ReadText) -> UserError:
    """Return the error for a missing firmware: the wrong part of its address, and the available alternatives."""
    where = f"{folder.vehicle} {folder.version} for {folder.board}"
    above = folder.url.rstrip("/").rpartition("/")[0] + "/"
    boards = _listed(above, read_text)
    if boards:
        known = [*_BUILDS, *boards] if any(name in boards for name in _BUILDS.values()) else boards
        near = (
            get_close_matches(folder.board, known, 3, 0.5) or [name for name in known if name in _BUILDS] or known[:3]
        )
        return UserError(f"{where}: {above} has no such board; use one of its folders, for example {', '.join(near)}")
    numbered = list_releases(folder.base, folder.vehicle, read_text)
    if numbered and folder.version not in MOVING_VERSIONS and folder.version not in numbered:
        return UserError(
            f"{where}: there is no such release; use {', '.join(numbered[:4])} or one of {', '.join(MOVING_VERSIONS)}"
        )
    return UserError(f"{where}: {folder.url} does not exist; check --version, --board and --url, or see {folder.base}")


def _version(base: str, vehicle: str, version: str, read_text: ReadText) -> str:
    if version in MOVING_VERSIONS:
        return version
    numbers = _NUMBERS.fullmatch(version.removeprefix("stable-").removeprefix("v"))
    if numbers is None:
        raise UserError(f"{version}: is not a version; use {', '.join(MOVING_VERSIONS)} or numbers like 4.6.3 or 4.6")
    major, minor, patch = numbers.groups()
    if patch not in (None, "x"):
        return f"{major}.{minor}.{patch}"
    releases = list_releases(base, vehicle, read_text)
    for release in releases:
        if release.startswith(f"{major}.{minor}."):
            return release
    fix = f"the newest are {', '.join(releases[:4])}" if releases else f"{base} lists none; write all three numbers"
    raise UserError(f"{version}: is not a release of {vehicle}; {fix}")


def _top(base: str, vehicle: str) -> str:
    return f"{base.rstrip('/')}/{_FOLDERS[vehicle]}/"


def _listed(url: str, read_text: ReadText) -> list[str]:
    """Return the names in a folder, in the order of the page: links one step below it, in any notation."""
    page = read_text(url)
    below = urlsplit(url).path
    names: dict[str, None] = {}
    for link in _LINK.findall(page or ""):
        try:
            path = urlsplit(urljoin(url, link)).path.rstrip("/")
        except ValueError:  # such as of `//[`
            continue
        name = unquote(path.removeprefix(below))
        if path.startswith(below) and _NAME.fullmatch(name):
            names[name] = None
    return list(names)
