"""Frames against pymavlink, both ways."""

from __future__ import annotations

import importlib.util
import struct
from array import array
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from messages import KINDS, MESSAGES, imu, same
from pymavlink.dialects.v20 import ardupilotmega as common
from pymavlink.dialects.v20 import development
from pymavlink.generator import mavgen
from python39 import strict_zip

from agent.wire import dialect
from agent.wire.codec import MessageRefusedError, Packer, decode, prepare
from agent.wire.framing import Framer


@pytest.fixture(scope="module")
def independent(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A codec that mavgen writes here and now, with pymavlink's own checksum."""
    output = tmp_path_factory.mktemp("codec") / "independent.py"
    definition = Path(__file__).parents[4] / "agent" / "wire" / "fleet.xml"
    options = mavgen.Opts(str(output), wire_protocol="2.0", language="Python3", validate=False)
    assert mavgen.mavgen(options, [str(definition)])
    spec = importlib.util.spec_from_file_location("independent", output)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def equal(ours: Any, theirs: Any) -> bool:
    header = ("get_srcSystem", "get_srcComponent", "get_seq", "get_type", "get_crc", "get_msgId")
    return all(getattr(ours, name)() == getattr(theirs, name)() for name in header) and all(
        same(getattr(ours, name), getattr(theirs, name)) for name in ours.get_fieldnames()
    )


@pytest.mark.medium
@settings(max_examples=400)
@given(message=MESSAGES, system=st.integers(0, 255), component=st.integers(0, 255), sequence=st.integers(0, 255))
def test_frames_go_both_ways_with_a_fresh_codec(
    independent: Any, message: Any, system: int, component: int, sequence: int
) -> None:
    packer = Packer(system, component)
    packer.sequence = sequence
    frame = packer.pack(message)
    theirs = independent.MAVLink(None, system, component)
    decoded = theirs.decode(bytearray(frame))
    assert equal(decode(frame), decoded)
    theirs.seq = sequence
    assert decoded.pack(theirs) == frame
    assert Framer(stream=False).feed(frame) == [frame]


def public_set(number: int) -> Any:
    """pymavlink's dialect that has the message."""
    return common if number in common.mavlink_map else development


def public_message(number: int, value: int) -> Any:
    """A message of pymavlink's own with every field set, extensions too."""
    kind = public_set(number).mavlink_map[number]
    fields: list[Any] = []
    for name, wire_type, order in strict_zip(kind.fieldnames, kind.fieldtypes, kind.orders):
        count = kind.array_lengths[order]
        if wire_type == "char":
            fields.append(name.encode()[:count])
        elif count:
            fields.append([value + index for index in range(count)])
        else:
            fields.append(value + len(fields))
    return kind(*fields)


@pytest.mark.parametrize("number", [number for number in KINDS if number < 54000])
def test_golden_frames_of_the_public_set(number: int) -> None:
    public = public_set(number).MAVLink(None, 7, 9)
    public.seq = 200
    message = public_message(number, 3)
    frame = message.pack(public)
    assert Framer(stream=False).feed(frame) == [frame]
    ours = decode(frame)
    assert equal(ours, public.decode(bytearray(frame)))

    packer = Packer(7, 9)
    packer.sequence = 200
    assert equal(ours, public.decode(bytearray(packer.pack(ours)))) or len(packer.pack(ours)) < len(frame)
    back = public.decode(bytearray(packer.pack(ours)))
    assert all(same(getattr(back, name), getattr(message, name)) for name in KINDS[number].fieldnames)


def test_one_frame_byte_by_byte() -> None:
    packer = Packer(system_id=1, component_id=191)
    packer.sequence = 42
    frame = packer.pack(dialect.MAVLink_xitl_tick_message(0x0102030405060708, 9))
    assert frame[:10] == bytes([0xFD, 9, 0, 0, 42, 1, 191]) + (54001).to_bytes(3, "little")
    assert frame[10:19] == struct.pack("<QB", 0x0102030405060708, 9)  # the three zero bytes at the end are not sent
    assert len(frame) == 21


def test_the_sequence_wraps_and_does_not_move_when_a_message_is_refused() -> None:
    packer = Packer(1, 1)
    numbers = [packer.pack(imu())[4] for _ in range(300)]
    assert numbers == [index % 256 for index in range(300)]
    for bad in (
        dialect.MAVLink_xitl_tick_message(-1, 0),
        dialect.MAVLink_xitl_imu_message(0, [0.0, 0.0], [0.0, 0.0, 0.0], 0.0),
        dialect.MAVLink_xitl_imu_message(0, [1e300, 0.0, 0.0], [0.0, 0.0, 0.0], 0.0),
        dialect.MAVLink_xitl_magnetometer_message(0, None),
        cloud_chunk(bytes(224)),
        cloud_chunk([256] * 225),
        cloud_chunk([0.5] * 225),
        cloud_chunk(225),
    ):
        with pytest.raises(MessageRefusedError, match=f"{bad.get_type()}: a field does not fit the wire"):
            packer.pack(bad)
    assert packer.sequence == 300 % 256


def cloud_chunk(points: Any) -> Any:
    return dialect.MAVLink_xitl_cloud_message(0, (0.0, 0.0, 0.0), 1, 0, 1, dialect.XITL_CLOUD_KIND_LIDAR, 25, points)


def test_an_array_of_bytes_may_be_any_sequence_of_whole_numbers() -> None:
    values = [(7 * index) % 256 for index in range(225)]
    kinds = (values, tuple(values), bytes(values), bytearray(values), array("B", values), array("H", values))
    frames = {Packer(1, 1).pack(cloud_chunk(kind)) for kind in kinds}
    assert len(frames) == 1
    assert decode(frames.pop()).points == values


def test_a_message_is_prepared_as_it_is_now_and_stays_as_it_is() -> None:
    message = imu()
    before = dict(vars(message))
    prepared, frame = prepare(message), Packer(1, 1).pack(message)
    assert vars(message) == before
    message.temperature += 1.0
    assert Packer(1, 1).pack_prepared(prepared) == frame != Packer(1, 1).pack(message)


def test_ids_must_fit_a_byte() -> None:
    with pytest.raises(ValueError, match="system_id = 256 does not fit a byte; use 1 to 255"):
        Packer(256, 1)
