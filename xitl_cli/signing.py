"""The key that MAVLink frames are signed with, from a file of the user's."""

from __future__ import annotations

from pathlib import Path

from agent.wire.signing import SigningKeyError, read_key
from xitl_cli.errors import UserError


def read_key_file(path: str) -> bytes:
    """The key in the file: 64 hexadecimal digits or a passphrase. Raises UserError."""
    try:
        return read_key(Path(path).read_text(encoding="utf-8"), path)
    except (OSError, ValueError) as error:
        if isinstance(error, SigningKeyError):
            raise UserError(str(error)) from error
        reason = error.strerror if isinstance(error, OSError) else "it is not text"
        raise UserError(f"{path}: cannot be read ({reason}); check the path, or use no signing") from error
