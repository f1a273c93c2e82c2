"""Signatures against pymavlink's own, both ways, and what is refused."""

from __future__ import annotations

import hashlib
import io
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as public

from agent.wire import dialect
from agent.wire.codec import Packer
from agent.wire.framing import Framer
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from agent.wire.signing import MINUTE, Signing, SigningKeyError, read_key

KEY = hashlib.sha256(b"key").digest()
NOW = 40_000_000_000_000


def theirs(key: bytes = KEY, timestamp: int = NOW, link_id: int = 3) -> Any:
    sender = public.MAVLink(io.BytesIO(), 255, 190)
    sender.signing.secret_key = key
    sender.signing.sign_outgoing = True
    sender.signing.timestamp = timestamp
    sender.signing.link_id = link_id
    return sender


def beat(sender: Any) -> bytes:
    frame: bytes = public.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(sender)
    sender.seq = (sender.seq + 1) % 256
    return frame


def ours(now: int = NOW) -> Signing:
    return Signing(KEY, lambda: now)


@pytest.mark.medium
@given(st.binary(min_size=32, max_size=32), st.integers(0, 2**48 - 1), st.integers(0, 255), st.floats(width=32))
def test_what_we_sign_pymavlink_accepts(key: bytes, now: int, link_id: int, value: float) -> None:
    signing = Signing(key, lambda: now)
    packer = Packer(1, 1, signing.outgoing(link_id))
    receiver = public.MAVLink(None)
    receiver.signing.secret_key = key
    receiver.signing.allow_unsigned_callback = lambda *_: False
    for _ in range(2 if now < 2**48 - 3 else 1):
        frame = packer.pack(dialect.MAVLink_param_value_message(b"WP_SPEED", value, 9, 3, 2))
        (message,) = receiver.parse_buffer(frame)
        assert message.get_type() == "PARAM_VALUE"
        assert message.get_signed()
        assert message.get_link_id() == link_id


@pytest.mark.medium
@given(st.binary(min_size=32, max_size=32), st.integers(MINUTE, 2**48 - 3), st.integers(0, 255))
def test_what_pymavlink_signs_we_accept_once(key: bytes, now: int, link_id: int) -> None:
    sender = theirs(key, now, link_id)
    signing = Signing(key, lambda: now)
    first, second = beat(sender), beat(sender)
    assert Framer(stream=True).feed(first + second) == [first, second]
    assert signing.accepts(first)
    assert signing.accepts(second)
    assert not signing.accepts(second)
    assert not signing.accepts(first)
    assert signing.refused_old == 2


@pytest.mark.medium
@given(st.data())
def test_a_change_of_any_byte_is_refused(data: Any) -> None:
    frame = bytearray(beat(theirs()))
    at = data.draw(st.integers(3, len(frame) - 1))
    frame[at] ^= data.draw(st.integers(1, 255))
    signing = ours()
    assert not signing.accepts(bytes(frame))
    assert signing.refused_signature == 1


def test_the_wrong_key_and_no_key_are_refused_but_radios_may_speak() -> None:
    signing = ours()
    assert not signing.accepts(beat(theirs(hashlib.sha256(b"other").digest())))
    plain = public.MAVLink(io.BytesIO(), 255, 190)
    assert not signing.accepts(beat(plain))
    assert signing.accepts(public.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1).pack(plain))
    assert (signing.refused, signing.refused_signature, signing.refused_unsigned) == (2, 1, 1)


def test_a_new_stream_may_be_a_minute_behind_and_pulls_us_ahead() -> None:
    assert ours().accepts(beat(theirs(timestamp=NOW - MINUTE)))
    assert not ours().accepts(beat(theirs(timestamp=NOW - MINUTE - 1)))
    signing = ours()
    assert signing.accepts(beat(theirs(timestamp=NOW + 500)))
    assert signing.next_timestamp() == NOW + 501
    assert signing.next_timestamp() == NOW + 502


def test_streams_are_kept_apart_and_bounded() -> None:
    signing = ours()
    for link_id in range(100):
        assert signing.accepts(beat(theirs(timestamp=NOW + link_id, link_id=link_id)))
    old = theirs(timestamp=NOW, link_id=99)
    assert not signing.accepts(beat(old))


def test_timestamps_never_go_back_with_the_clock() -> None:
    instants = iter([100, 50, 50, 200])
    signing = Signing(KEY, lambda: next(instants))
    assert [signing.next_timestamp() for _ in range(4)] == [100, 101, 102, 200]


def test_a_link_drops_and_counts_what_is_not_signed() -> None:
    here, there = memory_pair()
    guarded = Link(here, 1, 1, signing=ours(), link_id=7)
    stranger = Link(there, 255, 190)
    stranger.send(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
    assert guarded.receive() == []
    assert guarded.refused_signature == 1
    assert guarded.counters.lost == 0
    holder = Link(there, 255, 190, signing=ours(), link_id=1)
    holder.send(
        dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3), dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)
    )
    assert [message.get_type() for message in guarded.receive()] == ["HEARTBEAT", "HEARTBEAT"]
    guarded.send(dialect.MAVLink_heartbeat_message(11, 3, 0, 0, 0, 3))
    (message,) = holder.receive()
    assert message.get_srcSystem() == 1


def test_keys_come_as_digits_or_as_a_passphrase() -> None:
    assert read_key(KEY.hex().upper() + "\n", "key.txt") == KEY
    assert read_key("key\n", "key.txt") == KEY
    assert read_key("z" * 64, "key.txt") == hashlib.sha256(b"z" * 64).digest()
    with pytest.raises(SigningKeyError, match=r"key\.txt: contains no signing key; write 64 hexadecimal digits"):
        read_key(" \n", "key.txt")
    with pytest.raises(ValueError, match="a key of 3 bytes; use 32"):
        Signing(b"abc")
