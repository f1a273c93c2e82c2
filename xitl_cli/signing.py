"""The signing key for MAVLink frames, from a file of the user."""

from __future__ import annotations

from agent.wire.signing import SigningKeyError
from agent.wire.signing import read_key_file as read_file
from xitl_cli.errors import UserError


def read_key_file(path: str, option: str = "--signing-key") -> bytes:
    """Return the key in the file: 64 hexadecimal digits or a passphrase.

    option: source of the file name. Raises UserError.
    """
    try:
        return read_file(path, option)
    except SigningKeyError as error:
        raise UserError(str(error)) from error
