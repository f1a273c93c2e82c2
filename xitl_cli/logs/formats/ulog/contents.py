"""Contents of the records of a ULog that are no rows: information, parameters, texts, subscriptions."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.formats.ulog.definitions import TYPES

_KEY = re.compile(rb"([a-z][a-z0-9_]*(?:\[\d{1,5}\])?) (\S+)")
_TOPIC = re.compile(rb"[A-Za-z_]\w*")
_NO_TEXT = re.compile(rb"[\x00-\x06\x0e-\x1a\x1c-\x1f]")
SYNC = bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12))
INCOMPATIBLE_APPENDED = 1

Value = int | float | str | bytes


@dataclass(frozen=True, slots=True)
class Information:
    """A named value of an I, M, P or Q record."""

    key: str
    value: Value


@dataclass(frozen=True, slots=True)
class Subscription:
    """From this record on, rows with the number `msg_id` belong to instance `multi_id` of the message `name`."""

    multi_id: int
    msg_id: int
    name: str


@dataclass(frozen=True, slots=True)
class Text:
    """A logged text."""

    level: int
    """MAVLink severity, 0 emergency to 7 debug."""
    tag: int | None
    """Source; None if there is none."""
    stamp_us: int
    text: str


@dataclass(frozen=True, slots=True)
class Flags:
    """Flags of the file."""

    compatible: bytes
    incompatible: bytes
    appended: tuple[int, ...]
    """Offsets of data that was appended after the end, for example by a crash handler."""

    @property
    def unknown(self) -> bool:
        """Whether a bit marks an incompatible version of the format."""
        return bool(self.incompatible[0] & ~INCOMPATIBLE_APPENDED) or any(self.incompatible[1:])


def parse_information(content: bytes) -> Information | None:
    """Parse an I or P record; None if the content is invalid."""
    if not content or len(content) < 1 + content[0]:
        return None
    match = _KEY.fullmatch(content[1 : 1 + content[0]])
    if match is None:
        return None
    type_name, key = match[1].decode(), match[2].decode("utf-8", "replace")
    stored = content[1 + content[0] :]
    if type_name.startswith("char["):
        return Information(key, decoded(stored))
    code = TYPES.get(type_name)
    if code is None:
        return Information(key, stored)
    dtype = np.dtype(code)
    return Information(key, np.frombuffer(stored, dtype)[0].item()) if len(stored) == dtype.itemsize else None


def parse_parameter(content: bytes) -> Information | None:
    found = parse_information(content)
    return found if found is not None and isinstance(found.value, int | float) else None


def parse_subscription(content: bytes) -> Subscription | None:
    if len(content) < 4 or not _TOPIC.fullmatch(content[3:]):
        return None
    return Subscription(content[0], int.from_bytes(content[1:3], "little"), content[3:].decode())


def parse_text(content: bytes, *, tagged: bool) -> Text | None:
    head = 11 if tagged else 9
    if len(content) < head or not 0x30 <= content[0] <= 0x37 or _NO_TEXT.search(content[head:].rstrip(b"\0")):
        return None
    tag = int.from_bytes(content[1:3], "little") if tagged else None
    return Text(content[0] - 0x30, tag, int.from_bytes(content[head - 8 : head], "little"), decoded(content[head:]))


def parse_flags(content: bytes) -> Flags | None:
    if len(content) < 40:
        return None
    offsets = (int.from_bytes(content[at : at + 8], "little") for at in (16, 24, 32))
    return Flags(content[:8], content[8:16], tuple(place for place in offsets if place))


def decoded(stored: bytes) -> str:
    """Text up to the zeros at its end, as UTF-8; invalid bytes are omitted."""
    return stored.decode("utf-8", "ignore").rstrip("\0")
