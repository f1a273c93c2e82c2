"""The part of DDS's wire protocol that services need: RTPS 2.3 messages and parameter lists, as pure functions on
bytes.

DDSI-RTPS 2.3 (OMG formal/19-04-03): submessages in 8.3.7 and 9.4.5, parameter lists in 9.4.2.11, ports in 9.6.1.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import field

from sim_core.dataclass import dataclass

PREFIX_BYTES = 12
VERSION = b"\x02\x03"
UNKNOWN_VENDOR, CYCLONE = b"\x00\x00", b"\x01\x10"
PAD, ACKNACK, HEARTBEAT, GAP, INFO_TIMESTAMP, INFO_DESTINATION, DATA = 0x01, 0x06, 0x07, 0x08, 0x09, 0x0E, 0x15
NO_ENTITY = b"\0\0\0\0"
PARTICIPANT = bytes.fromhex("000001c1")
SPDP_WRITER = bytes.fromhex("000100c2")
PUBLICATIONS_WRITER, PUBLICATIONS_READER = bytes.fromhex("000003c2"), bytes.fromhex("000003c7")
SUBSCRIPTIONS_WRITER, SUBSCRIPTIONS_READER = bytes.fromhex("000004c2"), bytes.fromhex("000004c7")
WRITER_KIND, READER_KIND = b"\x03", b"\x04"
"""Kinds of user-defined entities without a key."""
PID_SENTINEL, PID_LEASE, PID_TOPIC, PID_TYPE = 0x01, 0x02, 0x05, 0x07
PID_VERSION, PID_VENDOR, PID_RELIABILITY, PID_DURABILITY, PID_USER_DATA = 0x15, 0x16, 0x1A, 0x1D, 0x2C
PID_UNICAST, PID_DEFAULT_UNICAST, PID_META_UNICAST = 0x2F, 0x31, 0x32
PID_PARTICIPANT_GUID, PID_ENDPOINTS, PID_ENDPOINT_GUID = 0x50, 0x58, 0x5A
PID_KEY, PID_STATUS, PID_REPRESENTATION, PID_RELATED, PID_RELATED_EPROSIMA = 0x70, 0x71, 0x73, 0x83, 0x800F
PARAMETERS_LE = b"\0\3\0\0"
RELIABLE, VOLATILE = struct.pack("<Iii", 2, 0, 100_000_000), struct.pack("<I", 0)
UDP_V4 = 1
MOST_BITS = 256
_LITTLE, _INLINE_QOS, _PAYLOAD, _FINAL = 0x01, 0x02, 0x04, 0x02


@dataclass(frozen=True, slots=True)
class Submessage:
    """A received submessage."""

    kind: int
    reader: bytes = NO_ENTITY
    writer: bytes = NO_ENTITY
    first: int = 0
    """For DATA, its sequence number."""
    last: int = 0
    numbers: tuple[int, ...] = ()
    """Missing sequence numbers, or members of a set."""
    final: bool = False
    inline: dict[int, bytes] = field(default_factory=dict)
    payload: bytes = b""


@dataclass(frozen=True, slots=True)
class Packet:
    """Submessages from a participant, each with its destination: a prefix of 12 bytes, or zeros for all."""

    vendor: bytes
    prefix: bytes
    parts: tuple[tuple[bytes, Submessage], ...]


# Writing


def packet(prefix: bytes, parts: Iterable[bytes], destination: bytes = b"") -> bytes:
    """Return a message of submessages; destination: the prefix of the receiving participant."""
    head = b"RTPS" + VERSION + UNKNOWN_VENDOR + prefix
    if destination:
        head += _submessage(INFO_DESTINATION, destination)
    return head + b"".join(parts)


def data(reader: bytes, writer: bytes, number: int, payload: bytes, inline: Sequence[tuple[int, bytes]] = ()) -> bytes:
    """Return DATA; payload: with its encapsulation."""
    body = struct.pack("<HH", 0, 16) + reader + writer + sequence_number(number)
    flags = _PAYLOAD
    if inline:
        flags |= _INLINE_QOS
        body += parameters(inline)
    return _submessage(DATA, body + payload + b"\0" * (-len(payload) % 4), flags)


def heartbeat(reader: bytes, writer: bytes, first: int, last: int, count: int) -> bytes:
    """Return a HEARTBEAT that requests an answer."""
    numbers = sequence_number(first) + sequence_number(last)
    return _submessage(HEARTBEAT, reader + writer + numbers + struct.pack("<I", count))


def acknack(reader: bytes, writer: bytes, base: int, missing: Iterable[int], count: int) -> bytes:
    """Return an ACKNACK: all before `base` have arrived, and `missing` have not."""
    wanted = [number - base for number in missing if number - base < MOST_BITS]
    bits = max(wanted, default=-1) + 1
    words = [0] * ((bits + 31) // 32)
    for bit in wanted:
        words[bit // 32] |= 1 << (31 - bit % 32)
    numbers = sequence_number(base) + struct.pack(f"<I{len(words)}I", bits, *words)
    return _submessage(ACKNACK, reader + writer + numbers + struct.pack("<I", count), 0 if wanted else _FINAL)


def parameters(values: Iterable[tuple[int, bytes]]) -> bytes:
    """Return a parameter list with its sentinel."""
    whole = b""
    for pid, value in values:
        padded = value + b"\0" * (-len(value) % 4)
        whole += struct.pack("<HH", pid, len(padded)) + padded
    return whole + struct.pack("<HH", PID_SENTINEL, 0)


def text(value: str) -> bytes:
    """Return a CDR string."""
    encoded = value.encode() + b"\0"
    return struct.pack("<I", len(encoded)) + encoded


def locator(address: str, port: int) -> bytes:
    """Return a locator of UDP over IPv4."""
    return struct.pack("<iI12x4B", UDP_V4, port, *(int(part) for part in address.split(".")))


def _submessage(kind: int, body: bytes, flags: int = 0) -> bytes:
    return struct.pack("<BBH", kind, flags | _LITTLE, len(body)) + body


def sequence_number(number: int) -> bytes:
    """Return the high and the low half."""
    return struct.pack("<iI", number >> 32, number & 0xFFFFFFFF)


# Reading: data other than RTPS gives nothing, and no function raises


def read_packet(received: bytes) -> Packet | None:
    """Return None for data other than RTPS. Unused kinds of submessages are omitted."""
    if len(received) < 20 or received[:4] != b"RTPS":
        return None
    try:
        return Packet(received[6:8], received[8:20], tuple(_read_parts(received)))
    except (struct.error, IndexError, ValueError):
        return None


def _read_parts(received: bytes) -> Iterator[tuple[bytes, Submessage]]:
    destination, at = b"\0" * PREFIX_BYTES, 20
    while at + 4 <= len(received):
        kind, flags = received[at], received[at + 1]
        order = "<" if flags & _LITTLE else ">"
        (length,) = struct.unpack_from(f"{order}H", received, at + 2)
        to_the_end = not length and kind not in (PAD, INFO_TIMESTAMP)  # 9.4.5.1.3
        body = received[at + 4 :] if to_the_end else received[at + 4 : at + 4 + length]
        at += 4 + len(body)
        if kind == INFO_DESTINATION:
            destination = body[:PREFIX_BYTES]
        elif kind == DATA and len(body) >= 20:
            yield destination, _read_data(body, flags, order)
        elif kind == HEARTBEAT and len(body) >= 28:
            first, last = _read_number(body, 8, order), _read_number(body, 16, order)
            yield destination, Submessage(kind, body[:4], body[4:8], first, last, final=bool(flags & _FINAL))
        elif kind == ACKNACK and len(body) >= 24:
            base, numbers = _read_numbers(body, 8, order)
            yield destination, Submessage(kind, body[:4], body[4:8], base, 0, numbers, bool(flags & _FINAL))
        elif kind == GAP and len(body) >= 28:
            start = _read_number(body, 8, order)
            base, numbers = _read_numbers(body, 16, order)
            yield destination, Submessage(kind, body[:4], body[4:8], start, base, numbers)


def _read_data(body: bytes, flags: int, order: str) -> Submessage:
    (to_inline,) = struct.unpack_from(f"{order}H", body, 2)
    inline: dict[int, bytes] = {}
    at = 4 + to_inline
    if flags & _INLINE_QOS:
        while True:
            pid, length = struct.unpack_from(f"{order}HH", body, at)
            at += 4
            if pid == PID_SENTINEL:
                break
            inline[pid] = body[at : at + length]
            at += length
    payload = body[at:] if flags & _PAYLOAD else b""
    return Submessage(DATA, body[4:8], body[8:12], _read_number(body, 12, order), inline=inline, payload=payload)


def read_parameters(payload: bytes) -> dict[int, list[bytes]]:
    """Return the values of a payload with its encapsulation by their number. `number_order` gives their byte order."""
    values: dict[int, list[bytes]] = {}
    at, order = 4, number_order(payload)
    while at + 4 <= len(payload):
        pid, length = struct.unpack_from(f"{order}HH", payload, at)
        if pid == PID_SENTINEL:
            break
        values.setdefault(pid, []).append(payload[at + 4 : at + 4 + length])
        at += 4 + length
    return values


def number_order(payload: bytes) -> str:
    """Return the byte order sign of struct for the numbers of a payload."""
    return "<" if payload[1:2] and payload[1] & 1 else ">"


def read_text(value: bytes, order: str = "<") -> str:
    """Return a CDR string; empty for invalid data."""
    if len(value) < 5:
        return ""
    (length,) = struct.unpack_from(f"{order}I", value)
    return value[4 : 3 + length].decode(errors="replace")


def read_locator(value: bytes, order: str = "<") -> tuple[str, int] | None:
    """Return address and port of UDP over IPv4; None for another kind."""
    if len(value) < 24:
        return None
    kind, port = struct.unpack_from(f"{order}iI", value)
    return (".".join(map(str, value[20:24])), port) if kind == UDP_V4 and 0 < port < 65536 else None


def _read_number(body: bytes, at: int, order: str) -> int:
    high, low = struct.unpack_from(f"{order}iI", body, at)
    return int(high << 32 | low)


def _read_numbers(body: bytes, at: int, order: str) -> tuple[int, tuple[int, ...]]:
    """Return base and members of a sequence number set."""
    base = _read_number(body, at, order)
    (bits,) = struct.unpack_from(f"{order}I", body, at + 8)
    if bits > MOST_BITS:
        raise ValueError("more bits than a set has")
    words = struct.unpack_from(f"{order}{(bits + 31) // 32}I", body, at + 12)
    return base, tuple(base + bit for bit in range(bits) if words[bit // 32] >> (31 - bit % 32) & 1)
