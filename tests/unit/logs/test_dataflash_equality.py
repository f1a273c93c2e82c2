"""Every message of the recorded ArduRover logs as pymavlink's reader has it: all fields, and the order."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pymavlink import DFReader

from tests.recorded import LOGS
from xitl_cli.logs.formats.dataflash.file import DataFlashLog

NAMES = (
    "boat-auto-calm.bin",
    "boat-auto-external-ahrs.bin",
    "boat-auto-gust.bin",
    "boat-auto-linux-hal-injected.bin",
)
SLICE = 400_000
"""Bytes from the start: descriptions, parameters, files, and the first rows of most types."""


def messages(path: Path) -> list[Any]:
    reader = DFReader.DFReader_binary(str(path), zero_time_base=True)
    found = []
    while (message := reader.recv_msg()) is not None:
        found.append(message)
    reader.close()
    return found


def unpacked(row: Any, place: int) -> Any:
    """The value before pymavlink converts it."""
    return row._elements[place]


def one_by_one(rows: list[Any], place: int, column: str) -> list[Any]:
    """As pymavlink hands values out; numbers that need no conversion as it has unpacked them."""
    plain = rows[0].fmt.format[place] in "bBhHiIqQfdga"
    return [unpacked(row, place) if plain else getattr(row, column) for row in rows]


def at_once(rows: list[Any], place: int, column: str) -> list[Any]:
    """The same where it is long: a divisor of pymavlink's is applied to a whole column."""
    factor = rows[0].fmt.msg_mults[place]
    if factor is None:
        return one_by_one(rows, place, column)
    divisor = 1 / factor
    return [unpacked(row, place) / divisor for row in rows]


def same(ours: NDArray[Any], wanted: list[Any]) -> bool:
    if ours.dtype.kind in "OU":
        return [str(v) if isinstance(v, str) else v for v in ours.tolist()] == wanted
    return np.array_equal(ours.astype(np.float64), np.array(wanted, dtype=np.float64), equal_nan=True) and (
        ours.dtype.kind == "f" or ours.tolist() == [v.tolist() if hasattr(v, "tolist") else v for v in wanted]
    )


def hold_against_pymavlink(path: Path, theirs: Callable[[list[Any], int, str], list[Any]]) -> None:
    wanted = messages(path)
    by_name: dict[str, list[Any]] = defaultdict(list)
    for message in wanted:
        by_name[message.get_type()].append(message)
    with DataFlashLog(path) as log:
        assert log.health.records == len(wanted)
        assert list(log.tables) == sorted(by_name)
        place = np.concatenate([table.file_offset for table in log.tables.values()])
        name = np.repeat(list(log.tables), [len(table) for table in log.tables.values()])
        assert name[np.argsort(place)].tolist() == [message.get_type() for message in wanted]
        everything = log.read(raw=True)
        for kind, rows in by_name.items():
            table = log.tables[kind]
            assert list(table.columns) == rows[0].get_fieldnames()
            for at, column in enumerate(table.columns):
                ours = table.values(column, raw=True)
                assert same(ours, theirs(rows, at, column)), f"{kind}.{column}"
                again = everything[kind][column]
                assert again.dtype == ours.dtype
                assert again.tobytes() == ours.tobytes() or again.tolist() == ours.tolist()


@pytest.mark.medium
@pytest.mark.parametrize("name", NAMES)
def test_the_start_of_a_recorded_log_reads_as_pymavlink_reads_it(name: str, tmp_path: Path) -> None:
    path = tmp_path / "start.bin"
    path.write_bytes((LOGS / name).read_bytes()[:SLICE])
    hold_against_pymavlink(path, one_by_one)


@pytest.mark.slow
@pytest.mark.parametrize("name", [NAMES[0], *(pytest.param(name, marks=pytest.mark.nightly) for name in NAMES[1:])])
def test_a_whole_recorded_log_reads_as_pymavlink_reads_it(name: str) -> None:
    hold_against_pymavlink(LOGS / name, at_once)


@pytest.mark.medium
def test_scaled_columns_are_what_unit_and_mult_make_of_the_raw_ones() -> None:
    """UNIT, MULT and FMTU are taken from pymavlink's messages, and the arithmetic is Python's own."""
    path = LOGS / NAMES[0]
    reader = DFReader.DFReader_binary(str(path), zero_time_base=True)
    units: dict[str, str] = {}
    factors: dict[str, float] = {}
    meaning: dict[int, tuple[str, str]] = {}
    while (message := reader.recv_match(type=["UNIT", "MULT", "FMTU"], strict=True)) is not None:
        if message.get_type() == "UNIT":
            units[chr(message.Id)] = message.Label
        elif message.get_type() == "MULT":
            factors[chr(message.Id)] = float(f"{message.Mult:.7g}")  # a float32 in a double
        else:
            meaning[message.FmtType] = message.UnitIds, message.MultIds
    formats = {fmt.name: fmt for fmt in reader.formats.values()}
    reader.close()
    scaled = 0
    with DataFlashLog(path) as log:
        for name, table in log.tables.items():
            unit_ids, factor_ids = meaning.get(formats[name].type, ("", ""))
            for at, column in enumerate(table.columns.values()):
                if column.kind != "number" or column.shape or not unit_ids:
                    continue
                raw, values = table.values(column.name, raw=True), table.values(column.name)
                factor, label = factors[factor_ids[at]], units[unit_ids[at]]
                time = label == "s" and factor in (1e-6, 1e-3)
                if time and formats[name].format[at] not in "fd":
                    assert column.unit == {1e-6: "us", 1e-3: "ms"}[factor]
                    assert values.tolist() == raw.tolist()
                elif formats[name].format[at] in "cCeEL" or factor_ids[at] in "-?" or factor in (0.0, 1.0):
                    np.testing.assert_array_equal(values, raw)
                else:
                    # one rounding of the product and one of the factor
                    np.testing.assert_allclose(values, raw.astype(np.float64) * factor, rtol=4e-16)
                    assert column.raw_unit != column.unit or not column.unit
                    scaled += 1
                if label in ("m", "m/s", "rad/s", "deg", "Pa") and not time:
                    assert column.unit == label
                assert (table.instance == column.name) == (unit_ids[at] == "#")
    assert scaled > 10
