"""Wire format of TCPROS: blocks preceded by their length, the first a header of fields."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Mapping
from typing import NamedTuple

MOST_HEADER = 1 << 20
MOST_MESSAGE = 64 << 20
_LENGTH = struct.Struct("<I")

Header = Mapping[str, str]


class Ros1Type(NamedTuple):
    """A message type of ROS 1."""

    name: str
    """Name, such as `sensor_msgs/Imu`."""
    md5: str
    definition: str
    """Text with all nested types."""


class TcprosError(Exception):
    """Data of a peer is not TCPROS, or not the requested data; the message is a clause."""


def block(data: bytes) -> bytes:
    """Return the data preceded by its length."""
    return _LENGTH.pack(len(data)) + data


def encode_header(fields: Header) -> bytes:
    """Return the whole block."""
    return block(b"".join(block(f"{name}={value}".encode()) for name, value in fields.items()))


def parse_header(data: bytes) -> Header:
    """Return the fields of a header without its length. Raises TcprosError."""
    fields, at = dict[str, str](), 0
    while at < len(data):
        end = at + 4 + _LENGTH.unpack_from(data, at)[0] if at + 4 <= len(data) else len(data) + 1
        name, equals, value = data[at + 4 : end].partition(b"=")
        if end > len(data) or not equals:
            raise TcprosError("its header is cut short or has a field without =")
        fields[name.decode("utf-8", "replace")] = value.decode("utf-8", "replace")
        at = end
    return fields


def receive_exactly(connection: socket.socket, size: int) -> bytes | None:
    """Return `size` bytes; None if the peer closed before the first. Raises TcprosError for less, and OSError."""
    parts, left = list[bytes](), size
    while left:
        part = connection.recv(min(left, 1 << 16))
        if not part:
            if left == size:
                return None
            raise TcprosError(f"it closed with {left} of {size} bytes missing")
        parts.append(part)
        left -= len(part)
    return b"".join(parts)


def receive_block(connection: socket.socket, most: int) -> bytes | None:
    """Return the next block; None if the peer closed before it. Raises TcprosError, and OSError."""
    length = receive_exactly(connection, 4)
    if length is None:
        return None
    size = _LENGTH.unpack(length)[0]
    if size > most:
        raise TcprosError(f"it announced {size} bytes, more than {most}")
    if not size:
        return b""
    data = receive_exactly(connection, size)
    if data is None:
        raise TcprosError(f"it closed with {size} of {size} bytes missing")
    return data


def receive_header(connection: socket.socket) -> Header:
    """Return the first block of a connection. Raises TcprosError, and OSError."""
    data = receive_block(connection, MOST_HEADER)
    if data is None:
        raise TcprosError("it closed without a header")
    return parse_header(data)


def shut(connection: socket.socket) -> None:
    """Close the connection, also while another thread waits on it."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
    connection.close()
