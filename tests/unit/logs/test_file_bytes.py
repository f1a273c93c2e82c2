"""Files that change while they are read, and what is known of a table without reading all of its stamps."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from tests.recorded import CALM
from xitl_cli.logs import open_log
from xitl_cli.logs.model import file_bytes
from xitl_cli.logs.model.file_bytes import FileBytes
from xitl_cli.logs.summary import summarize_log


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "run.bin"
    path.write_bytes(CALM.read_bytes()[:500_000])
    return path


def test_a_log_that_is_cut_short_while_it_is_open_is_read_as_it_was(log: Path) -> None:
    with open_log(log) as whole:
        wanted = {name: table.stamp_ns.copy() for name, table in whole.tables.items()}
    with open_log(log) as opened:
        os.truncate(log, 1000)
        assert {name: len(table) for name, table in opened.tables.items()} == {
            name: len(stamps) for name, stamps in wanted.items()
        }
        for name, table in opened.tables.items():
            np.testing.assert_array_equal(table.stamp_ns, wanted[name])


def test_a_mapped_file_has_the_same_bytes(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = FileBytes(log)
    monkeypatch.setattr(file_bytes, "LARGE", 1000)
    mapped = FileBytes(log)
    np.testing.assert_array_equal(mapped.data, read.data)
    mapped.forget(0, len(mapped.data) + 5)
    np.testing.assert_array_equal(mapped.data, read.data)
    for each in (read, mapped):
        assert not each.data.flags.writeable
        each.close()
        assert len(each.data) == 0


def test_rates_come_from_stamps_of_their_own(log: Path) -> None:
    with open_log(log) as opened:
        summary = summarize_log(opened)
        tables = dict(opened.tables)
        for message in summary.messages:
            stamps = tables[message.name].stamp_ns
            if message.name in ("FMT", "FILE"):  # have no time
                assert message.rate_hz is None
            elif message.rate_hz is not None:
                length_s = float(stamps[-1] - stamps[0]) * 1e-9
                each = len(stamps) / (message.instances or 1)
                assert message.rate_hz == pytest.approx((each - 1) / length_s)
    assert any(message.rate_hz for message in summary.messages)
