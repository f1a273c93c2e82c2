"""Logs are told apart by their content; what is none is told in a sentence."""

from __future__ import annotations

import gzip
import os
import random
import zipfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect
from telemetry import START_US, frame, record

from tests.recorded import LOGS, MISSION_TLOG
from xitl_cli.logs import open_log
from xitl_cli.logs.model.errors import LogError


def attitudes(count: int, *, stamped: bool = True) -> bytes:
    draw = random.Random(0)
    frames = [frame(draw, dialect.MAVLINK_MSG_ID_ATTITUDE) for _ in range(count)]
    return b"".join(record(START_US + n, one) if stamped else one for n, one in enumerate(frames))


def dataflash(rows: int = 3) -> bytes:
    """FMT of itself and of a message A with a time and a number."""

    def described(number: int, length: int, name: bytes, letters: bytes, columns: bytes) -> bytes:
        return (
            b"\xa3\x95\x80"
            + bytes([number, length])
            + name.ljust(4, b"\0")
            + letters.ljust(16, b"\0")
            + (columns.ljust(64, b"\0"))
        )

    head = described(0x80, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    head += described(1, 15, b"A", b"QI", b"TimeUS,V")
    return head + b"".join(b"\xa3\x95\x01" + n.to_bytes(8, "little") + bytes(4) for n in range(rows))


@pytest.mark.parametrize("name", ["flight.tlog", "flight.bin", "flight.mcap", "flight"])
def test_a_telemetry_log_by_any_name(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(attitudes(2))
    with open_log(tmp_path / name) as log:
        assert log.format == "tlog"
        assert {table: len(rows) for table, rows in log.tables.items()} == {"ATTITUDE": 2}


def test_a_telemetry_log_of_one_record_or_with_a_damaged_beginning(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(attitudes(1))
    assert open_log(path).format == "tlog"
    path.write_bytes(bytes(range(100)) + attitudes(20))
    with open_log(path) as log:
        assert len(log.tables["ATTITUDE"]) == 20
        assert log.health.damaged == 1


@pytest.mark.parametrize("before", [b"", b"\0\0\0"])
def test_a_dataflash_log_by_any_name(tmp_path: Path, before: bytes) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(before + dataflash())
    with open_log(path) as log:
        assert log.format == "dataflash"
        assert len(log.tables["A"]) == 3


def test_a_recording_by_any_name(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "flight.bin"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/a", "json", writer.register_schema("a", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b'{"x": 1}', 1)
        writer.finish()
    with open_log(path) as log:
        assert log.format == "mcap"
        assert list(log.tables) == ["/a"]


def test_the_real_ones() -> None:
    logs = [*sorted(LOGS.glob("*.bin")), MISSION_TLOG]
    for path in logs:
        with open_log(path) as log:
            assert log.format == ("tlog" if path.suffix == ".tlog" else "dataflash")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", ("empty",)),
        (b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n", ("text", ".bin")),
        (b"ULog\x01\x12\x35\x01" + bytes(20), ("ULog", "without a readable record")),
        (b"#ROSBAG V2.0\n", ("ROS 1 bag", "without a readable record")),
        (b"SQLite format 3\0" + bytes(20), ("SQLite",)),
        (gzip.compress(b"log", mtime=0), ("gzip", "gunzip")),
        (b"\xd4\xc3\xb2\xa1" + bytes(20), ("packets", ".tlog")),
        (b"\x0a\x0d\x0d\x0a" + bytes(20), ("packets",)),
        (b"time,roll\n0,1\n", ("text", "time,roll")),
        (bytes(100), ("zeros",)),
        (b"\x7fELF\x02\x01\x01" + bytes(20), ("7f 45 4c 46",)),
        (attitudes(5, stamped=False), ("without the time stamps",)),
        (b"\xfd", ("fd",)),
        (b"\xfe" * 300, ("fe fe",)),
    ],
)
def test_what_is_no_log(tmp_path: Path, content: bytes, words: tuple[str, ...]) -> None:
    path = tmp_path / "flight.bin"
    path.write_bytes(content)
    with pytest.raises(LogError) as told:
        open_log(path)
    sentence = str(told.value)
    assert sentence.startswith(f"{path}: ")
    assert "\n" not in sentence
    for word in words:
        assert word in sentence


def test_an_archive(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "logs.zip", "w") as archive:
        archive.writestr("flight.bin", dataflash())
    with pytest.raises(LogError, match="ZIP"):
        open_log(tmp_path / "logs.zip")


def test_places_without_a_file(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="does not exist"):
        open_log(tmp_path / "flight.bin")
    with pytest.raises(LogError, match=r"is a directory; choose a DataFlash"):
        open_log(tmp_path)
    (tmp_path / "autopilot.bin").touch()
    with pytest.raises(LogError, match=r"is a directory; choose a file in it, such as .*autopilot\.bin"):
        open_log(tmp_path)
    (tmp_path / "run.mcap").touch()
    with pytest.raises(LogError, match=r"run\.mcap: is empty"):
        open_log(tmp_path)
    with pytest.raises(LogError, match="cannot be read"):
        open_log(tmp_path / "run.mcap" / "log.bin")
    with pytest.raises(LogError, match="cannot be read"):
        open_log(tmp_path / ("x" * 300))
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(LogError, match="not a regular file"):
        open_log(tmp_path / "pipe")


def test_a_file_that_may_not_be_read(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash())
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("this user may read everything")
    with pytest.raises(LogError, match="cannot be read"):
        open_log(path)


BEGINNINGS = (b"", b"\xa3\x95", b"\xa3\x95\x80", b"\x89MCAP0\r\n", attitudes(1), attitudes(3)[:-9], dataflash()[:-5])


@pytest.mark.medium
@given(st.sampled_from(BEGINNINGS), st.binary(max_size=400))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_are_opened_or_refused_in_a_sentence(tmp_path: Path, beginning: bytes, rest: bytes) -> None:
    path = tmp_path / "flight.bin"
    path.write_bytes(beginning + rest)
    refusal = ""
    try:
        log = open_log(path)
    except LogError as error:
        refusal = str(error)
    if refusal:
        assert refusal.startswith(f"{path}: ")
        return
    with log:
        assert log.health.size_bytes == len(beginning + rest)
        for table in log.tables.values():
            assert len(table.stamp_ns) == len(table.file_offset)
            for column in table.columns:
                assert len(table.values(column)) == len(table)
