"""What the agent on a board is started with: a configuration file, and above it what the command line says."""

from __future__ import annotations

import configparser
from collections.abc import Mapping, Sequence
from pathlib import Path

from agent.board.settings import Settings, SettingsError, checked_options
from xitl_cli.errors import UserError

SECTION = "agent"


def settings(
    service: bool, config: Path | None, options: Mapping[str, Sequence[str]], files: Mapping[str, Path]
) -> Settings:
    """Put together what to send. Raises UserError.

    Options that name files in `config` mean files on the board; `files` are brought along from here.
    """
    merged: dict[str, tuple[str, ...]] = {} if config is None else _read(config)
    merged.update({key: tuple(values) for key, values in options.items()})
    try:
        checked = checked_options(dict(merged))
    except SettingsError as error:
        raise UserError(str(error)) from None
    contents = {key: _text(f"--{key}", path) for key, path in files.items()}
    return Settings(service, checked if checked or contents or config is not None else None, contents)


def _read(path: Path) -> dict[str, tuple[str, ...]]:
    parser = configparser.ConfigParser(interpolation=None, strict=True)
    try:
        parser.read_string(_text("--config", path), str(path))
    except configparser.Error as error:
        raise UserError(f"--config {path}: {' '.join(str(error).split())}; write lines like link = URL") from None
    if parser.sections() != [SECTION]:
        raise UserError(f"--config {path}: needs one section, [{SECTION}], and has {parser.sections() or 'none'}")
    return {key: tuple(value.split("\n")) for key, value in parser[SECTION].items()}


def _text(option: str, path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise UserError(f"{option} {path}: cannot be read (not text); check the path") from None
    except OSError as error:
        raise UserError(f"{option} {path}: cannot be read ({error.strerror}); check the path") from None
