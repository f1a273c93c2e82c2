"""`param.pck` as a real ArduRover gave it, and by pymavlink's decoder."""

from __future__ import annotations

import lzma
import math
import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.mavftp import MAVFTP

from agent.fcu.parameters import TABLE
from agent.mavlink.parameter_file import ParameterFileRow, ParameterQuery, pack_parameters, parse_query

CAPTURES = Path(__file__).parents[3] / "data" / "captures"
REAL = lzma.decompress((CAPTURES / "rover-parameters.pck.xz").read_bytes())
TYPES = {1: ("<b", 2), 2: ("<h", 4), 3: ("<i", 6), 4: ("<f", 9)}


def unpacked(data: bytes) -> list[ParameterFileRow]:
    """Read by the description in ArduPilot's source, AP_Filesystem_Param.cpp."""
    rows, name, at = [], "", 6
    while at < len(data):
        if data[at] == 0:
            at += 1
            continue
        layout, kind = TYPES[data[at] & 15]
        kept, more = data[at + 1] & 15, (data[at + 1] >> 4) + 1
        name = name[:kept] + data[at + 2 : at + 2 + more].decode()
        value_at, size = at + 2 + more, struct.calcsize(layout)
        (value,) = struct.unpack_from(layout, data, value_at)
        at = value_at + size
        default = value
        if data[value_at - 2 - more] >> 4:
            (default,) = struct.unpack_from(layout, data, at)
            at += size
            default += math.copysign(0.5, value) * (
                default == value
            )  # a whole number whose default in the source is none
        rows.append(ParameterFileRow(name, kind, value, default))
    return rows


ROWS = unpacked(REAL)


def test_a_real_rovers_parameters_pack_to_its_bytes() -> None:
    assert len(ROWS) == 1240
    assert pack_parameters(ROWS, ParameterQuery(with_defaults=True)) == REAL
    part = pack_parameters(ROWS, ParameterQuery(start=5, limit=10), piece=80)
    assert part == (CAPTURES / "rover-parameters-5-to-14.pck").read_bytes()


def test_ours_have_its_types() -> None:
    real = {row.name: row.type for row in ROWS}
    shared = {row.name: row.type for row in TABLE if row.name in real}
    assert len(shared) > 200
    assert shared == {name: real[name] for name in shared}


@settings(max_examples=30)
@given(st.integers(0, 30), st.integers(0, 30), st.booleans(), st.integers(8, 239))
def test_pymavlink_reads_any_part(start: int, count: int, with_defaults: bool, piece: int) -> None:
    rows = [ParameterFileRow(row.name, row.type, float(row.high), float(row.default)) for row in TABLE[:40]]
    found = MAVFTP.ftp_param_decode(pack_parameters(rows, ParameterQuery(start, count, with_defaults), piece))
    wanted = rows[start : start + count] if count else rows[start:]
    assert [name.decode() for name, _, _ in found.params] == [row.name for row in wanted]
    assert [value for _, value, _ in found.params] == pytest.approx([row.value for row in wanted], rel=1e-6)
    if with_defaults:
        assert [value for _, value, _ in found.defaults] == pytest.approx([row.default for row in wanted], rel=1e-6)


def test_the_query_is_read_as_ardupilot_reads_it() -> None:
    assert parse_query("") == ParameterQuery()
    assert parse_query("withdefaults=1") == ParameterQuery(with_defaults=True)
    assert parse_query("start=5&count=10") == ParameterQuery(5, 10)
    assert parse_query("colour=red&count=3") == ParameterQuery(limit=3)
    for bad in ("withdefaults=3", "start=65535", "count=-1", "start=x"):
        with pytest.raises(OSError, match=r"param\.pck"):
            parse_query(bad)
