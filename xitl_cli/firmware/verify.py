"""Verification of a downloaded file.

The server publishes no checksums of programs. The content of a program or image is compared with the server's data:
processor and length in the ELF header, and the compiled-in commit. For an image these are the length and the two CRC-32
that its bootloader checks (the descriptor of ArduPilot's Tools/ardupilotwaf/chibios.py). If a mirror has a .sha256 of
the file, it is checked too.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import struct
import zlib
from pathlib import Path
from typing import Any

from xitl_cli.firmware.cache import SITL, SITL_ARMHF, sha256

_ELF_MACHINE = {SITL: (62, "x86-64"), SITL_ARMHF: (40, "ARM")}
_SHA256 = re.compile(r"\b([0-9a-fA-F]{64})\b")
# Eight bytes that mark the descriptor in an image, and its length: without and with a signature.
_DESCRIPTORS = ((bytes.fromhex("40a2e4f164689106"), 16), (bytes.fromhex("41a3e5f265699207"), 92))
_MOST_IMAGE_BYTES = 64_000_000


class DamagedError(ValueError):
    """The file is damaged or wrong; the text gives the problem."""


def verify(file: Path, image: bool, board: str, git: str, published: str | None) -> tuple[str, ...]:
    """Return the checks that the file passed, in words.

    `image`: for a board, not a program. `git`: the commit, or empty. `published`: the text of a .sha256, or None.
    Raises DamagedError. A commit that is missing in the file is no damage; it is only not listed as checked.
    """
    data = file.read_bytes()
    checked = [f"{len(data)} bytes"]
    digest = _SHA256.search(published or "")
    if digest is not None:
        if hashlib.sha256(data).hexdigest() != digest[1].lower():
            raise DamagedError("its SHA-256 differs from the published one")
        checked.append("SHA-256 as published")
    checked += _image(data) if image else _program(data, board)
    identity = str(json.loads(data).get("git_identity", "")) if image else ""
    if git and (git[:8].encode() in data if not image else len(identity) >= 7 and git.startswith(identity)):
        checked.append(f"commit {git[:8]}")
    return tuple(checked)


def check_pin(file: Path, pinned: str) -> list[str]:
    """Compare a file with a pinned SHA-256; raises DamagedError for another file. Without a pin, check nothing."""
    if not pinned:
        return []
    digest = sha256(file)
    if digest != pinned.lower():
        raise DamagedError(f"its SHA-256 is {digest}, and {pinned.lower()} is pinned")
    return ["SHA-256 as pinned"]


def _program(data: bytes, board: str) -> list[str]:
    if len(data) < 52 or data[:4] != b"\x7fELF":
        raise DamagedError("it is no program (no ELF header)")
    order = ">" if data[5] == 2 else "<"
    (machine,) = struct.unpack_from(order + "H", data, 18)
    if board in _ELF_MACHINE and machine != _ELF_MACHINE[board][0]:
        raise DamagedError(f"it is a program for another processor than {_ELF_MACHINE[board][1]}")
    wide = data[4] == 2
    if wide and len(data) < 64:
        raise DamagedError("it is cut off (in the ELF header)")
    (sections,) = struct.unpack_from(order + ("Q" if wide else "I"), data, 40 if wide else 32)
    section_bytes, count = struct.unpack_from(order + "HH", data, 58 if wide else 46)
    least_bytes = sections + section_bytes * count
    if len(data) < least_bytes:
        raise DamagedError(f"it is cut off ({len(data)} bytes of at least {least_bytes})")
    return ["ELF program, complete"]


def _image(data: bytes) -> list[str]:
    try:
        described: Any = json.loads(data)
        size = int(described["image_size"])
        packed = base64.b64decode(described["image"], validate=True)
        image = zlib.decompressobj().decompress(packed, _MOST_IMAGE_BYTES)
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError, zlib.error) as error:
        raise DamagedError(f"it is no firmware image ({error})") from None
    if len(image) != size:
        raise DamagedError(f"its image has {len(image)} bytes, not {size} as stated in it")
    for mark, length in _DESCRIPTORS:
        at = image.find(mark) + len(mark)
        if at >= len(mark) and at + length <= len(image):
            before, after, whole = struct.unpack_from("<III", image, at)
            if not (before or after or whole):
                break
            if (_crc(image[:at]), _crc(image[at + length :]), len(image)) != (before, after, whole):
                raise DamagedError("the CRC-32 of its image are not those in its descriptor")
            return [f"image of {size} bytes", "CRC-32 of the image"]
    return [f"image of {size} bytes"]


def _crc(data: bytes) -> int:
    """Return the CRC-32 of the bootloader: from 0 and without a final complement."""
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF
