"""`xitl-agent.pyz install`: install this archive and its settings on this board. `xitl agent deploy` starts it.

                     root                             other user
    archive          /usr/local/bin/xitl-agent.pyz    ~/.local/bin/xitl-agent.pyz
    settings         /etc/xitl/agent.conf             ~/.config/xitl/agent.conf
    logs, storage    /var/lib/xitl                    ~/.local/state/xitl
    service          system service                   user service

DESTDIR is put before all of these paths, as in `make install`. Each file is written under another name and then moved
into place. A second installation changes nothing. The settings are one JSON object, checked before anything is written.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import agent
from agent.board.archive import NotAnArchiveError, compiled, origin, origin_of, own_archive
from agent.board.receive import MARK
from agent.board.service import NAME, ServiceError, Systemd, unit_text

SECRET_FILES = {"link-key": "link.key", "signing-key": "signing.key"}
PLAIN_FILES = {"parameters": "agent.parm"}
FILES = {**SECRET_FILES, **PLAIN_FILES}
"""Options that name a file, and the name of that file on the board."""
_KEY = re.compile(r"[a-z][a-z0-9-]{0,40}")
_LONGEST = 1 << 20


class DeploySettingsError(ValueError):
    """Raised for a wrong setting. The message is one sentence that names the setting and the error."""


@dataclass(frozen=True)
class DeploySettings:
    """Settings of one installation."""

    service: bool
    """Whether to enable and start the unit."""
    options: dict[str, tuple[str, ...]] | None
    """Agent options by long name. A repeatable option has several values. None keeps the existing configuration."""
    files: dict[str, str]
    """File contents by option name."""


def settings_to_json(settings: DeploySettings) -> bytes:
    options = None if settings.options is None else {key: list(values) for key, values in settings.options.items()}
    return json.dumps({"service": settings.service, "options": options, "files": settings.files}).encode()


def settings_from_json(data: bytes) -> DeploySettings:
    """Read the settings. Raises DeploySettingsError."""
    try:
        document: Any = json.loads(data)
    except (ValueError, RecursionError):
        raise DeploySettingsError("the settings are not JSON; use xitl agent deploy of the same version") from None
    if not isinstance(document, dict) or set(document) != {"service", "options", "files"}:
        raise DeploySettingsError(
            "the settings are not service, options and files; use xitl agent deploy of this version"
        )
    service, options, files = document["service"], document["options"], document["files"]
    if not isinstance(service, bool) or not isinstance(files, dict) or not isinstance(options, (dict, type(None))):
        raise DeploySettingsError("the settings have the wrong types; use xitl agent deploy of the same version")
    for key, content in files.items():
        if key not in FILES:
            raise DeploySettingsError(f"{key!r} is not an option that names a file to copy; known: {', '.join(FILES)}")
        if not isinstance(content, str) or len(content) > _LONGEST:
            raise DeploySettingsError(f"{key}: the file is not text or has over {_LONGEST} characters; check the path")
    return DeploySettings(service, None if options is None else checked_options(options), dict(files))


def checked_options(options: dict[str, Any]) -> dict[str, tuple[str, ...]]:
    """Check the options.

    Raises DeploySettingsError for a name or value that one line of a configuration file cannot hold.
    """
    checked: dict[str, tuple[str, ...]] = {}
    for key, values in options.items():
        if not isinstance(key, str) or not _KEY.fullmatch(key):
            raise DeploySettingsError(f"{key!r} cannot be the name of an option; write it like log-dir")
        if not isinstance(values, (list, tuple)) or not all(isinstance(value, str) for value in values):
            raise DeploySettingsError(f"{key}: its values are not texts; use xitl agent deploy of the same version")
        for value in values:
            if not value.isprintable() or value != value.strip():
                raise DeploySettingsError(f"{key} = {value!r}: has control characters or spaces at an end; remove them")
        checked[key] = tuple(values)
    return checked


def configuration(options: dict[str, tuple[str, ...]]) -> str:
    """Return the text for `--config`: one option per line.

    Further values of the same option follow on separate lines.
    """
    lines = ["# Written by `xitl agent deploy`", "[agent]"]
    for key, values in sorted(options.items()):
        lines.append(f"{key} = " + "\n    ".join(values))
    return "\n".join(lines) + "\n"


ARCHIVE = "xitl-agent.pyz"
CONFIGURATION = "agent.conf"
_WRITTEN_BY_AGENT = ("log-dir", "log-file", "storage")
_TRY_S = 120.0


class InstallError(Exception):
    """Raised when the installation fails. The message is one sentence with cause, place and remedy."""


@dataclass(frozen=True)
class InstallPlaces:
    """Target directories of the installation."""

    system: bool
    programs: Path
    settings: Path
    units: Path
    state: Path
    stage: str
    """Prefix of every path that is written. The unit file does not contain it."""

    def staged(self, path: Path) -> Path:
        return Path(self.stage + str(path)) if self.stage else path


def install_places(system: bool, home: Path, stage: str = "") -> InstallPlaces:
    if system:
        root = Path("/")
        return InstallPlaces(
            True, root / "usr/local/bin", root / "etc/xitl", root / "etc/systemd/system", root / "var/lib/xitl", stage
        )
    return InstallPlaces(
        False,
        home / ".local/bin",
        home / ".config/xitl",
        home / ".config/systemd/user",
        home / ".local/state/xitl",
        stage,
    )


def main(arguments: list[str], program: str) -> int:
    """Install the settings from standard input. Print the outcome as one line of JSON after `MARK`."""
    if arguments or sys.stdin.isatty():
        sys.stdout.write(
            f"{program}: run `xitl agent deploy user@host` instead, which starts this command and sends the files\n"
        )
        return 2
    where = install_places(os.geteuid() == 0, Path.home(), os.environ.get("DESTDIR", "").rstrip("/"))
    try:
        outcome = install(own_archive().read_bytes(), settings_from_json(sys.stdin.buffer.read()), where)
    except (InstallError, NotAnArchiveError, ServiceError, DeploySettingsError) as error:
        outcome = {"error": str(error)}
    sys.stdout.write(MARK + json.dumps(outcome) + "\n")
    return 2 if "error" in outcome else 0


def install(data: bytes, settings: DeploySettings, where: InstallPlaces) -> dict[str, Any]:
    """Install the archive `data`, its configuration and its service. Return the outcome for people and programs.

    Raises InstallError and ServiceError.
    """
    archive = where.programs / ARCHIVE
    config = where.settings / CONFIGURATION
    changed = []
    if origin(where.staged(archive)) != origin_of(data):
        _write(where.staged(archive), compiled(data), 0o755, tried=True)
        changed.append(str(archive))
    for key, content in settings.files.items():
        path = where.settings / FILES[key]
        mode = 0o600 if key in SECRET_FILES else 0o644
        if _write(where.staged(path), content.encode(), mode):
            changed.append(str(path))
    if settings.options is not None:
        options = {**settings.options, **{key: (str(where.settings / FILES[key]),) for key in settings.files}}
        for key in set(_WRITTEN_BY_AGENT) & set(options):
            options[key] = tuple(str(where.state / value) for value in options[key])
        if _write(where.staged(config), configuration(options).encode(), 0o644):
            changed.append(str(config))
    command = [sys.executable, str(archive)]
    if where.staged(config).exists():
        command += ["--config", str(config)]
    outcome: dict[str, Any] = {
        "version": agent.__version__,
        "python": platform.python_version(),
        "machine": f"{platform.machine()} {platform.system()} {platform.release()}",
        "command": command,
        "changed": changed,
        "service": None,
        "notes": [],
    }
    written = where.staged(where.units / NAME)
    if settings.service:
        _make_directory(where.staged(where.state))
        if _write(written, unit_text(command, str(where.state), where.system).encode(), 0o644):
            changed.append(str(where.units / NAME))
        systemd = Systemd(where.system)
        outcome["started"] = systemd.apply(changed=bool(changed))
        outcome["service"] = systemd.status()
        if not where.system:
            outcome["notes"] = _lingering_notes()
    elif changed and written.exists():
        outcome["notes"] = [
            "the installed service still runs the previous version or settings; add --service to restart it"
        ]
    return outcome


def _make_directory(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InstallError(f"{directory}: cannot be created ({error.strerror}); check the permissions there") from error


def _write(path: Path, data: bytes, mode: int, tried: bool = False) -> bool:
    """Write `data` to `path` atomically. Return False when the file already has this content.

    tried: run the file before it replaces the old one.

    Raises InstallError.
    """
    try:
        if path.read_bytes() == data and path.stat().st_mode & 0o777 == mode:
            return False
    except OSError:
        pass
    temporary = ""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, mode)  # noqa: PTH101
        if tried:
            _check_start(temporary)
        os.replace(temporary, path)  # noqa: PTH105
        temporary = ""
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        advice = "free some space there" if full else "check the permissions there"
        raise InstallError(f"{path}: cannot be written ({error.strerror}); {advice}") from error
    finally:
        if temporary:
            os.unlink(temporary)  # noqa: PTH108
    return True


def _check_start(archive: str) -> None:
    """Check that the new archive starts here before it replaces the old one."""
    try:
        ran = subprocess.run(
            [sys.executable, archive, "--version"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_TRY_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise InstallError(
            f"the agent did not start on this board within {_TRY_S:.0f} s; check whether the board is busy"
        ) from None
    if ran.returncode:
        lines = ran.stderr.strip().splitlines() or [f"exit code {ran.returncode}"]
        raise InstallError(
            f"the agent does not start with Python {platform.python_version()} on this board ({lines[-1]}); "
            "the previous installation is unchanged"
        )


def _lingering_notes() -> list[str]:
    try:
        user = Path("/var/lib/systemd/linger") / os.environ.get("USER", "")
        lingers = bool(os.environ.get("USER")) and user.exists()
    except OSError:
        lingers = False
    if lingers:
        return []
    return [
        "a user service stops when the user logs out and does not start at boot; to change this, "
        "run on the board: sudo loginctl enable-linger $USER (or deploy as root)"
    ]
