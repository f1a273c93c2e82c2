"""ROS 2 message definitions as trees of what follows what in CDR."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from xitl_cli.logs.formats.mcap.decoded import UndecodableError

_SIZES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_MOST_TEXT = 1 << 20
_DEEPEST = 16
_FIELD = re.compile(r"([A-Za-z][\w/]*(?:<=[0-9]+)?(?:\[(?:<=)?[0-9]*\])?)\s+([A-Za-z]\w*)")
_NAME = re.compile(r"[A-Za-z]\w*(?:/[A-Za-z]\w*){0,2}")


@dataclass(frozen=True, slots=True)
class Number:
    """code: of numpy, without the order of bytes. octet: a uint8 or byte, whose sequences are blobs."""

    code: str
    size: int
    octet: bool = False


@dataclass(frozen=True, slots=True)
class Text:
    """wide: wstring."""

    wide: bool = False


@dataclass(frozen=True, slots=True)
class Time:
    """int32 seconds, uint32 nanoseconds."""


@dataclass(frozen=True, slots=True)
class Struct:
    fields: tuple[tuple[str, Node], ...]


@dataclass(frozen=True, slots=True)
class Array:
    """count None: a sequence, its length in front."""

    element: Node
    count: int | None


Node = Number | Text | Time | Struct | Array


def definition(name: str, text: bytes) -> Struct:
    """Of a `ros2msg` schema. Raises UndecodableError when it does not say how messages look."""
    if len(text) > _MOST_TEXT:
        raise UndecodableError("its definition is too long")
    types: dict[str, Any] = {}
    from rosbags.typesys import get_types_from_msg

    for full_name, fields in _pieces(name, text.decode("utf-8", "replace")):
        try:
            types |= get_types_from_msg(fields, full_name)
        except Exception as error:  # what a parser of others raises on garbage cannot be listed
            raise UndecodableError("its definition cannot be read") from error
    root = _tree(_normal(name), types, {}, 0)
    if not isinstance(root, Struct):
        root = Struct((("sec", _number("int32")), ("nanosec", _number("uint32"))))
    return root


def _pieces(name: str, text: str) -> list[tuple[str, str]]:
    """Each message of the definition: its name, and its fields without comments, constants and defaults."""
    pieces: list[tuple[str, str]] = []
    for part in re.split(r"^={3,}[ \t\r]*$", text, flags=re.MULTILINE):
        fields = []
        for line in part.splitlines():
            bare = line.strip()
            if bare.startswith("MSG:"):
                name = bare[4:].strip()
            elif bare and not bare.startswith("#"):
                match = _FIELD.match(bare)
                if match is None:
                    raise UndecodableError("its definition cannot be read")
                if not bare[match.end() :].lstrip().startswith("="):
                    fields.append(f"{match[1]} {match[2]}\n")
        if _NAME.fullmatch(name) is None:
            raise UndecodableError("its definition cannot be read")
        pieces.append((name, "".join(fields)))
    return pieces


def _normal(name: str) -> str:
    """package/Type and package/msg/Type are the same."""
    parts = name.split("/")
    return "/".join((parts[0], "msg", parts[-1])) if len(parts) == 2 else name


def _tree(name: str, types: dict[str, Any], known: dict[str, Node], depth: int) -> Node:
    if name in _TIMES:
        return Time()
    if name in known:
        return known[name]
    if name.rsplit("/", 1)[-1] == "wstring":
        return Text(wide=True)
    if name not in types:
        raise UndecodableError(f"its definition lacks {name[:80]}")
    if depth > _DEEPEST:
        raise UndecodableError("its definition is nested too deep")
    fields = tuple((field, _node(kind, types, known, depth + 1)) for field, kind in types[name][1])
    known[name] = Struct(fields)
    return known[name]


def _node(described: Any, types: dict[str, Any], known: dict[str, Node], depth: int) -> Node:
    kind, rest = described[0].name, described[1]
    if kind == "BASE":
        return Text() if rest[0] == "string" else _number(rest[0])
    if kind == "NAME":
        return _tree(rest, types, known, depth)
    return Array(_node(rest[0], types, known, depth), rest[1] if kind == "ARRAY" else None)


def _number(name: str) -> Number:
    code = _SIZES.get(name)
    if code is None:
        raise UndecodableError(f"its definition uses {name}")
    return Number(code, int(code[1]), name in ("byte", "uint8"))
