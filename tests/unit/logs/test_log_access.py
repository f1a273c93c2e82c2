"""A log in Python: names and misspelt names, columns and their units, pandas."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from made_table import every_kind

from tests.recorded import CALM
from xitl_cli.logs import LogError, open_log
from xitl_cli.logs.clocks.time_line import AlignedLog
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.formats.mcap.file import McapLog
from xitl_cli.logs.formats.tlog.file import TelemetryLog
from xitl_cli.logs.model.log import Log, LogView, once_per_log
from xitl_cli.logs.model.table import by_instance, distinct


def test_a_log_is_its_tables_and_a_table_its_columns() -> None:
    with open_log(str(CALM)) as log:
        assert list(log) == list(log.tables)
        assert len(log) == len(log.tables)
        assert "ATT" in log
        assert "Att" not in log  # what `in` says, iterating says too
        table = log["att"]
        assert table is log["ATT"]
        assert list(table) == list(table.columns)
        assert "Roll" in table
        np.testing.assert_array_equal(table["roll"], table.values("Roll"))
        assert table.columns["Roll"].unit == "deg"
        assert table["Roll"].shape == table.stamp_ns.shape == (len(table),)
        imu = by_instance(log["IMU"])[0]
        assert len(imu["GyrX"]) == len(imu)


def test_a_part_of_a_column_is_that_part_of_the_whole_column() -> None:
    with DataFlashLog(CALM) as read_in_parts, DataFlashLog(CALM) as read_at_once:
        every = read_at_once.read()
        for name in ("ATT", "IMU", "GPS", "MSG", "ISBD"):
            if name not in every:
                continue
            table = read_in_parts[name]
            odd = np.arange(len(table)) % 2 == 1
            few = np.array([0, -1])
            for column, values in every[name].items():
                for rows in (slice(3), few, odd, np.flatnonzero(odd), slice(None), slice(3), few):
                    np.testing.assert_array_equal(table.values(column, rows), values[rows])


def test_a_changed_array_changes_nothing_in_the_log() -> None:
    with DataFlashLog(CALM) as log:
        for rows in (slice(None), slice(5), np.arange(5)):
            before = log["ATT"].values("Roll", rows).copy()
            log["ATT"].values("Roll", rows)[:] = 1e3
            np.testing.assert_array_equal(log["ATT"].values("Roll", rows), before)


def test_an_instance_that_is_no_number_makes_no_instances() -> None:
    for numbers in (np.array(["", "1"]), np.ones((2, 3))):
        table = MadeTable("IMU", [1, 2], {"I": numbers, "GyrX": [0.0, 1.0]}, instance="I")
        assert by_instance(table) == {0: table}


def test_instances_are_by_number() -> None:
    for code in ("u1", "i2", "f8"):
        numbers = np.array([2, 0, 2, 0, 2], code)
        parts = by_instance(MadeTable("IMU", range(5), {"I": numbers, "GyrX": np.arange(5.0)}, instance="I"))
        assert {number: part["GyrX"].tolist() for number, part in parts.items()} == {0: [1, 3], 2: [0, 2, 4]}
        assert parts[2].stamp_ns.tolist() == [0, 2, 4]


def test_distinct_stamps_are_sorted_and_unique() -> None:
    rng = np.random.default_rng(3)
    for count in (0, 1, 2, 1000):
        stamps = rng.integers(-50, 50, count)
        np.testing.assert_array_equal(distinct(stamps), np.unique(stamps))


def test_a_reader_reads_each_log_once() -> None:
    reads = []

    @once_per_log
    def rows(log: Log) -> list[int]:
        reads.append(log)
        return [len(table) for table in log.tables.values()]

    logs = [MadeLog(MadeTable("ATT", range(count), {"Roll": np.zeros(count)})) for count in (2, 3)]
    assert [rows(log) for log in (*logs, *logs)] == [[2], [3], [2], [3]]
    assert reads == logs


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda log: log["ATTT"], "made.bin: has no message 'ATTT'; did you mean 'ATT'? `xitl logs info` lists them"),
        (lambda log: log["ATT"]["Rol"], "ATT has no field 'Rol'; did you mean 'Roll'? it has Roll, Pitch"),
        (lambda log: log["ATT"]["xyz"], "ATT has no field 'xyz'; it has Roll, Pitch"),
    ],
)
@pytest.mark.parametrize("kind", [LogError, KeyError])
def test_a_misspelt_name_is_told_with_its_neighbour(ask: Any, sentence: str, kind: type[Exception]) -> None:
    log = MadeLog(MadeTable("ATT", [1, 2], {"Roll": [0.0, 1.0], "Pitch": [0.0, 1.0]}))
    with pytest.raises(kind) as told:
        ask(log)
    assert str(told.value) == sentence


@pytest.mark.medium
def test_pandas_gets_all_rows_with_time_and_units() -> None:
    table = every_kind(rows=5, first_ns=2_000_000_000)
    frame = table.to_pandas()
    assert frame.index.name == "time_s"
    np.testing.assert_allclose(frame.index, table.stamp_ns * 1e-9)
    np.testing.assert_array_equal(frame["Angle"], table["Angle"])
    np.testing.assert_array_equal(frame["Fixed[1]"], table["Fixed"][:, 1])
    np.testing.assert_array_equal(frame["pose.x[2]"], table["pose.x"][:, 2])
    assert list(frame["Text"]) == list(table["Text"])
    assert frame.attrs["units"]["Angle"] == "deg"
    assert frame["Ni4"].dtype == np.int32
    raw = table.to_pandas(raw=True)
    assert raw.attrs["units"]["Angle"] == "cdeg"
    np.testing.assert_array_equal(raw["Angle"], table.values("Angle", raw=True))


def test_pandas_of_a_real_log_has_what_its_columns_have() -> None:
    with open_log(CALM) as log:
        frame = log["GPS"].to_pandas()
        assert len(frame) == len(log["GPS"])
        np.testing.assert_array_equal(frame["Lat"], log["GPS"]["Lat"])


def test_without_pandas_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(LogError, match=r"pip install 'xitl\[pandas\]'"):
        every_kind().to_pandas()


def test_importing_the_logs_loads_no_numpy_before_one_is_opened() -> None:
    program = "import xitl_cli.logs, sys; print('numpy' in sys.modules)"
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "False"


@pytest.mark.parametrize("kind", [McapLog, DataFlashLog, TelemetryLog])
def test_an_aligned_log_answers_what_its_format_answers_itself(kind: type[Log]) -> None:
    answered = {name for name in vars(Log) if not name.startswith("_")} & set(vars(kind))
    assert answered <= vars(AlignedLog).keys() | vars(LogView).keys()
