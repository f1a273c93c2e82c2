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
from xitl_cli.logs.model.log import Log, LogView
from xitl_cli.logs.model.table import by_instance


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
