"""Between the generated message classes and raw frames. The one place that meets the untyped generated code."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple, Protocol

from agent.wire import dialect
from agent.wire.framing import CHECKSUM_BYTES, HEADER_BYTES, SIGNATURE_BYTES, SIGNED


class Message(Protocol):
    """A message of the dialect. Its fields are attributes named as in xitl.xml.

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

    sign_outgoing: bool

    def advance(self) -> None:
        """Called before each frame."""


class Prepared(NamedTuple):
    """A message whose fields are known to fit, to be framed later; later changes of the fields do not count."""

    message: Message
    payload: bytes


class _Unsigned:
    sign_outgoing = False

    def advance(self) -> None:
        pass


_UNSIGNED = _Unsigned()


class Packer:
    """Makes frames of one sender. `sequence` is the number of the next frame."""

    def __init__(self, system_id: int, component_id: int, signing: Outgoing = _UNSIGNED) -> None:
        for what, value in (("system_id", system_id), ("component_id", component_id)):
            if not 0 <= value <= 255:
                raise ValueError(f"link: {what} = {value} does not fit a byte; use 1 to 255")
        self.sequence = 0
        self.system_id = system_id
        self.component_id = component_id
        # The names that the generated pack() looks up.
        self.seq = 0
        self.srcSystem = system_id
        self.srcComponent = component_id
        self.signing = signing

    def pack(self, message: Message) -> bytes:
        """The next frame. Raises MessageRefusedError when a field does not fit its type.

        The sequence does not move then.
        """
        self.seq = self.sequence
        if self.signing.sign_outgoing:
            self.signing.advance()
        try:
            frame: bytes = message.pack(self)
        except (struct.error, OverflowError, TypeError, IndexError) as error:
            raise MessageRefusedError(
                f"{message.get_type()}: a field does not fit the wire ({error}); check its value and length"
            ) from error
        self.sequence = (self.sequence + 1) & 0xFF
        return frame

    def pack_prepared(self, prepared: Prepared) -> bytes:
        """The next frame, of a message that was prepared."""
        self.seq = self.sequence
        if self.signing.sign_outgoing:
            self.signing.advance()
        message, payload = prepared
        frame: bytes = message._pack(self, message.crc_extra, payload)
        self.sequence = (self.sequence + 1) & 0xFF
        return frame


_PREPARING = Packer(0, 0)


def prepare(message: Message) -> Prepared:
    """Check and keep the fields of a message. Raises MessageRefusedError when one does not fit its type."""
    _PREPARING.pack(message)
    return Prepared(message, bytes(message._payload))


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
