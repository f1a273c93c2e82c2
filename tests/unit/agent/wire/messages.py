"""Hypothesis strategies for messages of the dialect, and frames of them."""

from __future__ import annotations

import struct
from typing import Any

from hypothesis import strategies as st
from python39 import strict_zip

from agent.wire import dialect
from agent.wire.codec import Packer

INTEGERS = {f"{sign}int{bits}_t": (sign, bits) for sign in ("", "u") for bits in (8, 16, 32, 64)}


def _scalar(wire_type: str) -> st.SearchStrategy[Any]:
    if wire_type == "float":
        return st.floats(width=32)
    if wire_type == "double":
        return st.floats()
    sign, bits = INTEGERS[wire_type]
    return st.integers(0, 2**bits - 1) if sign else st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def _field(wire_type: str, count: int) -> st.SearchStrategy[Any]:
    if wire_type == "char":
        return st.text(st.characters(min_codepoint=1, max_codepoint=127), max_size=count).map(str.encode)
    one = _scalar(wire_type)
    return st.lists(one, min_size=count, max_size=count) if count else one


def _messages_of(kind: Any) -> st.SearchStrategy[Any]:
    fields = [
        _field(wire_type, kind.array_lengths[order]) for wire_type, order in strict_zip(kind.fieldtypes, kind.orders)
    ]
    return st.tuples(*fields).map(lambda values: kind(*values))


KINDS = dict(sorted(dialect.mavlink_map.items()))
MESSAGES = st.one_of([_messages_of(kind) for kind in KINDS.values()])
FRAMES = MESSAGES.map(lambda message: Packer(1, 1).pack(message))


def same(a: Any, b: Any) -> bool:
    """Whether two field values are equal, NaN being equal to itself."""
    if isinstance(a, float):
        return (isinstance(b, float) and struct.pack("<d", a) == struct.pack("<d", b)) or a == b or (a != a and b != b)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(same(x, y) for x, y in strict_zip(a, b))
    return bool(a == b)


def imu(time_usec: int = 1) -> Any:
    """An IMU message like those on the link."""
    return dialect.MAVLink_xitl_imu_message(time_usec, [0.1, -0.2, 0.3], [0.5, -0.5, -9.8], 25.0)


def garbage_free_of_frames() -> st.SearchStrategy[bytes]:
    """Any bytes, rich in the first byte of a frame and in message numbers that exist."""
    header = st.builds(
        lambda length, flags, rest, number: bytes([0xFD, length, flags, *rest]) + number.to_bytes(3, "little"),
        st.integers(0, 255),
        st.sampled_from([0, 1, 2]),
        st.tuples(*[st.integers(0, 255)] * 4),
        st.sampled_from(list(KINDS)),
    )
    return st.lists(st.one_of(st.binary(max_size=40), st.just(b"\xfd"), header), max_size=8).map(b"".join)
