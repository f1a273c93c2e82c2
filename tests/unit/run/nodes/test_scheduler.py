"""PM records of DataFlash logs as different versions write them, held against pymavlink's reader."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from pymavlink import DFReader

from xitl_cli.run.nodes.bridge import scheduler_record

HEAD = b"\xa3\x95"
FMT = struct.Struct("<2sBBB4s16s64s")
NOW = ("QHHHIIHHIIIIIIB", "TimeUS,LR,NLon,NL,MaxT,Mem,Load,ErrL,InE,ErC,SPIC,I2CC,I2CI,Ex,R")
OLDER = ("QHHIIHHIHIIII", "TimeUS,NLon,NLoop,MaxT,Mem,Load,ErrL,IntE,ErrC,SPIC,I2CC,I2CI,Ex")
CODES = {"Q": "Q", "H": "H", "I": "I", "B": "B", "?": "B"}
PM, OTHER = 77, 78


def record(kind: int, layout: str, *values: int) -> bytes:
    return HEAD + bytes([kind]) + struct.pack("<" + "".join(CODES[letter] for letter in layout), *values)


def formats(*rows: tuple[int, str, str, str]) -> bytes:
    itself = FMT.pack(HEAD, 128, 128, FMT.size, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    others = [
        FMT.pack(
            HEAD,
            128,
            kind,
            3 + struct.calcsize("<" + "".join(CODES[letter] for letter in layout)),
            name.encode(),
            layout.encode(),
            columns.encode(),
        )
        for kind, name, layout, columns in rows
    ]
    return itself + b"".join(others)


def pm(columns: tuple[str, str], **values: int) -> bytes:
    layout, names = columns
    return record(PM, layout, *(values.get(name, 0) for name in names.split(",")))


def log(columns: tuple[str, str], rows: list[dict[str, int]]) -> bytes:
    """Rows of PM with others between, one of which holds the head of a PM record in its payload."""
    layout, names = columns
    data = formats((PM, "PM", layout, names), (OTHER, "ODD", "QI", "TimeUS,X"))
    decoy = int.from_bytes(HEAD + bytes([PM, 0]), "little")
    for row in rows:
        data += pm(columns, **row) + record(OTHER, "QI", row["TimeUS"] + 1, decoy)
    return data


@pytest.mark.parametrize(("columns", "loops"), [(NOW, "NL"), (OLDER, "NLoop")])
def test_the_rows_are_summed_whatever_the_version_calls_them(
    tmp_path: Path, columns: tuple[str, str], loops: str
) -> None:
    rows = [
        {"TimeUS": 10_000_000 * n, "NLon": n, loops: 500, "MaxT": 20_000 + 100 * n, "Load": 100 * n}
        for n in range(1, 6)
    ]
    path = tmp_path / "a.bin"
    path.write_bytes(log(columns, rows))
    found = scheduler_record(path)
    assert found is not None
    reader = DFReader.DFReader_binary(str(path), zero_time_base=True)
    theirs = []
    while (message := reader.recv_match(type="PM")) is not None:
        theirs.append(message)
    assert found.rows == len(theirs) == 5
    assert found.long_loops == sum(message.NLon for message in theirs) == 15
    assert found.loops == sum(getattr(message, loops) for message in theirs) == 2500
    assert found.max_us == max(message.MaxT for message in theirs) == 20_500
    assert found.load_mean_percent == pytest.approx(30.0)
    assert found.load_max_percent == 50.0
    assert loops in found.fields
    assert "TimeUS" not in found.fields
    reader.data_map.close()
    reader.filehandle.close()


def test_a_log_that_was_cut_off_gives_the_rows_that_are_whole(tmp_path: Path) -> None:
    rows = [{"TimeUS": 10_000_000 * n, "NLon": 1} for n in range(1, 4)]
    path = tmp_path / "a.bin"
    path.write_bytes(log(NOW, rows)[:-40])
    found = scheduler_record(path)
    assert found is not None
    assert found.rows == 2


@pytest.mark.parametrize("data", [b"", b"\xa3\x95\x80", formats((PM, "PM", *NOW)), formats((PM, "PM", "Q?", "A,B"))])
def test_no_rows_are_no_record(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(data)
    assert scheduler_record(path) is None
    assert scheduler_record(tmp_path / "none.bin") is None
