"""Conversion between the generated message classes and raw frames; the one place with untyped generated code.

Hundreds of messages a second pass here on a slow board: frames are made and read with what is known of each class
beforehand, the same bytes as the generated code makes with a dozen objects a message.
"""

from __future__ import annotations

import struct
from operator import attrgetter
from typing import Any, Callable, NamedTuple, Protocol

from agent.wire import dialect
from agent.wire.crc import checksum
from agent.wire.framing import CHECKSUM_BYTES, HEADER_BYTES, MAGIC, MAGIC_1, SIGNATURE_BYTES, SIGNED, is_mavlink1


class Message(Protocol):
    """A message of the dialect. Its fields are attributes named as in xitl.xml and fleet.xml.

    `id` is no guide, as STATUSTEXT has a field of that name.
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
        """A field."""


class MessageRefusedError(ValueError):
    """A message whose fields do not fit the wire."""


class Outgoing(Protocol):
    """How frames are signed, see `agent.wire.signing`."""

    def signed(self, frame: bytes) -> bytes:
        """A frame that says it is signed, with its signature."""


Prepared = tuple[Message, bytes]
"""A message whose fields are known to fit and its payload, to be framed later; later changes do not count."""


_MAGIC_BYTE, _MAGIC_1_BYTE = bytes([MAGIC]), bytes([MAGIC_1])


class Packer:
    """Makes frames of one sender. `sequence` is the number of the next one; with `mavlink1` they are of MAVLink 1."""

    def __init__(self, system_id: int, component_id: int, signing: Outgoing | None = None) -> None:
        for what, value in (("system_id", system_id), ("component_id", component_id)):
            if not 0 <= value <= 255:
                raise ValueError(f"link: {what} = {value} does not fit a byte; use 1 to 255")
        self.sequence = 0
        self.mavlink1 = False
        self.system_id = system_id
        self.component_id = component_id
        self._signing = signing
        self._flags = 0 if signing is None else SIGNED

    def pack(self, message: Message) -> bytes:
        """The next frame. Raises MessageRefusedError when a field does not fit its type.

        The sequence does not move then.
        """
        return self.pack_prepared(prepare(message))

    def pack_prepared(self, prepared: Prepared) -> bytes:
        """The next frame, of a message that was prepared."""
        message, payload = prepared
        number, crc_extra, *_ = _PACKING[type(message)]
        sequence = self.sequence
        if self.mavlink1:
            self.sequence = (sequence + 1) & 0xFF
            return _mavlink1_frame(prepared, (sequence, self.system_id, self.component_id))
        body = bytes((len(payload), self._flags, 0, sequence, self.system_id, self.component_id)) + number + payload
        frame = _MAGIC_BYTE + body + checksum(body + crc_extra)
        self.sequence = (sequence + 1) & 0xFF
        return frame if self._signing is None else self._signing.signed(frame)


def fits_mavlink1(message: Message) -> bool:
    """Whether MAVLink 1 has a number for it."""
    return message.get_msgId() <= 255


def _mavlink1_frame(prepared: Prepared, sender: tuple[int, int, int]) -> bytes:
    """Whole, but for the extensions. sender: sequence number, system, component."""
    message, payload = prepared
    packing = _PACKING[type(message)]
    size = packing.mavlink1_bytes
    payload = payload[:size].ljust(size, b"\0")
    body = bytes((size, *sender, packing.number[0])) + payload
    return _MAGIC_1_BYTE + body + checksum(body + packing.crc_extra)


def frame_sequence(frame: bytes) -> int:
    """Sequence number of a frame of ours."""
    return frame[4] if frame[0] == MAGIC else frame[2]


def came_as_mavlink1(message: Message) -> bool:
    """Whether a message that was received came in a frame of MAVLink 1, which has no extensions."""
    frame: bytes = getattr(message, "_msgbuf", b"")
    return len(frame) > HEADER_BYTES and is_mavlink1(frame)


def prepare(message: Message) -> Prepared:
    """Check and keep the fields of a message. Raises MessageRefusedError when one does not fit its type."""
    _, _, pack, fields, lengths, _ = _PACKING[type(message)]
    try:
        values = fields(message)
        if lengths is not None:
            flat: list[Any] = []
            for value, count in zip(values, lengths):
                if count == 1:
                    flat.append(value)
                else:
                    flat += value[:count]
            values = flat
        payload: bytes = pack(*values)
    except (struct.error, OverflowError, TypeError, IndexError) as error:
        raise MessageRefusedError(
            f"{message.get_type()}: a field does not fit the wire ({error}); check its value and length"
        ) from error
    return message, payload.rstrip(b"\0") or payload[:1]  # zeros at the end are not sent, but for the first


class _Packing(NamedTuple):
    """What is known of a class before a message is packed. fields: in the order of the wire.

    lengths: how many values each field has there, None where all have one. mavlink1_bytes: of the payload there.
    """

    number: bytes
    crc_extra: bytes
    pack: Callable[..., bytes]
    fields: Callable[[Message], Any]
    lengths: tuple[int, ...] | None
    mavlink1_bytes: int


def _is_text(kind: Any, name: str) -> bool:
    index = kind.fieldnames.index(name)
    return bool(kind.fieldtypes[index] == "char" and kind.array_lengths[kind.orders[index]])


def _packing(kind: Any) -> _Packing:
    # Of a text the message has what a reader wants and, by another name, what is on the wire.
    names = [f"_{name}_raw" if _is_text(kind, name) else name for name in kind.ordered_fieldnames]
    of_names = attrgetter(*names)
    lengths = None if all(count == 1 for count in kind.lengths) else tuple(kind.lengths)
    fields = of_names if len(names) > 1 else lambda message: (of_names(message),)
    mavlink1_bytes = dialect.MAVLINK1_PAYLOAD_BYTES.get(kind.id, kind.unpacker.size)
    number, crc_extra = kind.id.to_bytes(3, "little"), bytes([kind.crc_extra])
    return _Packing(number, crc_extra, kind.unpacker.pack, fields, lengths, mavlink1_bytes)


_PACKING: dict[Any, _Packing] = {kind: _packing(kind) for kind in dialect.mavlink_map.values()}


Step = tuple[int, int]  # where a field starts among the unpacked values, how many it takes
Plan = tuple[Any, Any, int, tuple[Step, ...], bool]


def _plan(kind: Any) -> Plan:
    steps = tuple((sum(kind.lengths[:order]), kind.lengths[order]) for order in kind.orders)
    straight = all(step == (index, 1) for index, step in enumerate(steps))
    return kind, kind.unpacker.unpack, kind.unpacker.size, steps, straight


_PLANS: dict[int, Plan] = {number: _plan(kind) for number, kind in dialect.mavlink_map.items()}


def decode(frame: bytes) -> Message:
    """The message in a frame that a `Framer` found good; any values are possible in it.

    Raises KeyError for an id the dialect does not have.
    """
    number = frame[7] | frame[8] << 8 | frame[9] << 16
    kind, unpack, size, steps, straight = _PLANS[number]
    end = -(CHECKSUM_BYTES + SIGNATURE_BYTES) if frame[2] & SIGNED else -CHECKSUM_BYTES
    payload = frame[HEADER_BYTES:end]
    length = len(payload)
    if length != size:  # trailing zeros are not sent, and a newer sender may have more fields
        payload = payload + bytes(size - length) if length < size else payload[:size]
    values = unpack(payload)
    if not straight:
        values = [values[start] if count == 1 else list(values[start : start + count]) for start, count in steps]
    message = kind(*values)
    header = message._header
    _, header.mlen, header.incompat_flags, header.compat_flags = frame[:4]
    header.seq, header.srcSystem, header.srcComponent = frame[4:7]
    message._msgbuf = frame
    message._payload = payload
    message._crc = frame[end] | frame[end + 1] << 8
    return message  # type: ignore[no-any-return]
