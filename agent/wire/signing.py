"""MAVLink 2 message signing (mavlink.io, "Message Signing").

A signed frame ends in 13 bytes: link number of the sender, timestamp and signature. The timestamp has 6 bytes, little
endian, in units of 10 microseconds since 2015. The signature is the first 6 bytes of SHA-256 over key, frame, link
number and timestamp.
"""

from __future__ import annotations

import hashlib
import os
import stat
import time
from hmac import compare_digest
from pathlib import Path
from typing import Callable

from agent.files import as_text, read_with_status
from agent.wire.framing import SIGNATURE_BYTES, SIGNED

KEY_BYTES = 32
MINUTE = 6_000_000
RADIO_STATUS = 109  # telemetry radios insert it into the stream themselves, without a key
_EPOCH_2015_S = 1_420_070_400
_MOST_STREAMS = 64
_LARGEST = (1 << 48) - 1


class SigningKeyError(ValueError):
    """Raised for a refused key file. The message names the file and the remedy."""


def read_key(text: str, source: str) -> bytes:
    """Return the key of a text: 64 hexadecimal digits, or the SHA-256 of a passphrase, as in ground stations.

    Raises SigningKeyError for an empty text.
    """
    line = text.strip()
    if not line:
        raise SigningKeyError(f"{source}: contains no signing key; write 64 hexadecimal digits or a passphrase")
    if len(line) == 2 * KEY_BYTES:
        try:
            return bytes.fromhex(line)
        except ValueError:
            pass
    return hashlib.sha256(line.encode()).digest()


def read_key_file(path: str, option: str) -> bytes:
    """Return the key in a file, see `read_key`.

    option: option that named the file, for messages.

    Raises SigningKeyError for a missing file, and when another user may read, write or replace it.
    """
    try:
        data, status = read_with_status(Path(path))
        text = as_text(data)
    except FileNotFoundError:
        raise SigningKeyError(
            f"{path}: the signing key is missing, there is no such file; make one for both ends with "
            f"`(umask 077; openssl rand -hex 32 > {path})`, or leave {option} out"
        ) from None
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "not text"
        raise SigningKeyError(
            f"{path}: the signing key cannot be read ({why}); check path and permissions, or leave {option} out"
        ) from None
    if os.name == "posix":
        _check_private(path, status)
    return read_key(text, path)


def _check_private(path: str, status: os.stat_result) -> None:
    """Raise SigningKeyError when a user other than root may read, write or replace the key.

    status: of the file that was read. Its group may read it, for a service with its own group.
    """
    trusted = {0, os.geteuid()}  # root and this user
    sudo_user = os.environ.get("SUDO_UID", "")
    if os.geteuid() == 0 and sudo_user.isdecimal():
        trusted.add(int(sudo_user))
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise SigningKeyError(f"{path}: others may write this signing key; run `chmod 600 {path}`")
    if status.st_mode & stat.S_IROTH:
        raise SigningKeyError(f"{path}: others may read this signing key; run `chmod 600 {path}`")
    if status.st_uid not in trusted:
        raise SigningKeyError(f"{path}: this signing key belongs to another user; make a copy that you own")
    for place in (os.path.abspath(path), os.path.realpath(path)):  # noqa: PTH100
        for folder in Path(place).parents:
            try:
                folder_status = folder.stat()
            except OSError as error:
                raise SigningKeyError(f"{folder}: cannot be read ({error.strerror}); move the signing key") from None
            mode = folder_status.st_mode
            shared = bool(mode & stat.S_IWOTH) and not mode & stat.S_ISVTX
            if shared or folder_status.st_uid not in trusted:
                raise SigningKeyError(
                    f"{path}: others may replace this signing key, because they may write {folder}; "
                    "move it to a directory that only you may write"
                )


def wall_clock_timestamp() -> int:
    """Present time in units of the signing timestamp."""
    return max(0, int((time.time() - _EPOCH_2015_S) * 1e5))


class Signing:
    """One key, for all links that it protects. Memory is bounded.

    refused_unsigned, refused_signature, refused_old: number of refused frames, by reason.
    """

    def __init__(self, key: bytes, clock: Callable[[], int] = wall_clock_timestamp) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"signing: a key of {len(key)} bytes; use {KEY_BYTES}")
        self._key = key
        self._clock = clock
        self._newest = 0
        self._streams: dict[tuple[int, int, int], int] = {}
        self.refused_unsigned = self.refused_signature = self.refused_old = 0

    @property
    def refused(self) -> int:
        """Number of refused frames."""
        return self.refused_unsigned + self.refused_signature + self.refused_old

    def next_timestamp(self) -> int:
        """Return a timestamp that always increases, whatever the clock does."""
        self._newest = min(max(self._newest + 1, self._clock()), _LARGEST)
        return self._newest

    def accepts(self, frame: bytes) -> bool:
        """Whether a frame with a valid checksum is from a holder of the key and not a repetition."""
        if not frame[2] & SIGNED:
            if frame[7] | frame[8] << 8 | frame[9] << 16 == RADIO_STATUS:
                return True
            self.refused_unsigned += 1
            return False
        if not compare_digest(signature(self._key, frame[:-6]), frame[-6:]):
            self.refused_signature += 1
            return False
        link_id = frame[-SIGNATURE_BYTES]
        timestamp = int.from_bytes(frame[1 - SIGNATURE_BYTES : -6], "little")
        stream = (frame[5], frame[6], link_id)
        last = self._streams.get(stream)
        own = max(self._newest, self._clock())
        if timestamp <= last if last is not None else timestamp + MINUTE < own:
            self.refused_old += 1
            return False
        if last is None and len(self._streams) >= _MOST_STREAMS:
            del self._streams[next(iter(self._streams))]
        self._streams[stream] = timestamp
        self._newest = max(self._newest, timestamp)
        return True

    def outgoing(self, link_id: int) -> OutgoingSigning:
        """Return the signer for the packer of one link."""
        return OutgoingSigning(self, self._key, link_id)


class OutgoingSigning:
    """Signs the frames of one link."""

    def __init__(self, signing: Signing, key: bytes, link_id: int) -> None:
        self._signing = signing
        self._key = key
        self._link_id = bytes([link_id & 0xFF])

    def signed(self, frame: bytes) -> bytes:
        """Return the frame with link number, timestamp and signature appended."""
        signed = frame + self._link_id + self._signing.next_timestamp().to_bytes(6, "little")
        return signed + signature(self._key, signed)


def signature(key: bytes, signed: bytes) -> bytes:
    """Signature of a frame, including its timestamp."""
    return hashlib.sha256(key + signed).digest()[:6]
