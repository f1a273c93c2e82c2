"""What `xitl agent deploy` asks of a board: one JSON object, checked before anything is written."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any

SECRET_FILES = {"link-key": "link.key", "signing-key": "signing.key"}
PLAIN_FILES = {"parameters": "agent.parm"}
FILES = {**SECRET_FILES, **PLAIN_FILES}
"""Options that name a file, and what that file is called on the board."""
_KEY = re.compile(r"[a-z][a-z0-9-]{0,40}")
_LONGEST = 1 << 20


class SettingsError(ValueError):
    """One sentence: which setting is wrong, and how."""


@dataclass(frozen=True)
class Settings:
    """service: enable and start the unit. options: of the agent, by long name, several values where it may be repeated.

    files: contents by option name. None for `options` leaves the configuration that is there alone.
    """

    service: bool
    options: dict[str, tuple[str, ...]] | None
    files: dict[str, str]


def to_json(settings: Settings) -> bytes:
    options = None if settings.options is None else {key: list(values) for key, values in settings.options.items()}
    return json.dumps({"service": settings.service, "options": options, "files": settings.files}).encode()


def from_json(data: bytes) -> Settings:
    """Raises SettingsError."""
    try:
        given: Any = json.loads(data)
    except ValueError:
        raise SettingsError("the settings are no JSON; use xitl agent deploy of the same version") from None
    if not isinstance(given, dict) or set(given) != {"service", "options", "files"}:
        raise SettingsError("the settings are not service, options and files; use xitl agent deploy of this version")
    service, options, files = given["service"], given["options"], given["files"]
    if not isinstance(service, bool) or not isinstance(files, dict) or not isinstance(options, (dict, type(None))):
        raise SettingsError("the settings have the wrong types; use xitl agent deploy of the same version")
    return Settings(service, None if options is None else checked_options(options), _checked_files(files))


def checked_options(options: dict[str, Any]) -> dict[str, tuple[str, ...]]:
    """Raises SettingsError for a name or a value that one line of a configuration file cannot hold."""
    checked: dict[str, tuple[str, ...]] = {}
    for key, values in options.items():
        if not isinstance(key, str) or not _KEY.fullmatch(key):
            raise SettingsError(f"{key!r} cannot be the name of an option; write it like log-dir")
        if not isinstance(values, (list, tuple)) or not all(isinstance(value, str) for value in values):
            raise SettingsError(f"{key}: its values are not texts; use xitl agent deploy of the same version")
        for value in values:
            if not value.isprintable() or value != value.strip():
                raise SettingsError(f"{key} = {value!r}: has control characters or blanks at an end; leave them out")
        checked[key] = tuple(values)
    return checked


def _checked_files(files: dict[str, Any]) -> dict[str, str]:
    for key, content in files.items():
        if key not in FILES:
            raise SettingsError(f"{key!r} is no option that names a file to bring along; known: {', '.join(FILES)}")
        if not isinstance(content, str) or len(content) > _LONGEST:
            raise SettingsError(f"{key}: the file is no text or longer than {_LONGEST} characters; check the path")
    return dict(files)


def configuration(options: dict[str, tuple[str, ...]]) -> str:
    """The text for `--config`: one option a line, further values of the same option on lines of their own."""
    lines = ["# Written by `xitl agent deploy`", "[agent]"]
    for key, values in sorted(options.items()):
        lines.append(f"{key} = " + "\n    ".join(values))
    return "\n".join(lines) + "\n"
