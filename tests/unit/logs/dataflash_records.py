"""DataFlash records, packed by `struct`."""

from __future__ import annotations

import struct
from typing import Any

FMT = struct.Struct("<2sBBB4s16s64s")
CODES = {
    "b": "b", "B": "B", "M": "B", "h": "h", "H": "H", "i": "i", "I": "I", "q": "q", "Q": "Q", "g": "e", "f": "f",
    "d": "d", "n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "a": "32h",
}  # fmt: skip
ITSELF = FMT.pack(b"\xa3\x95", 128, 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")


def described(
    kind: int, name: bytes, letters: str, columns: str | None = None, length: int | None = None, code: str | None = None
) -> bytes:
    if length is None:
        length = 3 + struct.calcsize("<" + "".join(CODES[letter] for letter in letters))
    if columns is None:
        columns = ",".join(f"F{place}" for place in range(len(letters)))
    return FMT.pack(
        b"\xa3\x95", 128, kind, length, name, (code or letters).encode("latin-1"), columns.encode("latin-1")
    )


def record(kind: int, letters: str, *values: Any) -> bytes:
    flat = [part for value in values for part in (value if isinstance(value, list | tuple) else [value])]
    return b"\xa3\x95" + bytes([kind]) + struct.pack("<" + "".join(CODES[letter] for letter in letters), *flat)
