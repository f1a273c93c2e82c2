"""Frames of every message, MAVLink 1 and 2, against pymavlink."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect
from pymavlink.generator.mavcrc import x25crc
from telemetry import frame

from xitl_cli.logs.formats.tlog.frames import FrameCounts, checksums, frame_tables

NUMBERS = sorted(dialect.mavlink_map)


def tables(frames: list[bytes], prefix: str = "") -> tuple[dict, FrameCounts]:
    count = len(frames)
    return frame_tables(prefix, frames, np.arange(count) * 1_000_000, np.arange(count) * 100)


@pytest.mark.medium
@pytest.mark.parametrize("form", ["first", "second", "signed"])
def test_every_message_is_read_as_pymavlink_reads_it(form: str) -> None:
    draw = random.Random(form)
    numbers = [number for number in NUMBERS if form != "first" or number < 256] * 3
    frames = [frame(draw, number, first=form == "first", signed=form == "signed") for number in numbers]
    found, counts = tables(frames)
    assert counts == FrameCounts(len(frames), len(frames), 0, len(frames) if form == "signed" else 0)
    parser = dialect.MAVLink(None)
    rows: dict[str, int] = {}
    for place, framed in enumerate(frames):
        truth = parser.decode(bytearray(framed))
        name = truth.get_type()
        row = rows[name] = rows.get(name, -1) + 1
        table = found[name]
        assert table.stamp_ns[row] == place * 1_000_000
        assert table.file_offset[row] == place * 100
        assert list(table.columns)[:-3] == list(truth.get_fieldnames())
        for column in truth.get_fieldnames():
            value = table.values(column, slice(row, row + 1), raw=True).tolist()[0]
            assert repr(value) == repr(getattr(truth, column)), (name, column)
        header = [int(table.values(name, slice(row, row + 1))[0]) for name in ("_sysid", "_compid", "_seq")]
        assert header == [truth.get_srcSystem(), truth.get_srcComponent(), truth.get_seq()]


@pytest.mark.medium
@given(st.lists(st.tuples(st.binary(min_size=0, max_size=40), st.integers(0, 255)), max_size=8), st.binary(max_size=3))
@settings(max_examples=60, deadline=None)
def test_checksums_of_many_at_once(parts: list[tuple[bytes, int]], before: bytes) -> None:
    data = np.frombuffer(before + b"".join(part for part, _ in parts), dtype=np.uint8)
    length = np.array([len(part) for part, _ in parts], dtype=np.int64)
    start = len(before) + np.cumsum(length) - length
    extra = np.array([last for _, last in parts], dtype=np.uint8)
    truth = [x25crc(part + bytes([last])).crc for part, last in parts]
    assert checksums(data, start, length, extra).tolist() == truth


def test_values_are_in_the_units_that_the_columns_name() -> None:
    sender = dialect.MAVLink(None, 1, 1)
    gps = dialect.MAVLink_gps_raw_int_message(
        5_000_000, 3, -351234567, 1491234567, 584_120, 121, 65535, 250, 17_000, 10
    )
    imu = dialect.MAVLink_scaled_imu2_message(1234, 1000, -500, 0, 1500, 0, 0, 300, 0, -100)
    battery = dialect.MAVLink_battery_status_message(1, 0, 0, 32767, [12_600] + [65535] * 9, -1, -1, -1, -1)
    found, _ = tables([bytes(one.pack(sender)) for one in (gps, imu, battery)])
    gps_table, imu_table, battery_table = (found[name] for name in ("GPS_RAW_INT", "SCALED_IMU2", "BATTERY_STATUS"))
    assert gps_table.columns["lat"].unit == "deg"
    assert gps_table.columns["lat"].raw_unit == "degE7"
    assert gps_table.values("lat")[0] == -35.1234567
    assert gps_table.values("alt")[0] == 584.12
    assert gps_table.values("vel")[0] == 2.5
    assert gps_table.values("cog")[0] == 170.0
    assert np.isnan(gps_table.values("epv")[0])
    assert gps_table.values("epv", raw=True)[0] == 65535
    assert gps_table.values("time_usec")[0] == 5_000_000
    assert gps_table.columns["time_usec"].unit == "us"
    assert imu_table.values("xacc")[0] == pytest.approx(9.80665)
    assert imu_table.columns["xacc"].unit == "m/s/s"
    assert imu_table.values("xgyro")[0] == 1.5
    assert imu_table.values("zmag")[0] == -0.1
    assert battery_table.instance == "id"
    assert battery_table.values("voltages")[0, 0] == 12.6
    assert np.isnan(battery_table.values("voltages")[0, 1:]).all()
    assert np.isnan(battery_table.values("temperature")[0])


def test_a_text_that_tells_instances_apart_is_no_instance_column() -> None:
    found, _ = tables([frame(random.Random(1), dialect.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT)])
    assert found["NAMED_VALUE_FLOAT"].instance is None


def test_what_is_no_frame_is_counted() -> None:
    draw = random.Random(3)
    good = frame(draw, dialect.MAVLINK_MSG_ID_HEARTBEAT)
    bad_checksum = good[:-1] + bytes([good[-1] ^ 1])
    cut, longer = good[:-3], good + b"\0"
    unknown = good[:7] + (0xABCDEF).to_bytes(3, "little") + good[10:]
    strange_flags = good[:2] + b"\x04" + good[3:]
    frames = [good, bad_checksum, cut, b"", longer, unknown, strange_flags, b"\x00\x01", b"\xfd", b"\xfe"]
    found, counts = tables(frames, "/link/agent/rx")
    assert list(found) == ["/link/agent/rx:HEARTBEAT"]
    assert len(found["/link/agent/rx:HEARTBEAT"]) == 1
    assert (counts.frames, counts.decoded, counts.damaged, counts.unknown) == (10, 1, 8, {0xABCDEF: 1})
    assert tables([])[1] == FrameCounts(0, 0, 0, 0)


def test_our_own_messages_are_read() -> None:
    from agent.wire import dialect as ours

    sender = ours.MAVLink(None, 1, 1)
    sample = ours.MAVLink_xitl_imu_message(1_000, [0.1, 0.2, 0.3], [1.0, 2.0, -9.81], 21.5)
    found, counts = tables([bytes(sample.pack(sender))])
    assert counts.decoded == 1
    table = found["XITL_IMU"]
    assert table.columns["accel"].shape == (3,)
    assert table.values("accel").tolist() == [[1.0, 2.0, float(np.float32(-9.81))]]


@pytest.mark.medium
@given(st.lists(st.binary(max_size=60), max_size=20))
@settings(max_examples=100, deadline=None)
def test_any_bytes_are_decoded_or_counted(frames: list[bytes]) -> None:
    found, counts = tables(frames)
    assert counts.decoded == sum(map(len, found.values()))
    assert counts.decoded + counts.damaged + sum(counts.unknown.values()) == counts.frames == len(frames)
    for table in found.values():
        for column in table.columns:
            assert len(table.values(column)) == len(table)


def test_rows_are_chosen_in_every_way() -> None:
    draw = random.Random(5)
    frames = [frame(draw, dialect.MAVLINK_MSG_ID_ATTITUDE) for _ in range(10)]
    table = tables(frames)[0]["ATTITUDE"]
    every = table.values("roll")
    odd = np.arange(10) % 2 == 1
    for rows in (slice(2, 7), np.array([7, 1, 1]), odd):
        np.testing.assert_array_equal(table.values("roll", rows), every[rows])
    with pytest.raises(KeyError):
        table.values("rol")
