"""Payloads that are decoded message by message: JSON, and Protobuf as Foxglove's tools write it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from xitl_cli.logs.formats.mcap.container import PayloadBatch
from xitl_cli.logs.formats.mcap.table import (
    MOST_ELEMENTS,
    MOST_LEAVES,
    ArrayList,
    DecodedBatch,
    Leaf,
    NumberList,
    ObjectList,
    UndecodableError,
)

DEEPEST = 8


class JsonDecoder:
    """Decoder for JSON. Nested keys are named "pose.position.x"; a payload that is no object becomes the column
    "value".

    Numbers are NaN if a message lacks them or has null; true and false are 1 and 0. Texts are empty if a message lacks
    them. A key with both numbers and texts is a text. Arrays are as in CdrDecoder, for any element that some row has.
    Keys beyond the first 2000 of a topic, or nested deeper than 8, are omitted.
    """

    open_ended = True

    def decode(self, batch: PayloadBatch, wanted: str | None) -> DecodedBatch:
        good = np.ones(len(batch), dtype=np.bool_)
        columns: dict[str, dict[int, Any]] = {}
        for row in range(len(batch)):
            try:
                value = json.loads(batch.payload(row))
            except (ValueError, RecursionError):
                good[row] = False
                continue
            for name, found in _flat(value, "", 0):
                if wanted is not None and name != wanted:
                    continue
                column = columns.get(name)
                if column is None:
                    if len(columns) >= MOST_LEAVES:
                        break
                    column = columns[name] = {}
                column[row] = found
        return DecodedBatch(good, {name: _leaf(column, len(batch)) for name, column in columns.items()})


def _flat(value: Any, name: str, depth: int) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        if depth < DEEPEST:
            for key, inner in value.items():
                yield from _flat(inner, f"{name}.{key}" if name else key, depth + 1)
    elif isinstance(value, list):
        if all(inner is None or isinstance(inner, int | float) for inner in value):
            yield name or "value", value
            return
        yield f"{name or 'value'}.length", len(value)
        if depth < DEEPEST:
            for number, inner in enumerate(value[:MOST_ELEMENTS]):
                yield from _flat(inner, f"{name or 'value'}[{number}]", depth + 1)
    elif value is not None:
        yield name or "value", value


def _leaf(column: dict[int, Any], rows: int) -> Leaf:
    values = [column.get(row) for row in range(rows)]
    if any(isinstance(value, str) for value in column.values()):
        return ObjectList(["" if value is None else _text(value) for value in values], "text")
    if all(isinstance(value, list) for value in column.values()):
        return ArrayList([value or () for value in values])
    if any(isinstance(value, list) for value in column.values()):
        return ObjectList(["" if value is None else _text(value) for value in values], "text")
    return NumberList([int(value) if isinstance(value, bool) else value for value in values])


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


_INSTANTS = ("google.protobuf.Timestamp", "google.protobuf.Duration")
_MOST_SCHEMA = 4 << 20
_LATEST_S = 2**63 // 1_000_000_000 - 1


class ProtobufDecoder:
    """Decoder for Protobuf. Raises UndecodableError if the schema is invalid.

    Fields of nested messages are named "pose.position.x"; NaN, or empty text, if such a message is missing. A Timestamp
    or Duration is one column, int64 ns, -1 if missing. Enums are numbers. Arrays are as in CdrDecoder; of maps, only
    the length.
    """

    open_ended = False

    def __init__(self, name: str, schema: bytes) -> None:
        from google.protobuf import (  # type: ignore[import-untyped]
            descriptor_pb2,
            descriptor_pool,
            message_factory,
        )

        if len(schema) > _MOST_SCHEMA:
            raise UndecodableError("its definition is too long")
        try:
            files = descriptor_pb2.FileDescriptorSet.FromString(schema)
            pool = descriptor_pool.DescriptorPool()
            for file in _ordered(files.file):
                pool.Add(file)
            self._type: Any = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
        except Exception as error:  # TypeError, KeyError, DecodeError …, depending on the implementation of protobuf
            raise UndecodableError("its definition cannot be read") from error

    def decode(self, batch: PayloadBatch, wanted: str | None) -> DecodedBatch:
        good = np.ones(len(batch), dtype=np.bool_)
        messages: list[Any] = []
        empty = self._type()
        for row in range(len(batch)):
            try:
                messages.append(self._type.FromString(batch.payload(row)))
            except Exception:  # noqa: BLE001  # DecodeError is of the implementation's own
                good[row] = False
                messages.append(empty)
        if not good.any():
            return DecodedBatch(good, {})
        if not good.all():
            first = messages[int(np.argmax(good))]
            messages = [message if kept else first for message, kept in zip(messages, good.tolist(), strict=True)]
        return DecodedBatch(good, _Flat(wanted).of(messages, self._type.DESCRIPTOR))


class _Flat:
    def __init__(self, wanted: str | None) -> None:
        self._wanted = wanted
        self._leaves: dict[str, Leaf] = {}

    def of(self, messages: Sequence[Any], descriptor: Any) -> dict[str, Leaf]:
        self._message(messages, descriptor, "", 0)
        return self._leaves

    def _message(self, messages: Sequence[Any], descriptor: Any, prefix: str, depth: int) -> None:
        for field in descriptor.fields:
            name = f"{prefix}{field.name}"
            if len(self._leaves) >= MOST_LEAVES:
                return
            if self._wanted is not None and not self._wanted.startswith(name):
                continue
            if _repeated(field):
                self._repeated(messages, field, name, depth)
            elif field.message_type is not None:
                inner = [
                    None if message is None or not message.HasField(field.name) else getattr(message, field.name)
                    for message in messages
                ]
                self._inner(inner, field.message_type, name, depth)
            else:
                self._leaves[name] = self._scalar(messages, field)

    def _inner(self, messages: Sequence[Any], descriptor: Any, name: str, depth: int) -> None:
        if descriptor.full_name in _INSTANTS:
            self._leaves[name] = NumberList([_instant_ns(message) for message in messages], "ns", np.dtype(np.int64))
        elif depth < DEEPEST:
            self._message(messages, descriptor, f"{name}.", depth + 1)

    def _scalar(self, messages: Sequence[Any], field: Any) -> Leaf:
        name = field.name
        if field.has_presence:
            values = [
                getattr(message, name) if message is not None and message.HasField(name) else None
                for message in messages
            ]
        else:
            values = [None if message is None else getattr(message, name) for message in messages]
        if field.cpp_type == field.CPPTYPE_STRING:
            if field.type == field.TYPE_BYTES:
                return ObjectList([value or b"" for value in values], "bytes")
            return ObjectList([value or "" for value in values], "text")
        return NumberList(values, dtype=_dtype(field))

    def _repeated(self, messages: Sequence[Any], field: Any, name: str, depth: int) -> None:
        lists = [() if message is None else getattr(message, field.name) for message in messages]
        if field.message_type is None and field.cpp_type != field.CPPTYPE_STRING:
            self._leaves[name] = ArrayList(lists, _dtype(field))
            return
        counts = [len(values) for values in lists]
        self._leaves[f"{name}.length"] = NumberList(counts, dtype=np.dtype(np.int64))
        if field.message_type is not None and field.message_type.GetOptions().map_entry:
            return
        for number in range(min(min(counts), MOST_ELEMENTS)):
            values = [each[number] for each in lists]
            element = f"{name}[{number}]"
            if field.message_type is not None:
                self._inner(values, field.message_type, element, depth)
            else:
                self._leaves[element] = ObjectList(values, "bytes" if field.type == field.TYPE_BYTES else "text")


def _ordered(files: Sequence[Any]) -> list[Any]:
    """Files sorted so that each follows its dependencies, if all of these are present."""
    left, done, ordered = {file.name: file for file in files}, set[str](), list[Any]()
    while left:
        ready = [file for file in left.values() if all(name in done or name not in left for name in file.dependency)]
        for file in ready or list(left.values()):
            ordered.append(file)
            done.add(file.name)
            del left[file.name]
    return ordered


def _repeated(field: Any) -> bool:
    return bool(field.is_repeated if hasattr(field, "is_repeated") else field.label == field.LABEL_REPEATED)


def _dtype(field: Any) -> np.dtype[Any]:
    return np.dtype(
        {
            field.CPPTYPE_INT32: np.int32,
            field.CPPTYPE_INT64: np.int64,
            field.CPPTYPE_UINT32: np.uint32,
            field.CPPTYPE_UINT64: np.uint64,
            field.CPPTYPE_DOUBLE: np.float64,
            field.CPPTYPE_FLOAT: np.float32,
            field.CPPTYPE_BOOL: np.uint8,
            field.CPPTYPE_ENUM: np.int32,
        }[field.cpp_type]
    )


def _instant_ns(message: Any) -> int:
    if message is None:
        return -1
    return int(min(max(message.seconds, -_LATEST_S), _LATEST_S)) * 1_000_000_000 + int(message.nanos)
