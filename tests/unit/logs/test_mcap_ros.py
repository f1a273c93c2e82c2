"""ROS 2 recordings, against mcap-ros2-support."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as PlainWriter
from mcap_ros2._cdr import CdrWriter, EncapsulationKind
from mcap_ros2._dynamic import generate_dynamic
from mcap_ros_files import SCHEMAS, write
from mcap_truth import is_equal, payloads_of, table_is_equal

from xitl_cli.logs.formats.mcap.file import McapLog
from xitl_cli.logs.model.log import LogHealth
from xitl_cli.logs.model.table import Column


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("ros") / "ros.mcap")


@pytest.mark.medium
@pytest.mark.parametrize("compression", list(CompressionType))
def test_every_value_is_the_same_however_it_is_packed(tmp_path: Path, compression: CompressionType) -> None:
    path = write(tmp_path / "ros.mcap", steps=17, compression=compression)
    assert is_equal(path) > 1000
    with McapLog(path) as log:
        assert not log.health.degraded


@pytest.mark.medium
@pytest.mark.parametrize("keep", [{}, {"repeat_channels": False}, {"use_statistics": False}, {"use_chunking": False}])
def test_and_with_any_index_or_none(tmp_path: Path, recorded: Path, keep: dict[str, bool]) -> None:
    path = tmp_path / "again.mcap"
    with path.open("wb") as file:
        writer = PlainWriter(file, chunk_size=20_000, **keep)
        writer.start("ros2", "")
        channels = {}
        for topic, (name, text) in SCHEMAS.items():
            channels[topic] = writer.register_channel(
                topic, "cdr", writer.register_schema(name, "ros2msg", text.encode())
            )
        for topic, messages in payloads_of(recorded).items():
            for stamp_ns, payload in messages:
                writer.add_message(channels[topic], stamp_ns, payload, stamp_ns)
        writer.finish()
    with McapLog(path) as log:
        assert log.health == LogHealth(path.stat().st_size, 360)
        for topic, (name, text) in SCHEMAS.items():
            decode = generate_dynamic(name, text)[name]
            payloads = [payload for _, payload in payloads_of(recorded)[topic]]
            assert table_is_equal(log.tables[topic], [decode(payload) for payload in payloads]) > 0


def test_columns_are_what_a_plot_wants(recorded: Path) -> None:
    with McapLog(recorded) as log:
        assert log.base == "unknown"
        fix = log.tables["/fix"]
        assert fix.columns["header.stamp"] == Column("header.stamp", "ns", "ns")
        assert fix.values("header.stamp").tolist() == [step * (10**9 + 5) for step in range(40)]
        assert fix.columns["position_covariance"].shape == (9,)
        assert not any("SERVICE" in name for name in fix.columns)
        scan = log.tables["/scan"]
        assert scan.columns["ranges"].shape == (-1,)
        assert scan.columns["intensities"].shape == (2,)
        assert log.tables["/cloud"].columns["data"].kind == "bytes"
        assert log.tables["/cloud"].values("fields[2].name").tolist() == ["z"] * 40
        frames = log.tables["/tf"]
        assert "transforms[0].transform.rotation.w" in frames.columns  # every message has one
        assert "transforms[1].transform.rotation.w" not in frames.columns  # some have no second
        assert set(frames.values("transforms.length")) == {1, 2, 3}
        odd = log.tables["/odd"]
        assert "some[31].x" in odd.columns
        assert "some[32].x" not in odd.columns


def test_log_times_since_2000_are_utc(tmp_path: Path) -> None:
    with McapLog(write(tmp_path / "ros.mcap", steps=2, epoch_ns=1_700_000_000 * 10**9)) as log:
        assert log.base == "utc"


def _log_of(path: Path, definition: str, payloads: list[bytes], encoding: str = "ros2msg") -> McapLog:
    with path.open("wb") as file:
        writer = PlainWriter(file)
        writer.start("", "")
        channel = writer.register_channel("/t", "cdr", writer.register_schema("t/T", encoding, definition.encode()))
        for number, payload in enumerate(payloads):
            writer.add_message(channel, number, payload, number)
        writer.finish()
    return McapLog(path)


class _Bytes:
    def __init__(self) -> None:
        self.data = b""

    def write(self, data: bytes) -> None:
        self.data += data


def test_big_endian_payloads(tmp_path: Path) -> None:
    payloads = []
    for number in range(5):
        output = _Bytes()
        cdr = CdrWriter(output, EncapsulationKind.CDR_BE)
        cdr.write_uint8(number)
        cdr.write_float64(1.5 * number)
        cdr.write_string("x" * number)
        cdr.write_uint32(2)
        cdr.write_int16_array([-number, 300])
        payloads.append(output.data)
    definition = "uint8 a\nfloat64 b\nstring c\nint16[] d"
    decode = generate_dynamic("t/T", definition)["t/T"]
    with _log_of(tmp_path / "be.mcap", definition, payloads) as log:
        assert log.tables["/t"].values("d").dtype == np.int16
        assert table_is_equal(log.tables["/t"], [decode(payload) for payload in payloads]) == 20


@pytest.mark.parametrize("size", [2, 4])
def test_wide_strings_of_either_width(tmp_path: Path, size: int) -> None:
    texts, payloads = ["", "a", "früh", "Grüße"], []
    for text in texts:
        units = np.frombuffer(text.encode("utf-16-le"), dtype="<u2").astype(f"<u{size}").tobytes()
        begin = len(text).to_bytes(4, "little") + units
        padded = begin + bytes(-len(begin) % 8)
        payloads.append(b"\0\1\0\0" + padded + np.float64(0.5).tobytes())
    with _log_of(tmp_path / "wide.mcap", "wstring text\nfloat64 after\n", payloads) as log:
        assert log.tables["/t"].values("text").tolist() == texts
        assert log.tables["/t"].values("after").tolist() == [0.5] * 4


def test_very_long_arrays_are_bytes_as_stored(tmp_path: Path) -> None:
    numbers = np.arange(5000, dtype=np.float32)
    payload = b"\0\1\0\0" + len(numbers).to_bytes(4, "little") + numbers.tobytes()
    with _log_of(tmp_path / "long.mcap", "float32[] many", [payload, payload]) as log:
        assert log.tables["/t"].columns["many"].kind == "bytes"
        assert log.tables["/t"].values("many").tolist() == [numbers.tobytes()] * 2


def test_messages_that_end_too_early_are_left_out_and_counted(tmp_path: Path) -> None:
    good = b"\0\1\0\0" + (3).to_bytes(4, "little") + b"ab\0\0" + np.float64(2.5).tobytes()
    absurd = b"\0\1\0\0" + b"\xff\xff\xff\xff" + b"ab\0\0" + np.float64(2.5).tobytes()
    payloads = [good, good[:-1], b"", b"\0\1", absurd, good, b"\0\0" + good[2:]]
    with _log_of(tmp_path / "short.mcap", "string a\nfloat64 b", payloads) as log:
        table = log.tables["/t"]
        assert table.values("a").tolist() == ["ab", "ab"]
        assert table.values("b").tolist() == [2.5, 2.5]
        assert table.stamp_ns.tolist() == [0, 5]
        count, why = log.health.undecoded["/t"]
        assert count == 5
        assert "shorter" in why


@pytest.mark.parametrize(
    ("definition", "encoding", "why"),
    [
        ("t/Missing a", "ros2msg", "lacks t/msg/Missing"),
        ("t/T again", "ros2msg", "nested too deep"),
        ("]] \x00 uint8", "ros2msg", "cannot be read"),
        ("uint8 a", "ros2idl", "ros2idl"),
        ("uint8 a", "", "cdr"),
    ],
)
def test_what_cannot_be_decoded_says_why(tmp_path: Path, definition: str, encoding: str, why: str) -> None:
    with _log_of(tmp_path / "no.mcap", definition, [b"\0\1\0\0\1", b"\0\1\0\0\2"], encoding) as log:
        count, reason = log.health.undecoded["/t"]
        assert count == 2
        assert why in reason
        assert len(log.tables["/t"]) == 2
        assert log.tables["/t"].stamp_ns.tolist() == [0, 1]
        assert log.tables["/t"].columns == {}


def test_a_later_cdr_is_not_guessed_at(tmp_path: Path) -> None:
    with _log_of(tmp_path / "later.mcap", "uint8 a", [b"\0\7\0\0\1"] * 3) as log:
        assert log.tables["/t"].columns == {}
        assert log.health.undecoded["/t"] == (3, "its messages are in a later form of CDR")
