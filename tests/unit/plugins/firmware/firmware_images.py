"""Firmware that is none: what is looked at in a program or an image is as in real ones."""

from __future__ import annotations

import base64
import json
import struct
import zlib

COMMIT = "3fc7011a7d3dc047cbb17d8bd98ee94577d144c6"
DESCRIPTOR = bytes.fromhex("40a2e4f164689106")


def program(machine: int = 62, commit: str = COMMIT, size: int = 300_000) -> bytes:
    """A 64-bit ELF file whose section headers are its last bytes, with a version in it."""
    count, each = 4, 64
    head = struct.pack(
        "<16sHHIQQQIHHHHHH",
        b"\x7fELF\x02\x01\x01",
        2,
        machine,
        1,
        0,
        64,
        size - count * each,
        0,
        64,
        56,
        0,
        each,
        count,
        3,
    )
    filling = bytes(index * 7 % 251 for index in range(4096)) * (size // 4096 + 1)
    said = f"ArduRover V4.6.3 ({commit[:8]})".encode()
    return (head + said + filling)[:size]


def crc32_from_zero(data: bytes) -> int:
    """Bit by bit: reflected polynomial 0xEDB88320, start 0, no complement at the end."""
    state = 0
    for byte in data:
        state ^= byte
        for _ in range(8):
            state = state >> 1 ^ (0xEDB88320 if state & 1 else 0)
    return state


def image(commit: str = COMMIT, size: int = 3000, damaged: bool = False, more: int = 0) -> bytes:
    """A board's image with its descriptor. `more`: bytes that it is said to have besides."""
    before, after = b"\x11\x22\x33" * 100 + DESCRIPTOR, bytes(range(256)) * (size // 256)
    whole = len(before) + 16 + len(after)
    described = struct.pack("<IIII", crc32_from_zero(before), crc32_from_zero(after), whole, int(commit[:8], 16))
    raw = bytearray(before + described + after)
    if damaged:
        raw[-1] ^= 1
    return json.dumps(
        {
            "board_id": 53,
            "magic": "APJFWv1",
            "image": base64.b64encode(zlib.compress(bytes(raw))).decode(),
            "image_size": len(raw) + more,
            "git_identity": commit[:8],
        }
    ).encode()
