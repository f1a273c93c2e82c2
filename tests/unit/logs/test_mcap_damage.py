"""Recordings that were cut off, damaged, or made to harm."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer
from mcap_ros_files import write
from mcap_truth import payloads_of

from xitl_cli.logs.export.exporting import ExportSelection, export_log
from xitl_cli.logs.formats.mcap.file import McapLog
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.summary import summarize_log

_ANY = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30)
Values = dict[str, dict[str, Any]]


def everything(log: McapLog) -> Values:
    """All there is to read, through every door."""
    found: Values = {}
    for name, table in log.tables.items():
        found[name] = {column: table.values(column) for column in table.columns}
        found[name]["stamp_ns"] = table.stamp_ns
        assert (np.diff(table.file_offset) > 0).all()
        assert all(len(values) == len(table) for values in found[name].values())
    assert log.base in ("simulation", "utc", "unknown")
    assert log.span_ns is None or log.span_ns[0] <= log.span_ns[1]
    assert all(isinstance(value, str) for value in log.facts.values())
    log.attachment("a")
    health = log.health
    assert health.lost_bytes >= 0
    assert len(health.damage) <= health.damaged
    return found


def same(one: Any, other: Any) -> bool:
    if one.dtype == object or one.dtype.kind == "U":
        return bool(one.tolist() == other.tolist())
    return one.shape == other.shape and bool(np.array_equal(one, other, equal_nan=True))


class Recorded:
    """A recording as bytes, with all that is in it."""

    def __init__(self, path: Path) -> None:
        self.data = path.read_bytes()
        self.payloads = payloads_of(path)
        with McapLog(path) as log:
            self.values = everything(log)
        assert sum(map(len, self.payloads.values())) > 100


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recorded]:
    made = {}
    for compression in CompressionType:
        path = write(tmp_path_factory.mktemp("damage") / "d.mcap", 14, compression, chunk_size=8000)
        made[compression.name] = Recorded(path)
    loose = tmp_path_factory.mktemp("damage") / "loose.mcap"
    with loose.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start("", "")
        writer.add_metadata("m", {"a": "b"})
        schema = writer.register_schema("t/T", "ros2msg", b"uint8[] data\nuint8 b")
        channels = [writer.register_channel(f"/{name}", "cdr", schema) for name in "ab"]
        for step in range(150):
            payload = b"\0\1\0\0" + step.to_bytes(4, "little") + bytes(range(step)) + b"\7"
            writer.add_message(channels[step % 2], step, payload, step)
        writer.add_attachment(0, 0, "a", "text/plain", b"attached")
        writer.finish()
    made["loose"] = Recorded(loose)
    return made


KINDS = ("NONE", "LZ4", "ZSTD", "loose")


@pytest.mark.medium
@given(st.data())
@_ANY
def test_cut_at_any_byte(tmp_path: Path, recordings: dict[str, Recorded], data: st.DataObject) -> None:
    """What the package's streaming reader gets comes out, and what is more was in the file before."""
    whole = recordings[data.draw(st.sampled_from(KINDS))]
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole.data[: data.draw(st.integers(8, len(whole.data) - 1))])
    known = payloads_of(path)
    with McapLog(path) as log:
        found, health = everything(log), log.health
        assert health.unclosed
        for topic, messages in known.items():
            rows = len(found[topic]["stamp_ns"]) if topic in found else 0
            whole_ones = [one == other for one, other in zip(messages, whole.payloads[topic], strict=False)]
            assert rows >= sum(whole_ones)
        for topic, columns in found.items():
            rows = len(columns["stamp_ns"])
            assert columns["stamp_ns"].tolist() == [stamp for stamp, _ in whole.payloads[topic][:rows]]
            for name, values in columns.items():  # where fewer rows make no other column
                before = whole.values[topic].get(name)
                if before is not None and before.shape[1:] == values.shape[1:] and before.dtype == values.dtype:
                    assert same(values, before[:rows]), (topic, name)


@pytest.mark.medium
@given(st.data())
@_ANY
def test_a_flipped_bit_is_never_silent(tmp_path: Path, recordings: dict[str, Recorded], data: st.DataObject) -> None:
    """What comes out is the same, or the log says that something is wrong; and it costs a chunk at most."""
    whole = recordings[data.draw(st.sampled_from(KINDS[:3]))]
    place = data.draw(st.integers(8, len(whole.data) - 1))
    damaged = bytearray(whole.data)
    damaged[place] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path / "flipped.mcap"
    path.write_bytes(damaged)
    with McapLog(path) as log:
        found, health = everything(log), log.health
    if not (health.degraded or health.undecoded):
        assert found.keys() == whole.values.keys()
        for topic, columns in whole.values.items():
            assert all(same(values, found[topic][name]) for name, values in columns.items())
    rows = sum(len(columns["stamp_ns"]) for columns in found.values())
    assert rows >= 126 - 30  # a chunk of 8000 bytes has 27 or fewer messages here


@pytest.mark.medium
@pytest.mark.parametrize("kind", KINDS)
def test_zeros_are_passed_over_counted_and_the_rest_exported(
    tmp_path: Path, recordings: dict[str, Recorded], kind: str
) -> None:
    """As a disk leaves a block that it lost. Which rows are gone shows when a topic is read, not before."""
    whole = recordings[kind]
    path, lost = tmp_path / "zeros.mcap", 0
    for place in range(500, len(whole.data) - 700, len(whole.data) // 9):
        path.write_bytes(whole.data[:place] + bytes(512) + whole.data[place + 512 :])
        with McapLog(path) as log:
            done = export_log(log, ExportSelection(tuple(log.tables.values())), "csv", tmp_path / "csv", True)
            rows = sum(map(len, log.tables.values()))
            told = summarize_log(log)
        assert done.rows == rows == sum(message.rows for message in told.messages)
        lost += rows < sum(map(len, whole.payloads.values()))
        assert rows == sum(map(len, whole.payloads.values())) or told.health.degraded or told.health.undecoded
    assert lost >= 3


_EDIT = st.tuples(
    st.sampled_from(["put", "cut", "copy"]), st.integers(0, 10**6), st.binary(max_size=40), st.integers(0, 900)
)


@pytest.mark.medium
@given(kind=st.sampled_from(KINDS), edits=st.lists(_EDIT, min_size=1, max_size=6), unclosed=st.booleans())
@_ANY
def test_any_damage_is_survived(
    tmp_path: Path, recordings: dict[str, Recorded], kind: str, edits: list[Any], unclosed: bool
) -> None:
    data = bytearray(recordings[kind].data)
    for what, at, piece, size in edits:
        place = 8 + at % (len(data) - 8)
        if what == "put":
            data[place : place + len(piece)] = piece
        elif what == "cut":
            del data[place : place + size]
        else:
            data[place:place] = data[max(place - size, 0) : place]
        data += b"\0" * max(0, 9 - len(data))
    path = tmp_path / "any.mcap"
    path.write_bytes(data[:-8] if unclosed else data)
    with McapLog(path) as log:
        everything(log)


@given(st.binary(max_size=400))
@_ANY
def test_any_bytes_behind_the_magic_are_survived(tmp_path: Path, tail: bytes) -> None:
    path = tmp_path / "bytes.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + tail)
    with McapLog(path) as log:
        assert sum(len(table) for table in log.tables.values()) <= len(tail) / 31
        everything(log)


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "not.mcap").write_bytes(b"MCAP0 not quite")
    for name, words in (("not.mcap", "is not an MCAP file"), ("none.mcap", "cannot be read"), (".", "cannot be read")):
        with pytest.raises(LogError, match=words):
            McapLog(tmp_path / name)


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


SCHEMA = record(3, struct.pack("<H", 1) + text("t/T") + text("ros2msg") + text("uint8 a"))
CHANNEL = record(4, struct.pack("<HH", 1, 1) + text("/t") + text("cdr") + struct.pack("<I", 0))
BEGIN = b"\x89MCAP0\r\n" + record(1, text("") + text("by hand"))


def message(stamp_ns: int, channel: int = 1, value: int = 5) -> bytes:
    return record(5, struct.pack("<HIQQ", channel, 0, stamp_ns, stamp_ns) + bytes((0, 1, 0, 0, value)))


def chunk(data: bytes, compression: str = "", size: int | None = None, crc: int = 0, end_ns: int = 2**63) -> bytes:
    claimed = len(data) if size is None else size
    head = struct.pack("<QQQI", 0, end_ns, claimed, crc) + text(compression)
    return record(6, head + struct.pack("<Q", len(data)) + data)


def log_of(path: Path, data: bytes) -> McapLog:
    path.write_bytes(data)
    return McapLog(path)


def test_a_chunk_that_claims_too_much_is_not_unpacked(tmp_path: Path) -> None:
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 20))
    good = chunk(SCHEMA + CHANNEL + message(1))
    for size in (2**30 + 1, 2**40, 2**64 - 1):
        with log_of(tmp_path / "bomb.mcap", BEGIN + good + chunk(bomb, "zstd", size) + good) as log:
            assert log.tables["/t"].stamp_ns.tolist() == [1, 1]
            assert log.health.damaged == 1
    with log_of(tmp_path / "many.mcap", BEGIN + good + chunk(bomb, "zstd", 2**29) * 5 + good) as log:
        assert log.tables["/t"].stamp_ns.tolist() == [1, 1]  # 2.5 GB out of a kilobyte
        assert "claims" in log.health.damage[-1].why
    with log_of(tmp_path / "less.mcap", BEGIN + good + chunk(bomb, "zstd", 1000)) as log:
        assert log.health.damaged  # zeros are no records
        assert len(log.tables["/t"]) == 1


@pytest.mark.medium
@pytest.mark.parametrize("compression", CompressionType)
def test_fields_behind_those_known_are_no_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: CompressionType
) -> None:
    """Every record but three may be extended by a later version of the format."""
    plain = write(tmp_path / "plain.mcap", 14, compression, chunk_size=8000)

    def start(builder: RecordBuilder, opcode: Opcode) -> None:
        builder.opcode = opcode
        begin(builder, opcode)

    def finish(builder: RecordBuilder) -> None:
        if builder.opcode not in (Opcode.MESSAGE, Opcode.DATA_END, Opcode.FOOTER):
            builder.write(b"\x01\xff\xff")
        end(builder)

    begin, end = RecordBuilder.start_record, RecordBuilder.finish_record
    monkeypatch.setattr(RecordBuilder, "start_record", start)
    monkeypatch.setattr(RecordBuilder, "finish_record", finish)
    padded = write(tmp_path / "padded.mcap", 14, compression, chunk_size=8000)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(padded.read_bytes()[:-20])  # without its footer it is walked, record by record
    with McapLog(plain) as one:
        values = everything(one)
        for path in (padded, cut):
            with McapLog(path) as other:
                found, health = everything(other), other.health
            assert found.keys() == values.keys()
            assert all(same(column, found[name][key]) for name, each in values.items() for key, column in each.items())
            assert (health.damaged, health.lost_bytes, health.unclosed) == (0, 0, path == cut)


def test_a_record_that_a_later_version_brings_is_passed_over(tmp_path: Path) -> None:
    later = record(0x10, b"some news")
    data = BEGIN + later + chunk(SCHEMA + CHANNEL + later + message(1)) + later + message(2)
    with log_of(tmp_path / "later.mcap", data) as log:
        assert log.tables["/t"].stamp_ns.tolist() == [1, 2]
        assert log.health.damaged == 0


def test_a_compression_that_nobody_knows(tmp_path: Path) -> None:
    with log_of(tmp_path / "x.mcap", BEGIN + chunk(SCHEMA + CHANNEL + message(1)) + chunk(message(2), "snappy")) as log:
        assert log.tables["/t"].stamp_ns.tolist() == [1]
        assert "snappy" in log.health.damage[0].why


def test_messages_of_channels_that_nobody_described(tmp_path: Path) -> None:
    with log_of(tmp_path / "x.mcap", BEGIN + chunk(SCHEMA + CHANNEL + message(1) + message(2, channel=9))) as log:
        assert log.tables["/t"].stamp_ns.tolist() == [1]
        assert log.health.damage[0].why == "a message of no channel that is described"


def test_a_channel_described_again_otherwise(tmp_path: Path) -> None:
    other = record(4, struct.pack("<HH", 1, 1) + text("/u") + text("cdr") + struct.pack("<I", 0))
    with log_of(
        tmp_path / "x.mcap", BEGIN + chunk(SCHEMA + CHANNEL + message(1) + CHANNEL + other + message(2))
    ) as log:
        assert log.tables["/t"].stamp_ns.tolist() == [1, 2]
        assert log.health.redefined == 1


def test_two_channels_of_one_topic(tmp_path: Path) -> None:
    twin = record(4, struct.pack("<HH", 2, 1) + text("/t") + text("cdr") + struct.pack("<I", 0))
    other = record(4, struct.pack("<HH", 3, 0) + text("/t") + text("json") + struct.pack("<I", 0))
    data = chunk(SCHEMA + CHANNEL + twin + other + message(1) + message(2, 2) + message(3) + message(4, 3))
    with log_of(tmp_path / "x.mcap", BEGIN + data) as log:
        assert log.tables["/t"].stamp_ns.tolist() == [1, 2, 3]
        assert log.tables["/t"].values("a").tolist() == [5, 5, 5]
        assert log.tables["/t#2"].indexed_rows == 1
        assert len(log.tables["/t#2"]) == 0  # what is in it is no JSON
        assert log.health.redefined == 1


def test_stamps_that_no_signed_number_can_hold(tmp_path: Path) -> None:
    with log_of(
        tmp_path / "x.mcap", BEGIN + chunk(SCHEMA + CHANNEL + message(2**64 - 1) + message(3), end_ns=2**64 - 1)
    ) as log:
        assert log.tables["/t"].stamp_ns.tolist() == [2**63 - 1, 3]
        assert log.health.records == 2
        log.tables["/t"].values("a")
        assert log.health.back_in_time == 1


def summary(
    chunk_place: int, chunk_size: int, index: dict[int, int], index_size: int, count: int, data: bytes
) -> bytes:
    places = b"".join(struct.pack("<HQ", *entry) for entry in index.items())
    inner = chunk_size - 9 - 40
    entry = struct.pack("<QQQQI", 0, 2**62, chunk_place, chunk_size, len(places)) + places
    entry += struct.pack("<Q", index_size) + text("") + struct.pack("<QQ", inner, inner)
    counts = struct.pack("<HQ", 1, count)
    statistics = struct.pack("<QHIIIIQQI", count, 1, 1, 0, 0, 1, 1, 3, len(counts)) + counts
    body = record(15, bytes(4)) + SCHEMA + CHANNEL + record(11, statistics) + record(8, entry)
    start = len(data) + 13
    return body + record(2, struct.pack("<QQI", start, 0, 0)) + b"\x89MCAP0\r\n"


@pytest.mark.parametrize(
    ("wrong_place", "offsets", "count"),
    [
        (0, [0, 1, 2], 3),
        (1, [0, 1, 2], 3),
        (10**12, [0, 1, 2], 3),
        (0, [0, 10**15, 2], 3),
        (0, [0, 0, 2], 3),
        (0, [0], 3),
        (0, [0, 1, 2], 1),
        (0, [0, 1, 2], 10**9),
        (0, [], 3),
    ],
)
def test_an_index_that_lies_is_not_believed(tmp_path: Path, wrong_place: int, offsets: list[int], count: int) -> None:
    inside = SCHEMA + CHANNEL
    begins = []
    for stamp_ns in (1, 2, 3):
        begins.append(len(inside))
        inside += message(stamp_ns)
    packed = chunk(inside)
    entries = b"".join(struct.pack("<QQ", 1, begins[at] if at < 3 else at) for at in offsets)
    index = record(7, struct.pack("<HI", 1, len(entries)) + entries)
    data = BEGIN + packed + index
    data += summary(len(BEGIN) + wrong_place, len(packed), {1: len(BEGIN) + len(packed)}, len(index), count, data)
    with log_of(tmp_path / "lies.mcap", data) as log:
        table = log.tables["/t"]
        assert table.stamp_ns.tolist() == [1, 2, 3]
        assert table.values("a").tolist() == [5, 5, 5]
        assert len(table) == 3
        assert not log.health.unclosed
        truthful = wrong_place == 0 and offsets == [0, 1, 2] and count == 3
        assert bool(log.health.damaged) != truthful or wrong_place


def test_a_damaged_record_costs_itself(tmp_path: Path) -> None:
    """Three chunks; the length of the second's record is wrong: its inside says how long it is."""
    parts = [chunk(SCHEMA + CHANNEL + message(1)), chunk(message(2)), chunk(message(3))]
    damaged = bytearray(parts[1])
    damaged[3] ^= 0x55
    with log_of(tmp_path / "x.mcap", BEGIN + parts[0] + bytes(damaged) + parts[2]) as log:
        assert log.tables["/t"].stamp_ns.tolist() == [1, 2, 3]
        assert log.health.damaged == 1
    junk = b"\x05junk that is no record\xff\xff\xff\xff" * 3
    with log_of(tmp_path / "y.mcap", BEGIN + parts[0] + junk + parts[1] + parts[2]) as log:
        assert log.tables["/t"].stamp_ns.tolist() == [1, 2, 3]
        assert log.health.lost_bytes == len(junk)
        assert log.health.damage[0].place == len(BEGIN + parts[0])


def test_damage_inside_a_chunk_costs_one_message(tmp_path: Path) -> None:
    whole = SCHEMA + CHANNEL + b"".join(message(stamp_ns) for stamp_ns in range(10))
    damaged = bytearray(whole)
    damaged[len(SCHEMA + CHANNEL) + 4 * len(message(0)) + 3] = 0x7F  # the length of the fifth
    with log_of(tmp_path / "x.mcap", BEGIN + chunk(bytes(damaged), end_ns=9)) as log:
        assert log.tables["/t"].stamp_ns.tolist() == [0, 1, 2, 3, 5, 6, 7, 8, 9]
        assert log.health.lost_bytes == len(message(0))


def test_damage_that_takes_all_of_a_topic_is_summarised(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, chunk_size=1)  # a chunk for each message
        writer.start()
        schema = writer.register_schema("Numbers", "jsonschema", b'{"type": "object"}')
        for topic in ("/lost", "/kept"):
            channel = writer.register_channel(topic, "json", schema)
            writer.add_message(channel, log_time=1_000, data=b'{"x": 1}', publish_time=1_000)
        writer.finish()
    data = bytearray(path.read_bytes())
    data[data.index(b'{"x": 1}') - 22 - 9] = 0x7E  # the opcode of the message: sequence, stamps and channel are between
    path.write_bytes(data)
    with McapLog(path) as log:
        summary = summarize_log(log)
        assert summary.health.degraded
        assert [message.name for message in summary.messages if message.rows] == ["/kept"]
