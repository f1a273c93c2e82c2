"""The dialect against the public MAVLink definitions, and the generated codec against its source."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as common
from pymavlink.dialects.v20 import development

from agent.wire import crc, dialect

ROOT = Path(__file__).parents[4]
STANDARD = [number for number in dialect.mavlink_map if number < 54000]


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.medium
def test_the_generated_codec_is_current() -> None:
    source = load(ROOT / "tools" / "generate_dialect.py").generated(ROOT / "agent" / "wire" / "fleet.xml")
    assert (ROOT / "agent" / "wire" / "dialect.py").read_text() == source, "run `make dialect`"


@pytest.mark.parametrize("number", STANDARD)
def test_a_standard_message_is_the_public_one(number: int) -> None:
    ours = dialect.mavlink_map[number]
    public = common.mavlink_map.get(number) or development.mavlink_map[number]
    fields = len(ours.fieldnames)
    assert ours.msgname == public.msgname
    assert ours.crc_extra == public.crc_extra
    assert public.fieldnames[:fields] == ours.fieldnames
    assert public.ordered_fieldnames[:fields] == ours.ordered_fieldnames
    assert public.fieldtypes[:fields] == ours.fieldtypes
    assert public.orders[:fields] == ours.orders
    assert public.lengths[:fields] == ours.lengths
    assert public.unpacker.format.startswith(ours.unpacker.format)
    # What ours leaves out may only be extensions: they do not count in the checksum and are last on the wire.
    assert max(ours.orders) == fields - 1


def test_the_enums_have_the_public_values() -> None:
    for name, entries in dialect.enums.items():
        if not name.startswith("XITL_"):
            public = common.enums[name]
            for value, entry in entries.items():
                if not entry.name.endswith("_ENUM_END"):
                    assert public[value].name == entry.name


def slow_checksum(data: bytes) -> int:
    """CRC-16/MCRF4XX bit by bit: polynomial 0x1021 reflected, initial value 0xFFFF."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0x8408 if value & 1 else value >> 1
    return value


def test_the_checksum_has_its_published_check_value() -> None:
    assert crc.x25crc(b"123456789").crc == 0x6F91  # reveng.sourceforge.io/crc-catalogue, CRC-16/MCRF4XX


@given(st.binary(max_size=300), st.binary(max_size=40))
def test_the_checksum_is_the_slow_one(first: bytes, second: bytes) -> None:
    ours = crc.x25crc(first)
    ours.accumulate(second)
    assert ours.crc == slow_checksum(first + second) == common.x25crc(first + second).crc
