"""ROS 2 CDR payloads of messages whose strings and array lengths are known beforehand: one struct each."""

from __future__ import annotations

import struct

_LITTLE_ENDIAN_CDR = b"\x00\x01\x00\x00"
_CODES = {"f64": "d", "f32": "f", "i64": "q", "u64": "Q", "u32": "I", "u8": "B"}

Field = str | tuple[str, int] | tuple[str, str]


class Layout:
    """A stamped message as a flat struct.

    Every message starts with its stamp, a builtin_interfaces/Time. `fields` are what follows, in order: `"f64"` one
    number, `("f64", 3)` a fixed array, `("f64[]", 2)` a sequence of known length, `("string", "map")` a constant text.
    """

    def __init__(self, *fields: Field) -> None:
        self._format = "<4siI"
        self._size = 8  # alignment counts from behind the encapsulation header
        self._template: list[float | bytes] = [_LITTLE_ENDIAN_CDR, 0, 0]
        self._places: list[int] = []
        for field in fields:
            kind, argument = field if isinstance(field, tuple) else (field, 1)
            if kind == "string":
                data = str(argument).encode() + b"\0"
                self._append("I", len(data))
                self._append(f"{len(data)}s", data)
                continue
            if kind.endswith("[]"):
                self._append("I", int(argument))
            for _ in range(int(argument)):
                self._places.append(len(self._template))
                self._append(_CODES[kind.removesuffix("[]")], 0)
        self._struct = struct.Struct(self._format)

    def pack(self, stamp_ns: int, *values: float) -> bytes:
        """Payload with its encapsulation header; one value for each number of the layout."""
        items = self._template.copy()
        items[1], items[2] = divmod(stamp_ns, 1_000_000_000)
        for place, value in zip(self._places, values, strict=True):
            items[place] = value
        return self._struct.pack(*items)

    def _append(self, code: str, value: float | bytes) -> None:
        size = struct.calcsize(f"<{code}")
        padding = 0 if code.endswith("s") else -self._size % size
        self._format += f"{padding}x{code}" if padding else code
        self._size += padding + size
        self._template.append(value)
