"""Writes ULog files record by record, as https://docs.px4.io/main/en/dev_log/ulog_file_format describes them."""

from __future__ import annotations

import struct
from collections.abc import Sequence

MAGIC = b"ULog\x01\x12\x35"
SYNC = bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12))


def record(letter: str, content: bytes) -> bytes:
    return struct.pack("<HB", len(content), ord(letter)) + content


def head(start_us: int = 1_000_000, appended: Sequence[int] = ()) -> bytes:
    offsets = struct.pack("<3Q", *[*appended, 0, 0, 0][:3])
    flags = bytes(8) + bytes([1 if appended else 0]) + bytes(7) + offsets
    return MAGIC + b"\x01" + struct.pack("<Q", start_us) + record("B", flags)


def message_format(name: str, fields: str) -> bytes:
    return record("F", f"{name}:{fields}".encode())


def keyed(letter: str, key: str, value: bytes, first: bytes = b"") -> bytes:
    return record(letter, first + bytes([len(key)]) + key.encode() + value)


def information(key: str, text: str) -> bytes:
    return keyed("I", f"char[{len(text)}] {key}", text.encode())


def parameter(name: str, value: float) -> bytes:
    if isinstance(value, int):
        return keyed("P", f"int32_t {name}", struct.pack("<i", value))
    return keyed("P", f"float {name}", struct.pack("<f", value))


def default(name: str, value: float, kinds: int = 1) -> bytes:
    return keyed("Q", f"float {name}", struct.pack("<f", value), bytes([kinds]))


def subscription(msg_id: int, name: str, multi_id: int = 0) -> bytes:
    return record("A", struct.pack("<BH", multi_id, msg_id) + name.encode())


def row(msg_id: int, layout: str, *values: object) -> bytes:
    return record("D", struct.pack("<H", msg_id) + struct.pack(f"<{layout}", *values))


def text(level: int, stamp_us: int, words: str) -> bytes:
    return record("L", bytes([0x30 + level]) + struct.pack("<Q", stamp_us) + words.encode())


def tagged_text(level: int, tag: int, stamp_us: int, words: str) -> bytes:
    return record("C", bytes([0x30 + level]) + struct.pack("<HQ", tag, stamp_us) + words.encode())


def dropout(ms: int) -> bytes:
    return record("O", struct.pack("<H", ms))


def sync() -> bytes:
    return record("S", SYNC)
