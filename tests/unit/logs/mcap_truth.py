"""What the `mcap` package and the runtimes of ROS 2 and protobuf say is in a recording, against our tables."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory

from xitl_cli.logs.formats.mcap.file import McapLog
from xitl_cli.logs.formats.mcap.table import MOST_ELEMENTS
from xitl_cli.logs.model.table import Table

_STEP = re.compile(r"([^.\[\]]+)|\[([0-9]+)\]")


class Protobuf:
    """Decodes with protobuf's own runtime."""

    def decoder_for(self, encoding: str, schema: Any) -> Any:
        if encoding != "protobuf":
            return None
        pool = descriptor_pool.DescriptorPool()
        files = list(descriptor_pb2.FileDescriptorSet.FromString(schema.data).file)
        while files:
            for file in list(files):
                if not any(other.name in file.dependency for other in files):
                    pool.Add(file)
                    files.remove(file)
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString


class Raw:
    """Takes whatever the others do not."""

    def decoder_for(self, encoding: str, schema: Any) -> Any:
        return bytes


Truth = dict[str, list[tuple[int, bytes, Any]]]


def truth_of(path: Path) -> Truth:
    """Log time, payload and decoded message of each topic, in the order of the file."""
    factories = [DecoderFactory(), Protobuf(), Raw()]
    found: Truth = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=factories)
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append((message.log_time, message.data, decoded))
    return found


def payloads_of(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    """The same without decoding, as far as the package's streaming reader gets."""
    found: dict[str, list[tuple[int, bytes]]] = {}
    with path.open("rb") as file, suppress(Exception):  # however it ends
        for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append((message.log_time, message.data))
    return found


def is_equal(path: Path, extra: frozenset[str] = frozenset()) -> int:
    """Assert that every message of every topic has the same values in both readers; how many values were compared.

    extra: topics that the package's decoders do not know.
    """
    truth, compared = truth_of(path), 0
    with McapLog(path) as log:
        assert list(log.tables) == sorted(truth)
        assert sum(len(table) for table in log.tables.values()) == log.health.records
        for topic, messages in truth.items():
            table = log.tables[topic]
            assert len(table) == len(messages)
            np.testing.assert_array_equal(table.stamp_ns, [stamp for stamp, _, _ in messages])
            assert (np.diff(table.file_offset) > 0).all()
            if topic not in extra:
                compared += table_is_equal(table, [decoded for _, _, decoded in messages])
    return compared


def table_is_equal(table: Table, messages: list[Any]) -> int:
    for name in table.columns:
        column_is_equal(table, name, [resolve(message, name) for message in messages])
    missing = {name for message in messages[:20] for name in leaves(message, "")} - set(table.columns)
    for name in missing:
        assert not everywhere(name, messages), name
    return len(table.columns) * len(messages)


def column_is_equal(table: Table, name: str, wanted: list[Any]) -> None:
    column, values = table.columns[name], table.values(name)
    if column.kind == "bytes":
        assert [bytes(value) for value in values] == [as_bytes(value) for value in wanted], name
    elif column.kind == "text":
        assert values.tolist() == wanted, name
    elif column.shape == (-1,):
        for row, value in zip(values, wanted, strict=True):
            np.testing.assert_array_equal(row[: len(value)], value)
            assert np.isnan(row[len(value) :]).all()
    else:
        assert values.shape == (len(wanted), *column.shape), name
        wanted = [list(value) if isinstance(value, bytes) else value for value in wanted]
        np.testing.assert_array_equal(values, np.array(wanted, dtype=values.dtype).reshape(values.shape), name)


def as_bytes(value: Any) -> bytes:
    if isinstance(value, bytes | bytearray):
        return bytes(value)
    numbers = np.asarray(value)
    return numbers.astype(np.uint32 if numbers.dtype.kind == "i" else np.float32).tobytes()


def everywhere(name: str, messages: list[Any]) -> bool:
    """Whether a column of this name was due: every message has it, and some have something there."""
    if any(int(number) >= MOST_ELEMENTS for number in re.findall(r"\[([0-9]+)\]", name)):
        return False
    try:
        values = [resolve(message, name) for message in messages]
    except IndexError:
        return False
    return not all(isinstance(value, list | tuple) and not len(value) for value in values)


def resolve(message: Any, name: str) -> Any:
    """The value of a column in a decoded message."""
    for key, number in _STEP.findall(name):
        if number:
            message = message[int(number)]
        elif key == "length" and not hasattr(message, "DESCRIPTOR") and hasattr(message, "__len__"):
            return len(message)
        elif hasattr(message, "DESCRIPTOR"):
            field = message.DESCRIPTOR.fields_by_name[key]
            if not field.is_repeated and field.has_presence and not message.HasField(key):
                return absent(field, name)
            message = getattr(message, key)
        else:
            message = getattr(message, key)
    if hasattr(message, "seconds"):
        return message.seconds * 10**9 + message.nanos
    if hasattr(message, "nanosec"):
        return message.sec * 10**9 + message.nanosec
    return list(message) if not isinstance(message, str | bytes) and hasattr(message, "__len__") else message


def absent(field: Any, name: str) -> Any:
    for key in re.findall(r"[^.\[\]]+", name[name.index(field.name) + len(field.name) :]):
        if not key.isdigit() and field.message_type is not None:
            field = field.message_type.fields_by_name.get(key, field)
    if field.message_type is not None:
        return -1
    return "" if field.cpp_type == field.CPPTYPE_STRING else math.nan


_PLAIN = (str, bytes, int, float, np.ndarray)


def leaves(message: Any, prefix: str) -> Iterator[str]:
    """The names of all values in a decoded message."""
    if hasattr(message, "nanosec") or hasattr(message, "seconds"):
        yield prefix
    elif hasattr(message, "DESCRIPTOR"):
        for field, value in message.ListFields():
            yield from leaves(value, f"{prefix}.{field.name}" if prefix else field.name)
    elif is_dataclass(message):
        for field in fields(message):
            if field.name[0].islower():  # else a constant
                yield from leaves(getattr(message, field.name), f"{prefix}.{field.name}" if prefix else field.name)
    elif hasattr(message, "__slots__") and not isinstance(message, str | bytes | int | float | list):
        for name in message.__slots__:
            yield from leaves(getattr(message, name), f"{prefix}.{name}" if prefix else name)
    elif isinstance(message, _PLAIN) or (len(message) and isinstance(message[0], int | float)):
        yield prefix
    elif len(message):  # an empty one does not say of what
        for number, value in enumerate(message):
            yield from leaves(value, f"{prefix}[{number}]")
