"""The key that MAVLink frames are signed with, from a file of the user's."""

from __future__ import annotations

from agent.wire.signing import SigningKeyError
from agent.wire.signing import read_key_file as read_file
from xitl_cli.errors import UserError


def read_key_file(path: str, option: str = "--signing-key") -> bytes:
    """The key in the file: 64 hexadecimal digits or a passphrase. option: what named the file. Raises UserError."""
    try:
        return read_file(path, option)
    except SigningKeyError as error:
        raise UserError(str(error)) from error
