"""ROS 2 CDR messages: the annotations of a class define the encoder and the definition text."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Annotated, Any, TypeAlias, get_args, get_type_hints

from sim_core.dataclass import dataclass

Uint8: TypeAlias = Annotated[int, "uint8"]
Bool: TypeAlias = Annotated[bool, "uint8"]
Uint32: TypeAlias = Annotated[int, "uint32"]
Int64: TypeAlias = Annotated[int, "int64"]
Float64: TypeAlias = Annotated[float, "float64"]
String: TypeAlias = Annotated[str, "string"]
Bytes: TypeAlias = Annotated[bytes, "uint8[]"]
Float64Sequence: TypeAlias = Annotated[Sequence[float], "float64[]"]
Float64x3: TypeAlias = Annotated[Sequence[float], "float64[3]"]
Float64x4: TypeAlias = Annotated[Sequence[float], "float64[4]"]
Float64x6: TypeAlias = Annotated[Sequence[float], "float64[6]"]
Float64x36: TypeAlias = Annotated[Sequence[float], "float64[36]"]

SEPARATOR = "=" * 80
_TIME_DEFINITION = f"{SEPARATOR}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"

_HEADER = b"\x00\x01\x00\x00"  # little-endian CDR
_HEAD = struct.Struct("<4siI")
_BYTES_HEAD = struct.Struct("<4siII")
_CODES = {"float64": "d", "float32": "f", "int64": "q", "uint32": "I", "uint8": "B", "string": "s"}
_TYPE = re.compile(r"(?P<base>[a-z0-9]+)(?P<array>\[(?P<count>[0-9]*)\])?")
_NUMBER, _ARRAY, _SEQUENCE, _BYTES, _TEXT = range(5)

_UNITS = {
    "v": "V",
    "a": "A",
    "ah": "A h",
    "m": "m", "s": "s", "ns": "ns", "mps": "m/s", "mps2": "m/s²", "rad": "rad", "radps": "rad/s", "radpm": "rad/m",
    "deg": "°",
    "n": "N", "hz": "Hz", "grad": "gon", "ppm": "ppm", "percent": "%", "mib": "MiB", "c": "°C", "db": "dB",
}  # fmt: skip
_FRAMES = {"ned": "NED", "frd": "FRD", "enu": "ENU", "flu": "FLU"}


@dataclass(frozen=True, slots=True)
class TopicField:
    """One field of a message."""

    name: str
    type: str
    """The type in ROS 2 notation."""
    meaning: str = ""
    """Meaning, if the name does not show it."""

    @property
    def unit(self) -> str:
        """Unit from the end of the name; empty for counts and shares."""
        return _UNITS.get(self.name.rpartition("_")[2], "")

    @property
    def frame(self) -> str:
        """Frame from the name. For an attitude, both frames: `quaternion_ned_frd` turns FRD into NED."""
        return " ← ".join(_FRAMES[part] for part in self.name.split("_") if part in _FRAMES)


class MessageType:
    """A stamped message: its definition text and its encoder.

    The annotations of the class `declaration` are the fields, in order. The stamp, a builtin_interfaces/Time, is before
    them. The optional class attribute `definition` is the definition of a message that contains messages.
    """

    def __init__(self, declaration: type) -> None:
        self.fields = tuple(_fields(declaration))
        lines = "".join(f"{field.type} {field.name}\n" for field in self.fields)
        own: str | None = getattr(declaration, "definition", None)
        self.definition = f"builtin_interfaces/Time stamp\n{lines}{_TIME_DEFINITION}" if own is None else own
        self._plan = [_plan(field.type) for field in self.fields]
        self._structs: dict[tuple[int, ...], struct.Struct] = {}
        raw = [kind for kind, _ in self._plan] == [_BYTES]  # most messages of a recording have one bytes field
        self.encode: Callable[..., bytes] = _encode_bytes if raw else self._encode
        """Returns the payload with its encapsulation header, from `stamp_ns` and one value for each field.

        None becomes NaN in a float and -1 in an integer. An empty array of fixed length becomes zeros.
        """

    def _encode(self, stamp_ns: int, *values: Any) -> bytes:
        items: list[Any] = [_HEADER, *divmod(stamp_ns, 1_000_000_000)]
        lengths: list[int] = []
        for (kind, filler), value in zip(self._plan, values, strict=True):
            if kind == _NUMBER:
                items.append(filler if value is None else value)
            elif kind == _ARRAY:
                items.extend(value or filler)
            else:
                data = value.encode() + b"\0" if kind == _TEXT else value
                lengths.append(len(data))
                items.append(len(data))
                if kind == _SEQUENCE:
                    items.extend(data)
                else:
                    items.append(data)
        layout = self._structs.get(key := tuple(lengths))
        if layout is None:
            layout = self._structs[key] = self._struct(lengths)
        return layout.pack(*items)

    def _struct(self, lengths: list[int]) -> struct.Struct:
        """Return the flat struct for texts and sequences of these lengths."""
        layout, size = "<4siI", 8  # alignment counts from the end of the encapsulation header
        remaining = iter(lengths)
        for field, (kind, filler) in zip(self.fields, self._plan, strict=True):
            base = _TYPE.fullmatch(field.type)
            assert base is not None
            parts = [(_CODES[base["base"]], 1)]
            if kind == _ARRAY:
                parts = [(parts[0][0], len(filler))]
            elif kind != _NUMBER:
                count = next(remaining)
                parts = [("I", 1), ("s" if kind == _BYTES else parts[0][0], count)]
            for code, count in parts:
                width = struct.calcsize(f"<{code}")
                padding = -size % width if count else 0
                layout += f"{padding}x{count}{code}"
                size += padding + count * width
        return struct.Struct(layout)


@lru_cache(maxsize=1)
def stamp_head(stamp_ns: int) -> bytes:
    """Return the start of each payload: encapsulation header and stamp."""
    return _HEAD.pack(_HEADER, *divmod(stamp_ns, 1_000_000_000))


def _encode_bytes(stamp_ns: int, *values: Any) -> bytes:
    (data,) = values
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    payload: bytes = _BYTES_HEAD.pack(_HEADER, seconds, nanoseconds, len(data)) + data
    return payload


def _fields(declaration: type) -> list[TopicField]:
    fields = []
    for name, hint in get_type_hints(declaration, include_extras=True).items():
        alternatives = get_args(hint) if not hasattr(hint, "__metadata__") else (hint,)
        annotated = next((kind for kind in alternatives if hasattr(kind, "__metadata__")), None)
        if annotated is not None:
            fields.append(TopicField(name, *annotated.__metadata__))
    return fields


def _plan(type_name: str) -> tuple[int, Any]:
    """Return the encoding of a field, and the substitute for an unknown value."""
    match = _TYPE.fullmatch(type_name)
    assert match is not None
    assert match["base"] in _CODES
    if match["base"] == "string":
        return _TEXT, None
    nothing = math.nan if match["base"].startswith("float") else -1
    if match["array"] is None:
        return _NUMBER, nothing
    if match["count"]:
        return _ARRAY, (0,) * int(match["count"])
    return (_BYTES if match["base"] == "uint8" else _SEQUENCE), None
