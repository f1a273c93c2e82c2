"""Conversion between the generated message classes and raw frames. Only this module uses untyped generated code.

A slow board converts hundreds of messages a second. So frames are packed and unpacked with precomputed data of each
class. The bytes equal those of the generated code, which creates a dozen objects per message.
"""

from __future__ import annotations

import re
import struct
from typing import Any, Callable, NamedTuple, Optional, Protocol

from agent.wire import dialect
from agent.wire.crc import checksum
from agent.wire.framing import CHECKSUM_BYTES, HEADER_BYTES, MAGIC, MAGIC_1, SIGNATURE_BYTES, SIGNED, is_mavlink1


class Message(Protocol):
    """A message of the dialect. Its fields are attributes named as in xitl.xml and fleet.xml.

    Do not use `id`, because STATUSTEXT has a field with this name.
    """

    def get_msgId(self) -> int:  # noqa: N802  the generated name
        """Number of the message."""

    def get_type(self) -> str:
        """Name of the message, for instance XITL_IMU."""

    def get_srcSystem(self) -> int:  # noqa: N802
        """System that sent it."""

    def get_srcComponent(self) -> int:  # noqa: N802
        """Component that sent it."""

    def get_seq(self) -> int:
        """Sequence number of the frame."""

    def __getattr__(self, name: str) -> Any:
        """Value of a field."""


class MessageRefusedError(ValueError):
    """Raised for a message with fields that do not fit the wire."""


class Outgoing(Protocol):
    """Signs frames, see `agent.wire.signing`."""

    def signed(self, frame: bytes) -> bytes:
        """Return a frame, which is flagged as signed, with its signature."""


Prepared = tuple[Message, bytes]
"""A message with validated fields and its payload, to be framed later. Later changes of the message have no effect."""


_MAGIC_BYTE, _MAGIC_1_BYTE = bytes([MAGIC]), bytes([MAGIC_1])


class Packer:
    """Makes frames of one sender. `sequence` is the next sequence number. With `mavlink1` the frames are MAVLink 1."""

    def __init__(self, system_id: int, component_id: int, signing: Outgoing | None = None) -> None:
        for name, value in (("system_id", system_id), ("component_id", component_id)):
            if not 0 <= value <= 255:
                raise ValueError(f"link: {name} = {value} does not fit a byte; use 1 to 255")
        self.sequence = 0
        self.mavlink1 = False
        self.system_id = system_id
        self.component_id = component_id
        self._signing = signing
        self._flags = 0 if signing is None else SIGNED

    def pack(self, message: Message) -> bytes:
        """Return the next frame. Raises MessageRefusedError when a field does not fit its type.

        The sequence number then remains unchanged.
        """
        return self.pack_prepared(prepare(message))

    def pack_prepared(self, prepared: Prepared) -> bytes:
        """Return the next frame, from a prepared message."""
        message, payload = prepared
        number, crc_extra, _, _, size = _PACKING[type(message)]
        sequence = self.sequence
        if self.mavlink1:  # without the extensions, and with trailing zeros
            payload = payload[:size].ljust(size, b"\0")
            body = bytes((size, sequence, self.system_id, self.component_id, number[0])) + payload
            self.sequence = (sequence + 1) & 0xFF
            return _MAGIC_1_BYTE + body + checksum(body + crc_extra)
        body = bytes((len(payload), self._flags, 0, sequence, self.system_id, self.component_id)) + number + payload
        frame = _MAGIC_BYTE + body + checksum(body + crc_extra)
        self.sequence = (sequence + 1) & 0xFF
        return frame if self._signing is None else self._signing.signed(frame)


def fits_mavlink1(message: Message) -> bool:
    """Whether the message has a MAVLink 1 number."""
    return message.get_msgId() <= 255


def frame_sequence(frame: bytes) -> int:
    """Sequence number of a frame from a Packer."""
    return frame[4] if frame[0] == MAGIC else frame[2]


def came_as_mavlink1(message: Message) -> bool:
    """Whether a received message came in a MAVLink 1 frame, which has no extensions."""
    frame: bytes = getattr(message, "_msgbuf", b"")
    return len(frame) > HEADER_BYTES and is_mavlink1(frame)


def prepare(message: Message) -> Prepared:
    """Check the fields of a message and store them. Raises MessageRefusedError when a field does not fit its type."""
    packing = _PACKING[type(message)]
    try:
        payload: bytes = packing.pack(*packing.values(message))
    except (struct.error, OverflowError, TypeError, ValueError, IndexError) as error:
        raise MessageRefusedError(
            f"{message.get_type()}: a field does not fit the wire ({error}); check its value and length"
        ) from error
    return message, payload.rstrip(b"\0") or payload[:1]  # trailing zeros are not sent, except the first byte


def _octets(value: Any, count: int) -> bytes:
    """Return the first `count` values of an array of uint8_t, as the bytes that they are on the wire."""
    octets = value[:count] if isinstance(value, bytes) else bytes(list(value[:count]))
    if len(octets) != count:
        raise IndexError(f"{len(octets)} values for an array of {count}")
    return octets


class _Packing(NamedTuple):
    """Precomputed data of a message class."""

    number: bytes
    crc_extra: bytes
    pack: Callable[..., bytes]
    values: Callable[[Message], Any]
    """Getter of the values in wire order."""
    mavlink1_bytes: int
    """Payload size in MAVLink 1."""


def _packing(kind: Any) -> _Packing:
    items = []
    for name, count in zip(kind.ordered_fieldnames, kind.lengths):
        index = kind.fieldnames.index(name)
        is_text = kind.fieldtypes[index] == "char" and kind.array_lengths[kind.orders[index]]
        value = f"message._{name}_raw" if is_text else f"message.{name}"  # without `_raw`, a text is decoded
        if count > 1:
            value = f"_octets({value}, {count})" if kind.fieldtypes[index] == "uint8_t" else f"*{value}[:{count}]"
        items.append(value)
    mavlink1_bytes = dialect.MAVLINK1_PAYLOAD_BYTES.get(kind.id, kind.unpacker.size)
    number, crc_extra = kind.id.to_bytes(3, "little"), bytes([kind.crc_extra])
    return _Packing(number, crc_extra, _wire_format(kind).pack, _function("message", items), mavlink1_bytes)


def _wire_format(kind: Any) -> struct.Struct:
    """Return the format of a payload with each array of uint8_t as one value: a chunk of a cloud has 225 of them."""
    return struct.Struct(re.sub(r"(\d+)B", r"\1s", kind.unpacker.format))


def _function(argument: str, items: list[str]) -> Callable[[Any], Any]:
    """Return a function of one argument that returns a tuple of expressions. A loop over them takes twice as long."""
    function: Callable[[Any], Any] = eval(f"lambda {argument}: ({', '.join(items)},)")  # of names in the dialect alone
    return function


class _Packings(dict[Any, _Packing]):
    """Data of the message classes, made at the first message of each."""

    def __missing__(self, kind: Any) -> _Packing:
        packing = self[kind] = _packing(kind)
        return packing


_PACKING = _Packings()


Plan = tuple[Any, Any, int, Optional[Callable[[Any], Any]]]
"""Class, unpacking, size, and the function that arranges the values for the class; None if they are in order."""


class _Plans(dict[int, Plan]):
    """How to decode each message, made at the first one. Raises KeyError for an id that the dialect lacks."""

    def __missing__(self, number: int) -> Plan:
        kind: Any = dialect.mavlink_map[number]
        types = [kind.fieldtypes[kind.orders.index(order)] for order in range(len(kind.lengths))]
        octets = [of == "uint8_t" and count > 1 for of, count in zip(types, kind.lengths)]
        sizes = [1 if whole else count for whole, count in zip(octets, kind.lengths)]
        items = []
        for order in kind.orders:
            start, count = sum(sizes[:order]), sizes[order]
            value = f"v[{start}]" if count == 1 else f"list(v[{start}:{start + count}])"
            items.append(f"list({value})" if octets[order] else value)
        arrange = None if items == [f"v[{index}]" for index in range(len(items))] else _function("v", items)
        plan = self[number] = (kind, _wire_format(kind).unpack, kind.unpacker.size, arrange)
        return plan


_PLANS = _Plans()


def decode(frame: bytes) -> Message:
    """Return the message of a frame that a `Framer` has accepted. Its values are unchecked.

    Raises KeyError for an id that the dialect lacks.
    """
    number = frame[7] | frame[8] << 8 | frame[9] << 16
    kind, unpack, size, arrange = _PLANS[number]
    end = -(CHECKSUM_BYTES + SIGNATURE_BYTES) if frame[2] & SIGNED else -CHECKSUM_BYTES
    payload = frame[HEADER_BYTES:end]
    length = len(payload)
    if length != size:  # trailing zeros are not sent, and a newer sender may have more fields
        payload = payload + bytes(size - length) if length < size else payload[:size]
    values = unpack(payload)
    if arrange is not None:
        values = arrange(values)
    message = kind(*values)
    message._msgbuf = frame  # the header is made from it
    message._crc = frame[end] | frame[end + 1] << 8
    return message  # type: ignore[no-any-return]
