"""Recorded pulse widths: what is read, and how a wrong file is named."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink import DFReader

from agent.fcu.dataflash.format import FORMATS, header
from tests.recorded import CALM
from xitl_cli.errors import UserError
from xitl_cli.replay.pulse_log import read_csv, read_dataflash


def _csv(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "table.csv"
    path.write_bytes(text.encode())
    return path


@pytest.mark.parametrize(
    "text",
    [
        "time_s,C1,C3\n0.5,1500,0\n1.25,1900.5,1100\n",
        "# from a pool\n C3 , TimeUS, note, C1\n\n0,500000,a,1500\n# later\n1100,1250000,b,1900.5\n",
        "\ufefftime_s,C1,C3\r\n0.5,1500,0\r\n1.25,1900.5,1100\r\n",
    ],
)
def test_tables_of_several_tongues_say_the_same(tmp_path: Path, text: str) -> None:
    log = read_csv(_csv(tmp_path, text))
    assert log.at_s == (0.5, 1.25)
    assert log.pulses_us == {1: (1500.0, 1900.5), 3: (0.0, 1100.0)}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ("table.csv: is empty", "write time_s,C1,C3")),
        ("# nothing\n", ("table.csv: is empty",)),
        ("t,C1\n0,1500\n", ("table.csv:1: has no column time_s", "write time_s,C1,C3")),
        ("time_s,left\n0,1500\n", ("table.csv:1: has no column of an output",)),
        ("time_s,C1\n", ("table.csv:1: no data follows the names",)),
        ("time_s,C1\n0,1500\n1\n", ("table.csv:3: has 1 columns, but the first line has 2",)),
        ("time_s,C1\n0,1500\n# so\n1,fast\n", ("table.csv:4: column C1: 'fast' is not a number",)),
        ("time_s,C1\n0,1500\nnan,1500\n", ("table.csv:3: column time_s: 'nan' is not a number",)),
        ("time_s,C1\n1,1500\n1,1500\n", ("table.csv:3: column time_s: 1 s is not after", "sort the lines by time")),
        ("time_s,C1\n1,0.7\n", ("table.csv:2: column C1: 0.7 is no pulse width", "500 to 2500 µs, or 0")),
        ("time_s,C1\n1,-1500\n", ("table.csv:2: column C1: -1500 is no pulse width",)),
        ('time_s,C1\n1,"15\n00"\n', ("table.csv:3: column C1: '15\\n00' is not a number",)),
    ],
)
def test_a_wrong_table_is_named_with_line_column_and_fix(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    with pytest.raises(UserError) as caught:
        read_csv(_csv(tmp_path, text))
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_a_table_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_bytes(b"\xa3\x95\x80\xff\xfe")
    with pytest.raises(UserError, match="is not text"):
        read_csv(tmp_path / "table.csv")
    with pytest.raises(UserError, match="cannot be read"):
        read_csv(tmp_path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is not a DataFlash log"),
        (b"time_s,C1\n", "is not a DataFlash log"),
        (b"\xa3\x95\x80", "table.bin: "),
        (b"\xa3\x95\x80" + bytes(range(256)) * 4, "table.bin: "),
    ],
)
def test_a_wrong_log_is_one_line(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "table.bin"
    path.write_bytes(content)
    with pytest.raises(UserError, match=words) as caught:
        read_dataflash(path)
    assert "\n" not in str(caught.value)


def test_a_damaged_time_costs_its_row_and_none_behind_it(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    times_us = [2**60 if n == 20 else 20_000 * n for n in range(1, 41)]
    rows = [FORMATS["RCOU"].pack(time_us, *[1500] * 14) for time_us in times_us]
    path.write_bytes(header(FORMATS, 1000) + b"".join(rows))
    assert [round(at_s * 50) for at_s in read_dataflash(path).at_s] == [n for n in range(1, 41) if n != 20]


@pytest.mark.medium
def test_an_ardurover_log_reads_as_pymavlink_reads_it() -> None:
    path = CALM
    log = read_dataflash(path)
    reader = DFReader.DFReader_binary(str(path), zero_time_base=True)
    rows = []
    while (message := reader.recv_match(type="RCOU")) is not None:
        rows.append((message.TimeUS * 1e-6, float(message.C1), float(message.C3)))
    reader.data_map.close()
    reader.filehandle.close()
    assert len(rows) > 900
    assert list(zip(log.at_s, log.pulses_us[1], log.pulses_us[3], strict=True)) == rows
    assert log.functions[1] == 26  # ground steering
    assert log.functions[3] == 70  # throttle
