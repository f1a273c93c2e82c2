"""Telemetry logs against pymavlink's reader: whole ones message by message, damaged ones at least as much."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect
from telemetry import START_US, frame, record, theirs

from tests.recorded import MISSION_TLOG
from xitl_cli.logs import LogError, open_log
from xitl_cli.logs.formats.tlog import file as file_module
from xitl_cli.logs.formats.tlog.file import TelemetryLog

NUMBERS = sorted(dialect.mavlink_map)


def random_log(seed: int, count: int) -> list[bytes]:
    draw = random.Random(seed)
    records = []
    for at in range(count):
        number, signed = draw.choice(NUMBERS), at % 7 == 0
        # Of a frame of MAVLink 1 with less, pymavlink takes the next stamp's first bytes along.
        long_enough = dialect.mavlink_map[number].unpacker.size >= 4
        first = number < 256 and long_enough and not signed and draw.random() < 0.3
        records.append(record(START_US + at * 10_000, frame(draw, number, first=first, signed=signed)))
    return records


def assert_equal(log: TelemetryLog, truth: dict) -> None:
    assert sorted(log.tables) == sorted(truth)
    for name, messages in truth.items():
        table = log.tables[name]
        assert (table.stamp_ns // 1000).tolist() == [round(stamp * 1e6) for stamp, _ in messages]
        for column in messages[0][1].get_fieldnames():
            ours = table.values(column, raw=True).tolist()
            assert repr(ours) == repr([getattr(one, column) for _, one in messages]), (name, column)
        assert table.values("_seq").tolist() == [one.get_seq() for _, one in messages]
        assert table.values("_sysid").tolist() == [one.get_srcSystem() for _, one in messages]


@pytest.mark.medium
def test_a_real_one() -> None:
    truth, bad = theirs(MISSION_TLOG)
    assert bad == 0
    with TelemetryLog(MISSION_TLOG) as log:
        assert_equal(log, truth)
        assert log.base == "utc"
        assert log.health.records == sum(map(len, truth.values()))
        assert not log.health.degraded


@pytest.mark.medium
@pytest.mark.parametrize("block_bytes", [500, 1 << 20])
def test_every_message_in_both_versions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block_bytes: int) -> None:
    monkeypatch.setattr(file_module, "BLOCK_BYTES", block_bytes)
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(random_log(1, 1500)))
    truth, bad = theirs(path)
    assert bad == 0
    with TelemetryLog(path) as log:
        assert_equal(log, truth)
        assert not log.health.degraded
        assert int(log.facts["signed frames"]) == len(range(0, 1500, 7))


def test_a_lone_byte_that_could_begin_a_frame_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(bytes.fromhex("fe000000000000022d"))
    with pytest.raises(LogError):
        open_log(path)
    found = file_module.index_frames(np.fromfile(path, dtype=np.uint8))
    assert (len(found.start), found.losses.lost_bytes + found.losses.truncated_bytes) == (0, 9)


def test_frames_between_strange_bytes_are_read_if_their_stamps_are_near(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a whole part, no frame is followed by another one: only checksum and stamp speak for it."""
    records, year_us = random_log(3, 60), 365 * 86_400_000_000
    whole = b"".join(records[:20])
    monkeypatch.setattr(file_module, "BLOCK_BYTES", len(whole))
    far = record(START_US + 20 * year_us, frame(random.Random(0), 0))
    strange = b"".join(bytes(3) + one for one in [*records[20:30], far, *records[30:]])
    found = file_module.index_frames(np.frombuffer(whole + strange + bytes(3), dtype=np.uint8))
    assert found.stamp_us.tolist() == [START_US + at * 10_000 for at in range(60)]


def test_of_unknown_messages_the_most_frequent_are_named(tmp_path: Path) -> None:
    """Numbers 30019 to 30008 occur once to twelve times, in frames without a payload."""
    numbers = [30_020 - count for count in range(1, 13) for _ in range(count)]
    frames = [b"\xfd\0\0\0\0\1\1" + number.to_bytes(3, "little") + bytes(2) for number in numbers]
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join([*random_log(1, 30), *(record(START_US + 400_000, one) for one in frames)]))
    with TelemetryLog(path) as log:
        named = [(name, count) for name, (count, _) in log.health.undecoded.items()]
    most = [(f"message {30_020 - count}", count) for count in range(12, 0, -1)]
    listed = len(named) - 1
    assert 0 < listed < 12
    assert named == [*most[:listed], ("further messages", sum(count for _, count in most[listed:]))]


@pytest.mark.parametrize("seed", range(6))
def test_a_damaged_one_gives_at_least_what_pymavlink_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    monkeypatch.setattr(file_module, "BLOCK_BYTES", 4000)
    draw = random.Random(seed)
    records = random_log(seed, 400)
    data = bytearray(b"".join(records))
    for _ in range(30):
        where = draw.randrange(len(data))
        match draw.randrange(3):
            case 0:
                data[where] ^= 1 << draw.randrange(8)
            case 1:
                del data[where : where + draw.randrange(1, 40)]
            case _:
                data[where:where] = draw.randbytes(draw.randrange(1, 40))
    path = tmp_path / "flight.tlog"
    path.write_bytes(data)
    truth, _ = theirs(path)
    with TelemetryLog(path) as log:
        known = {name: rows for name, rows in truth.items() if not name.startswith("UNKNOWN")}
        assert sum(map(len, log.tables.values())) >= sum(map(len, known.values()))
        assert len(records) - 60 <= sum(map(len, log.tables.values())) <= len(records) + 2
        assert log.health.degraded
        assert log.health.damaged > 0
        places = [one.place for one in log.health.damage]
        assert places == sorted(places)


@pytest.mark.parametrize("at", range(0, 57))
def test_one_flipped_bit_costs_at_most_one_message(tmp_path: Path, at: int) -> None:
    """Wherever it is: in a stamp, in a header, in what is carried, in the checksum, in the signature."""
    draw = random.Random(at)
    records = [
        record(START_US + n * 1000, frame(draw, dialect.MAVLINK_MSG_ID_ATTITUDE, signed=True)) for n in range(20)
    ]
    data = bytearray(b"".join(records))
    place = sum(map(len, records[:9])) + at % len(records[9])
    data[place] ^= 1 << (at % 8)
    path = tmp_path / "flight.tlog"
    path.write_bytes(data)
    with TelemetryLog(path) as log:
        assert len(log.tables["ATTITUDE"]) >= 19
        stamps = log.tables["ATTITUDE"].stamp_ns
        assert log.span_ns is not None
        in_signature = at % len(records[9]) >= len(records[9]) - 13
        assert len(stamps) == 20 or log.health.degraded or log.health.undecoded or in_signature


def test_a_stamp_far_from_its_neighbours_is_replaced_and_counted(tmp_path: Path) -> None:
    draw = random.Random(0)
    framed = [frame(draw, dialect.MAVLINK_MSG_ID_ATTITUDE) for _ in range(6)]
    stamps = [START_US + n for n in range(6)]
    stamps[2] ^= 1 << 60
    stamps[4] -= 10 * 86_400_000_000
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(map(record, stamps, framed)))
    with TelemetryLog(path) as log:
        assert (log.tables["ATTITUDE"].stamp_ns // 1000 - START_US).tolist() == [0, 1, 1, 3, 3, 5]
        assert log.health.replaced_stamps == 2


@pytest.mark.parametrize(
    "seconds",
    [
        [0, 0.1, 0.2, 0.3, 1e9, 1e9 + 0.1, 1e9 + 0.2, 1e9 + 0.3],  # the ground station's clock was set
        [0, 90, 300, 1000],
        [0, 90, 3000, 9000, 20_000, 20_001, 20_002],
        [0, 1, 2, 3, -30, -29, -28, -27],
    ],
)
def test_stamps_that_are_strange_and_true_are_kept(tmp_path: Path, seconds: list[float]) -> None:
    draw = random.Random(0)
    stamps = [START_US + round(second * 1e6) for second in seconds]
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(record(at, frame(draw, dialect.MAVLINK_MSG_ID_ATTITUDE)) for at in stamps))
    with TelemetryLog(path) as log:
        assert (log.tables["ATTITUDE"].stamp_ns // 1000).tolist() == stamps
        assert log.health.replaced_stamps == 0


@pytest.mark.parametrize(
    ("seconds", "read"),
    [
        ([0, 1, 63, 3, 4], [0, 1, 63, 3, 4]),  # a minute from the median of the five, which is 3 s
        ([0, 1, 63.001, 3, 4], [0, 1, 1, 3, 4]),
        ([0, 1, 2, 64.001, 4, 5, 6, 7], [0, 1, 2, 2, 4, 5, 6, 7]),
        ([0, 86_399, 86_400, 86_401, 86_402], [0, 86_399, 86_400, 86_401, 86_402]),  # a day, in order
        ([0, 86_400, 86_401, 86_402, 86_403], [86_400, 86_400, 86_401, 86_402, 86_403]),
        ([0, 1, 2, 3, 100_000], [0, 1, 2, 3, 3]),
        ([0, 1, 2, 100_000], [0, 1, 2, 100_000]),  # four stamps cannot outvote one
    ],
)
def test_a_stamp_is_strange_by_a_minute_out_of_order_or_by_a_day(
    tmp_path: Path, seconds: list[float], read: list[float]
) -> None:
    draw = random.Random(0)
    stamps = [START_US + round(second * 1e6) for second in seconds]
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(record(at, frame(draw, dialect.MAVLINK_MSG_ID_ATTITUDE)) for at in stamps))
    with TelemetryLog(path) as log:
        assert ((log.tables["ATTITUDE"].stamp_ns // 1000 - START_US) / 1e6).tolist() == read
        assert log.health.replaced_stamps == sum(a != b for a, b in zip(seconds, read, strict=True))


def test_the_first_and_last_year_of_the_century(tmp_path: Path) -> None:
    draw = random.Random(0)
    framed = frame(draw, dialect.MAVLINK_MSG_ID_ATTITUDE)
    path = tmp_path / "flight.tlog"
    for at_us, base in (
        (978_307_199_999_999, "unknown"), (978_307_200_000_000, "utc"), (4_102_444_800_000_000, "utc"),
        (4_102_444_800_000_001, "unknown"),
    ):  # fmt: skip
        path.write_bytes(record(at_us, framed))
        with TelemetryLog(path) as log:
            assert log.base == base


def test_time_that_goes_back_is_kept_and_counted(tmp_path: Path) -> None:
    draw = random.Random(0)
    stamps = [START_US, START_US + 100, START_US + 50, START_US + 60]
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(record(at, frame(draw, dialect.MAVLINK_MSG_ID_ATTITUDE)) for at in stamps))
    with TelemetryLog(path) as log:
        assert (log.tables["ATTITUDE"].stamp_ns // 1000).tolist() == stamps
        assert log.health.back_in_time == 1
        assert not log.health.degraded
        assert log.span_ns == (START_US * 1000, (START_US + 100) * 1000)


def test_stamps_of_no_known_time(tmp_path: Path) -> None:
    draw = random.Random(0)
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(record(at, frame(draw, dialect.MAVLINK_MSG_ID_ATTITUDE)) for at in (5, 6, 7)))
    with TelemetryLog(path) as log:
        assert log.base == "unknown"
        assert log.span_ns == (5000, 7000)


def test_a_cut_end_is_told(tmp_path: Path) -> None:
    records = random_log(2, 50)
    data = b"".join(records)
    path = tmp_path / "flight.tlog"
    last = len(records[-1])
    for missing in (1, last - 12, last - 9, last - 3):
        path.write_bytes(data[:-missing])
        with TelemetryLog(path) as log:
            assert sum(map(len, log.tables.values())) == 49
            assert log.health.truncated_bytes == last - missing
            assert log.health.lost_bytes == 0
            assert log.health.degraded


def test_messages_of_other_dialects_are_counted_by_number(tmp_path: Path) -> None:
    draw = random.Random(0)
    good = [frame(draw, dialect.MAVLINK_MSG_ID_ATTITUDE) for _ in range(9)]
    for place in (2, 5):
        good[place] = good[place][:7] + (4_000_000 + place).to_bytes(3, "little") + good[place][10:]
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(record(START_US + n, framed) for n, framed in enumerate(good)))
    with TelemetryLog(path) as log:
        assert len(log.tables["ATTITUDE"]) == 7
        assert {name: rows for name, (rows, _) in log.health.undecoded.items()} == {
            "message 4000002": 1,
            "message 4000005": 1,
        }
        assert not log.health.degraded


@pytest.mark.medium
@given(st.binary(max_size=300), st.lists(st.integers(0, 2**20), max_size=6), st.integers(0, 3))
@settings(max_examples=80, deadline=None)
def test_any_bytes_are_read_or_counted(noise: bytes, places: list[int], seed: int) -> None:
    data = bytearray(b"".join(random_log(seed, 6)))
    for number, place in enumerate(places):
        data[place % len(data)] ^= 0xFF if number % 2 else 0x10
    middle = len(data) // 2
    data[middle:middle] = noise
    found = file_module.index_frames(np.frombuffer(bytes(data), dtype=np.uint8))
    assert (np.diff(found.start) > 0).all()
    assert found.losses.lost_bytes + found.losses.truncated_bytes <= len(data)
    assert (found.start < len(data)).all()


@pytest.mark.medium
@given(st.binary(max_size=2000))
@settings(max_examples=80, deadline=None)
def test_noise_has_no_frames(noise: bytes) -> None:
    found = file_module.index_frames(np.frombuffer(noise, dtype=np.uint8))
    assert len(found.start) == 0
    assert found.losses.lost_bytes + found.losses.truncated_bytes == len(noise)


@pytest.mark.parametrize("byte", [b"\xfd", b"\xfe", b"\0", b"\xfe\x09"])
def test_long_patterns_of_beginnings(byte: bytes) -> None:
    data = np.frombuffer(byte * 100_000, dtype=np.uint8)
    found = file_module.index_frames(data)
    assert len(found.start) == 0
    assert found.losses.lost_bytes + found.losses.truncated_bytes == len(data)
