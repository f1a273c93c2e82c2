"""What is exported is read back with the readers of others and equals the table."""

from __future__ import annotations

import csv
import resource
import signal
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_log import MadeLog
from made_table import every_kind, made_table
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from tests.golden import Golden
from tests.recorded import CALM, MISSION_TLOG
from xitl_cli.logs import open_log
from xitl_cli.logs.clocks.readings import utc_offset
from xitl_cli.logs.export.exporting import ExportResult, ExportSelection, export_log
from xitl_cli.logs.export.files import file_names
from xitl_cli.logs.export.mcap_export import field_names, type_names
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Column, Table


def exported(log: Log, out: Path, file_format: str = "csv", **wanted: Any) -> ExportResult:
    return export_log(log, ExportSelection(tuple(log.tables.values()), **wanted), file_format, out, False)


def read_csv(path: Path) -> dict[str, list[str]]:
    with path.open(newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    return {name: [row[at] for row in rows] for at, name in enumerate(names)}


def read_mcap(path: Path) -> dict[str, list[tuple[int, Any]]]:
    topics: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            topics.setdefault(channel.topic, []).append((message.log_time, decoded))
    return topics


def assert_csv_equals(path: Path, table: Table, zero_ns: int, raw: bool = False) -> None:
    told = read_csv(path)
    stamps = [round(float(text) * 1e9) for text in told["time_s"]]  # under 100 days a double has the nanosecond
    assert stamps == (table.stamp_ns - zero_ns).tolist()
    for name, column in table.columns.items():
        values = table.values(name, raw=raw)
        if column.kind == "text":
            assert told[name] == [text.replace("\n", "\\n") for text in values.tolist()]
        elif column.kind == "bytes":
            assert [bytes.fromhex(text) for text in told[name]] == values.tolist()
        else:
            flat = values.reshape(len(values), -1)
            names = [name] if not column.shape else [f"{name}[{k}]" for k in range(flat.shape[1])]
            back = np.array([told[each] for each in names]).T.astype(flat.dtype)
            np.testing.assert_array_equal(back, flat)


@pytest.mark.parametrize("raw", [False, True])
def test_csv_of_every_kind_of_column(tmp_path: Path, raw: bool) -> None:
    table = every_kind()
    done = exported(MadeLog(table), tmp_path / "out", raw=raw)
    assert (done.rows, done.notes) == (5, ())
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["KIND.csv", "columns.csv"]
    assert_csv_equals(tmp_path / "out" / "KIND.csv", table, 0, raw)
    lines = (tmp_path / "out" / "KIND.csv").read_text().splitlines()
    assert len(lines) == 6  # PlotJuggler reads line by line
    assert lines[0].split(",")[:3] == ["time_s", "Ni1", "Nu1"]
    units = dict(zip((told := read_csv(tmp_path / "out" / "columns.csv"))["column"], told["unit"], strict=True))
    assert units["Angle"] == ("cdeg" if raw else "deg")
    assert units["Fixed[1]"] == ("" if raw else "V")


def test_csv_is_read_by_numpy(tmp_path: Path) -> None:
    table = made_table("ATT", {"Roll": (Column("Roll", "deg"), np.array([0.1, -2.5, 1e-9]))}, [10, 20, 30], [1, 2, 3])
    exported(MadeLog(table), tmp_path)
    told = np.genfromtxt(tmp_path / "ATT.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(told["Roll"], table.values("Roll"))
    np.testing.assert_array_equal(told["time_s"], [1e-8, 2e-8, 3e-8])


def test_csv_of_a_log_on_utc_has_both_times(tmp_path: Path) -> None:
    table = every_kind(first_ns=1_700_000_000_123_456_789)
    exported(MadeLog(table, base="utc"), tmp_path)
    told = read_csv(tmp_path / "KIND.csv")
    assert told["time_s"][:2] == ["0.000000", "0.001000001"]
    assert told["utc_s"][0] == "1700000000.123456789"


@pytest.mark.medium
def test_times_are_utc_where_the_log_tells_it(tmp_path: Path) -> None:
    """By GPS week and milliseconds, the least delay of a fix being under half a second; 18 leap seconds since 2017."""
    with open_log(CALM) as log:
        tables = tuple(log.tables[name] for name in ("GPS", "ATT"))
        done = export_log(log, ExportSelection(tables), "mcap", tmp_path / "utc.mcap", False)
        assert done.sentence.endswith("its times are UTC by GPS")
        told = read_mcap(tmp_path / "utc.mcap")
        for stamp_ns, fix in told["/GPS"]:
            gps_ns = (fix.gwk * 604_800_000 + fix.gms) * 1_000_000
            assert -1e6 <= stamp_ns - gps_ns - (315_964_800 - 18) * 1e9 < 0.5e9
        between = np.diff([stamp_ns for stamp_ns, _ in told["/ATT"]])
        np.testing.assert_array_equal(between, np.diff(log["ATT"].stamp_ns))
        export_log(log, ExportSelection(tables), "csv", tmp_path / "csv", False)
        utc_s = read_csv(tmp_path / "csv" / "ATT.csv")["utc_s"]
        assert [round(float(text) * 1e5) for text in utc_s] == [round(ns / 1e4) for ns, _ in told["/ATT"]]
    with open_log(tmp_path / "utc.mcap") as log:
        assert log.base == "utc"


def test_a_log_that_tells_no_utc_says_so(tmp_path: Path, golden: Golden) -> None:
    done = exported(MadeLog(every_kind()), tmp_path / "none.mcap", "mcap")
    golden("finding", done.sentence)
    assert read_mcap(tmp_path / "none.mcap")["/KIND"][0][0] < 10**12


def test_utc_by_what_else_tells_it() -> None:
    hour_ns = 3_600_000_000_000
    for name, column, kind in (("PM", "R", "uint64"), ("SYSTEM_TIME", "time_unix_usec", "uint64")):
        values = np.array([0, 1_795_000_000_000_000, 1_795_000_001_000_000], dtype=kind)  # 0: not set yet
        stamps = [hour_ns, 2 * hour_ns, 2 * hour_ns + 10**9]
        log = MadeLog(made_table(name, {column: (Column(column), values)}, stamps, [1, 2, 3]))
        found = utc_offset(log)
        assert found is not None
        assert (found.offset_ns, name in found.source) == (1_795_000_000 * 10**9 - 2 * hour_ns, True)


def test_a_span_of_time(tmp_path: Path) -> None:
    table = every_kind()
    exported(MadeLog(table), tmp_path, from_ns=int(table.stamp_ns[1]), until_ns=int(table.stamp_ns[3]))
    assert read_csv(tmp_path / "KIND.csv")["Ni4"] == ["2", "3", "4"]


def test_an_array_too_long_for_columns_is_told(tmp_path: Path) -> None:
    columns = {"cloud": (Column("cloud", shape=(2000,)), np.zeros((2, 2000))), "n": (Column("n"), [1, 2])}
    log = MadeLog(made_table("SCAN", columns, [1, 2], [1, 2]))
    done = exported(log, tmp_path)
    assert done.notes == ("SCAN: cloud omitted because it is too long; --format mcap writes it",)
    assert sorted(read_csv(tmp_path / "SCAN.csv")) == ["n", "time_s"]
    exported(log, tmp_path / "scan.mcap", "mcap")
    assert len(read_mcap(tmp_path / "scan.mcap")["/SCAN"][1][1].cloud) == 2000


@pytest.mark.parametrize("raw", [False, True])
def test_parquet_of_every_kind_of_column(tmp_path: Path, raw: bool) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    table = every_kind()
    exported(MadeLog(table), tmp_path, "parquet", raw=raw)
    told = parquet.read_table(tmp_path / "KIND.parquet")
    assert told["stamp_ns"].to_pylist() == table.stamp_ns.tolist()
    np.testing.assert_allclose(told["time_s"].to_numpy(), table.stamp_ns * 1e-9, rtol=0, atol=1e-12)
    for name, column in table.columns.items():
        values = table.values(name, raw=raw)
        if column.kind != "number":
            assert told[name].to_pylist() == values.tolist()
            continue
        flat = values.reshape(len(values), -1)
        for k in range(flat.shape[1]):
            field = f"{name}[{k}]" if column.shape else name
            np.testing.assert_array_equal(told[field].to_numpy(), flat[:, k])
            unit = column.raw_unit if raw else column.unit
            assert (told.schema.field(field).metadata or {}).get(b"unit", b"").decode() == unit


def test_without_pyarrow_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(LogError, match=r"pip install 'xitl\[parquet\]'"):
        exported(MadeLog(every_kind()), tmp_path / "out", "parquet")
    assert not (tmp_path / "out").exists()


def assert_mcap_equals(told: list[tuple[int, Any]], table: Table, raw: bool = False, offset_ns: int = 0) -> None:
    assert [stamp for stamp, _ in told] == (table.stamp_ns + offset_ns).tolist()
    for name, ros_name in field_names(table.columns).items():
        column, values = table.columns[name], table.values(name, raw=raw)
        back = [getattr(message, ros_name) for _, message in told]
        if column.kind == "text":
            assert back == values.tolist()
        elif column.kind == "bytes":
            assert [bytes(one) for one in back] == values.tolist()
        elif -1 in column.shape:
            for one, row in zip(back, values, strict=True):
                np.testing.assert_array_equal(one, row[: len(one)])
                assert np.isnan(row[len(one) :]).all()
        else:
            np.testing.assert_array_equal(np.array(back).reshape(values.shape), values)


@pytest.mark.parametrize("raw", [False, True])
def test_mcap_of_every_kind_of_column(tmp_path: Path, raw: bool) -> None:
    table = every_kind(9)
    numbers = made_table(
        "/a/only numbers",
        {
            "b": (Column("b"), np.arange(4, dtype=np.uint8)),
            "d": (Column("d", shape=(3,)), np.arange(12.0).reshape(4, 3)),
            "h": (Column("h"), np.arange(4, dtype=np.int16)),
            "f": (Column("f"), np.array([0.5, np.nan, np.inf, -0.0], dtype=np.float32)),
        },
        [5, 6, 4, 8],
        [15, 25, 35, 45],
    )
    log = MadeLog(numbers, table)
    done = exported(log, tmp_path / "out.mcap", "mcap", raw=raw)
    assert done.rows == 13
    told = read_mcap(tmp_path / "out.mcap")
    assert sorted(told) == ["/KIND", "/a/only numbers"]
    assert_mcap_equals(told["/KIND"], table, raw)
    by_time = np.argsort(numbers.stamp_ns, kind="stable")
    for row, (stamp_ns, message) in zip(by_time, told["/a/only numbers"], strict=True):
        assert stamp_ns == numbers.stamp_ns[row]
        for name in numbers.columns:
            np.testing.assert_array_equal(getattr(message, name), numbers.values(name)[row])


def test_mcap_is_read_by_our_own_reader(tmp_path: Path) -> None:
    table = every_kind()
    exported(MadeLog(table), tmp_path / "out.mcap", "mcap")
    with open_log(tmp_path / "out.mcap") as log:
        back = log.tables["/KIND"]
        for name, ros_name in field_names(table.columns).items():
            if table.columns[name].kind == "number":
                np.testing.assert_array_equal(back.values(ros_name), table.values(name))


def test_stamps_before_the_zero_are_told(tmp_path: Path) -> None:
    log = MadeLog(made_table("A", {"x": (Column("x"), [1, 2])}, [-5, 5], [1, 2]))
    done = exported(log, tmp_path / "out.mcap", "mcap")
    assert done.notes == ("1 rows stamped before the log's zero are at 0",)
    assert [stamp for stamp, _ in read_mcap(tmp_path / "out.mcap")["/A"]] == [0, 5]


@pytest.mark.slow
@pytest.mark.parametrize("path", [CALM, MISSION_TLOG], ids=lambda path: path.stem)
def test_a_real_log(tmp_path: Path, path: Path) -> None:
    with open_log(path) as log:
        looked_at = ("ATT", "GPS", "MSG", "ISBD", "FILE", "ATTITUDE", "STATUSTEXT", "RC_CHANNELS")
        wanted = ExportSelection(tuple(log.tables[name] for name in looked_at if name in log.tables))
        export_log(log, wanted, "mcap", tmp_path / "out.mcap", False)
        export_log(log, wanted, "csv", tmp_path, False)
        told = read_mcap(tmp_path / "out.mcap")
        assert log.span_ns is not None
        zero_ns = log.span_ns[0] if log.base == "utc" else 0
        utc = utc_offset(log)
        assert utc is not None
        for table in wanted.tables:
            assert_mcap_equals(told[f"/{table.name}"], table, offset_ns=utc.offset_ns)
            assert_csv_equals(tmp_path / f"{table.name}.csv", table, zero_ns)


def test_what_is_there_stays(tmp_path: Path) -> None:
    log = MadeLog(every_kind())
    for file_format, place in (("csv", tmp_path), ("mcap", tmp_path / "out.mcap")):
        exported(log, place, file_format)
        before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
        with pytest.raises(LogError, match=r"already exists; .*--overwrite"):
            exported(log, place, file_format)
        assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before
        export_log(log, ExportSelection(tuple(log.tables.values())), file_format, place, True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["KIND.csv", "columns.csv", "out.mcap"]


def test_places_that_take_no_files(tmp_path: Path) -> None:
    log = MadeLog(every_kind())
    (tmp_path / "file").write_text("mine")
    with pytest.raises(LogError, match="file"):
        exported(log, tmp_path / "file")
    with pytest.raises(LogError, match="file"):
        exported(log, tmp_path / "file" / "out.mcap", "mcap")
    with pytest.raises(LogError, match="csv, parquet, mcap"):
        exported(log, tmp_path, "xlsx")
    (tmp_path / "KIND.csv").mkdir()
    with pytest.raises(LogError, match="is a directory"):
        exported(log, tmp_path)
    assert (tmp_path / "file").read_text() == "mine"


def test_the_log_is_not_written_over(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    exported(MadeLog(every_kind()), path, "mcap")
    before = path.read_bytes()
    with open_log(path) as log, pytest.raises(LogError, match="is the log itself"):
        export_log(log, ExportSelection(tuple(log.tables.values())), "mcap", path, True)
    assert path.read_bytes() == before


@pytest.mark.parametrize("file_format", ["csv", "parquet", "mcap"])
def test_a_full_disk_leaves_nothing_half_written(tmp_path: Path, file_format: str) -> None:
    """A limit on the size of a file stands for a full disk: writing beyond it fails as there."""
    if file_format == "parquet":
        pytest.importorskip("pyarrow.parquet")
    noise = np.random.default_rng(0).normal(size=100_000)
    log = MadeLog(made_table("A", {"x": (Column("x"), noise)}, np.arange(100_000), np.arange(100_000)))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    out = tmp_path / "out.mcap" if file_format == "mcap" else tmp_path
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, hard))
        with pytest.raises(LogError) as told:
            exported(log, out, file_format)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert str(out) in str(told.value)
    assert ".part" not in str(told.value)
    assert list(tmp_path.iterdir()) == []


def test_names_are_what_others_can_read() -> None:
    assert file_names(["/link/agent/rx:ATT", "link_agent_rx_att", "..", "columns"], ("columns",)) == {
        "/link/agent/rx:ATT": "link_agent_rx_ATT",
        "link_agent_rx_att": "link_agent_rx_att_2",
        "..": "message",
        "columns": "columns_2",
    }
    assert field_names(["TimeUS", "GyrX", "_sysid", "pose.x", "pose_x", "2nd", "a__b", "ä"]) == {
        "TimeUS": "timeus",
        "GyrX": "gyrx",
        "_sysid": "sysid",
        "pose.x": "pose_x",
        "pose_x": "pose_x_2",
        "2nd": "f_2nd",
        "a__b": "a_b",
        "ä": "f",
    }
    assert type_names(["GPS_RAW_INT", "ATT", "/truth/state", "2x", "#"]) == {
        "GPS_RAW_INT": "GpsRawInt",
        "ATT": "ATT",
        "/truth/state": "TruthState",
        "2x": "M2x",
        "#": "M",
    }


def test_alignment_is_that_of_cdr(tmp_path: Path) -> None:
    """By hand: header, u1, 7 bytes of padding, f8, u2."""
    columns = {
        "a": (Column("a"), np.array([7], np.uint8)),
        "b": (Column("b"), np.array([1.5])),
        "c": (Column("c"), np.array([9], np.uint16)),
    }
    exported(MadeLog(made_table("A", columns, [1], [1])), tmp_path / "out.mcap", "mcap")
    with (tmp_path / "out.mcap").open("rb") as file:
        ((_, _, message),) = make_reader(file).iter_messages()
    assert message.data == b"\0\1\0\0" + struct.pack("<B7xdH", 7, 1.5, 9)
