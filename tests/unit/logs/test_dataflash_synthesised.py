"""DataFlash logs packed by `struct` or by our own writer: every letter, every way of describing, hostile ones."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataflash_records import CODES, FMT, ITSELF, described, record
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agent.fcu.dataflash.format import FORMATS, header
from xitl_cli.logs.formats.dataflash import records
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.formats.dataflash.records import Bytes, Forget, Heads, find_heads
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.system_files import embedded_contents, embedded_files

BITS = {"b": 8, "B": 8, "M": 8, "h": 16, "H": 16, "i": 32, "I": 32, "q": 64, "Q": 64}
BITS |= {"c": 16, "C": 16, "e": 32, "E": 32, "L": 32, "a": 16}
DIVISORS = {"c": 100, "C": 100, "e": 100, "E": 100, "L": 10_000_000}
MINUTE_US = 60_000_000


def values_of(letter: str) -> st.SearchStrategy[Any]:
    if letter in "gfd":
        return st.floats(width={"g": 16, "f": 32, "d": 64}[letter], allow_nan=True)  # type: ignore[arg-type]
    if letter in "nNZ":
        return st.binary(max_size={"n": 4, "N": 16, "Z": 64}[letter])
    low, high = 0, (1 << BITS[letter]) - 1
    if letter in "bhiqceLa":
        low, high = -(1 << BITS[letter] - 1), (1 << BITS[letter] - 1) - 1
    one = st.integers(low, high)
    return st.tuples(*[one] * 32) if letter == "a" else one


@st.composite
def types(draw: st.DrawFn) -> tuple[str, list[tuple[Any, ...]]]:
    letters = draw(st.text("bBMhHiIqQgfdncCeELNZ", min_size=1, max_size=16))
    if sum(struct.calcsize("<" + CODES[letter]) for letter in letters) > 180 or draw(st.booleans()):
        letters = letters[:2]
    if draw(st.integers(0, 4)) == 0:
        letters = letters[:1] + "a"
    return letters, draw(st.lists(st.tuples(*map(values_of, letters)), min_size=1, max_size=4))


def wanted(letter: str, value: Any) -> Any:
    if letter in "nNZ":
        value += bytes({"n": 4, "N": 16, "Z": 64}[letter] - len(value))
        try:
            return value.decode().partition("\0")[0]
        except UnicodeDecodeError:
            return value.decode("latin-1").partition("\0")[0]
    return value / DIVISORS[letter] if letter in DIVISORS else list(value) if letter == "a" else value


def alike(ours: Any, theirs: Any) -> bool:
    return bool(ours == theirs or (ours != ours and theirs != theirs))


@pytest.mark.medium
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(types(), min_size=1, max_size=4))
def test_every_letter_comes_back_as_it_was_packed(
    tmp_path: Path, logged: list[tuple[str, list[tuple[Any, ...]]]]
) -> None:
    data = ITSELF
    for kind, (letters, _) in enumerate(logged):
        data += described(kind, b"T%d" % kind, letters)
    for row in range(4):
        for kind, (letters, rows) in enumerate(logged):
            data += b"".join(record(kind, letters, *values) for values in rows[row : row + 1])
    path = tmp_path / "a.bin"
    path.write_bytes(data)
    with DataFlashLog(path) as log:
        assert log.health.records == 1 + len(logged) + sum(len(rows) for _, rows in logged)
        assert not log.health.degraded
        for kind, (letters, rows) in enumerate(logged):
            table = log.tables[f"T{kind}"]
            at_once = table.read(raw=True)
            for place, letter in enumerate(letters):
                ours = table.values(f"F{place}", raw=True)
                assert len(ours) == len(rows)
                for mine, again, theirs in zip(ours.tolist(), at_once[f"F{place}"].tolist(), rows, strict=True):
                    assert alike(mine, wanted(letter, theirs[place]))
                    assert alike(mine, again)


def test_rows_come_by_slice_by_number_and_by_mask(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(ITSELF + described(1, b"X", "Qh") + b"".join(record(1, "Qh", n, -n) for n in range(10)))
    with DataFlashLog(path) as log:
        table = log.tables["X"]
        assert table.values("F1", slice(2, 8, 3)).tolist() == [-2, -5]
        assert table.values("F1", np.array([7, 0])).tolist() == [-7, 0]
        assert table.values("F1", np.arange(10) > 7).tolist() == [-8, -9]
        assert table.values("F1", slice(3, 3)).tolist() == []
        with pytest.raises(KeyError):
            table.values("F2")


def test_what_our_own_writer_packs_is_read_in_its_units(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    rows = [
        FORMATS["GPS"].pack(1_000_000 * n, 0, 3, 0, 0, 9, 47.5 + n, -8.25, 1.5, 2.0, 30.0, -0.5, 1, n) for n in (1, 2)
    ]
    rows += [FORMATS["MAG"].pack(1_000_000 * n, 1, 250, -100, n, 0, 0, 0, 0) for n in (1, 2)]
    path.write_bytes(header(FORMATS, 1000) + b"".join(rows))
    with DataFlashLog(path) as log:
        gps = log.tables["GPS"]
        assert gps.values("Lat").tolist() == [48.5, 49.5]
        assert (gps.columns["Lat"].unit, gps.columns["TimeUS"].unit, gps.instance) == ("deg", "us", "I")
        assert gps.stamp_ns.tolist() == [1_000_000_000, 2_000_000_000]
        assert log.tables["MAG"].values("MagX").tolist() == [0.25, 0.25]
        assert log.tables["MAG"].values("MagX", raw=True).tolist() == [250, 250]
        assert (log.tables["MAG"].columns["MagX"].unit, log.tables["MAG"].columns["MagX"].raw_unit) == (
            "Gauss",
            "mGauss",
        )
        assert log.span_ns == (1_000_000, 2_000_000_000)


def test_rows_without_a_time_have_that_of_the_last_row_before(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    timed = [record(1, "Q", n * 1000) for n in (5, 7, 6)]
    path.write_bytes(
        ITSELF + described(1, b"T", "Q", "TimeUS") + described(2, b"FILE", "B") + record(2, "B", 0)
        + timed[0] + timed[1] + record(2, "B", 1) + timed[2] + record(2, "B", 2) + record(2, "B", 3)
    )  # fmt: skip
    with DataFlashLog(path) as log:
        assert log.tables["FILE"].stamp_ns.tolist() == [0, 7_000_000, 6_000_000, 6_000_000]
        assert log.tables["FMT"].stamp_ns.tolist() == [0, 0, 0]
        assert log.health.back_in_time == 1


def test_an_old_log_counts_milliseconds(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(
        ITSELF + described(1, b"ATT", "Ih", "TimeMS,Roll") + described(2, b"GPS", "IHI", "TimeMS,Week,T")
        + described(3, b"GPS2", "BII", "Status,TimeMS,T") + described(4, b"NONE", "B", "X")
        + record(1, "Ih", 100, 1) + record(3, "BII", 3, 400_000, 120) + record(4, "B", 1)
    )  # fmt: skip
    with DataFlashLog(path) as log:
        assert log.tables["ATT"].stamp_ns.tolist() == [100_000_000]
        assert log.tables["GPS2"].stamp_ns.tolist() == [120_000_000]
        assert log.tables["NONE"].stamp_ns.tolist() == [120_000_000]
        assert log.span_ns == (100_000_000, 120_000_000)


def test_a_type_that_is_described_behind_its_rows(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    rows = [record(1, "QB", n, n) for n in range(4)]
    path.write_bytes(b"".join(rows[:2]) + ITSELF + described(1, b"LATE", "QB") + b"".join(rows[2:]))
    with DataFlashLog(path) as log:
        assert log.tables["LATE"].values("F1").tolist() == [0, 1, 2, 3]
        assert not log.health.degraded


def test_a_type_that_is_described_anew_means_that_from_there_on(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(
        ITSELF + described(1, b"X", "QB", "TimeUS,A") + record(1, "QB", 1, 7) + described(1, b"X", "QhZ", "TimeUS,B,C")
        + record(1, "QhZ", 2, -5, b"text") + described(2, b"X", "Qf", "TimeUS,A") + record(2, "Qf", 3, 0.5)
    )  # fmt: skip
    with DataFlashLog(path) as log:
        table = log.tables["X"]
        assert log.health.redefined == 1
        assert table.stamp_ns.tolist() == [1000, 2000, 3000]
        np.testing.assert_array_equal(table.values("A"), [7, np.nan, 0.5])
        np.testing.assert_array_equal(table.read()["A"], [7, np.nan, 0.5])
        np.testing.assert_array_equal(table.values("B", np.array([1, 0])), [-5, np.nan])
        assert table.values("C").tolist() == table.read()["C"].tolist() == ["", "text", ""]


@pytest.mark.parametrize(
    ("fmt", "rows", "undecoded"),
    [
        (described(1, b"BAD", "Q", length=0), [], {}),
        (described(1, b"BAD", "Q", length=2), [], {}),
        (described(1, b"BAD", "", "", length=3), [b"\xa3\x95\x01"], {"BAD": 1}),
        (described(1, b"BAD", "", "X", length=9), [b"\xa3\x95\x01......"] * 2, {"BAD": 2}),
        (described(1, b"BAD", "xy", "X,Y", length=9), [b"\xa3\x95\x01......"] * 2, {"BAD": 2}),
        (described(1, b"BAD", "BBB", length=20), [b"\xa3\x95\x01" + bytes(17)], {"BAD": 1}),
        (described(1, b"BAD", "Zd", length=9), [b"\xa3\x95\x01......"], {"BAD": 1}),
    ],
)
def test_a_type_that_cannot_be_read_is_told_and_the_others_are_read(
    tmp_path: Path, fmt: bytes, rows: list[bytes], undecoded: dict[str, int]
) -> None:
    path = tmp_path / "a.bin"
    good = [record(2, "QB", n, n) for n in range(6)]
    path.write_bytes(ITSELF + fmt + described(2, b"GOOD", "QB") + b"".join(good[:3] + rows + good[3:]))
    with DataFlashLog(path) as log:
        assert log.tables["GOOD"].values("F1").tolist() == list(range(6))
        assert {name: count for name, (count, _) in log.health.undecoded.items()} == undecoded
        assert all(why.startswith("FMT gives it") for _, why in log.health.undecoded.values())
        assert "BAD" not in log.tables


def test_a_letter_that_is_not_known_costs_its_column_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(ITSELF + described(1, b"X", "QhB", code="Q\xe7B") + record(1, "QhB", 5, 6, 7))
    with DataFlashLog(path) as log:
        assert list(log.tables["X"].columns) == ["F0", "F2"]
        assert log.tables["X"].values("F2").tolist() == [7]
        assert log.health.undecoded["X.F1"][0] == 1


@pytest.mark.parametrize(
    ("columns", "names"),
    [
        ("A,B,C", ["A", "B", "C"]),
        ("A,,A", ["A", "column_2", "A_3"]),
        ("A,B;C", ["A", "B", "C"]),
        ("A,BxC", ["A", "column_2", "column_3"]),
        ("A,B,C,D", ["A", "column_2", "column_3"]),
        ("", ["column_1", "column_2", "column_3"]),
        ("A,\xff,C", ["A", "\\xff", "C"]),
    ],
)
def test_names_that_do_not_fit_the_letters_are_made_up_for(tmp_path: Path, columns: str, names: list[str]) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(ITSELF + described(1, b"X", "BhB", columns) + record(1, "BhB", 1, 2, 3))
    with DataFlashLog(path) as log:
        assert list(log.tables["X"].columns) == names
        assert [log.tables["X"].values(name).tolist() for name in names] == [[1], [2], [3]]


def test_types_that_nothing_describes_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    rows = [record(9, "QI", n, 0) + record(2, "QB", n, n) for n in range(5)]
    path.write_bytes(ITSELF + described(2, b"GOOD", "QB") + b"".join(rows))
    with DataFlashLog(path) as log:
        assert log.health.undecoded == {"type 9": (5, "no FMT record describes it")}
        assert log.health.lost_bytes == 0
        assert len(log.tables["GOOD"]) == 5


def test_heads_within_payloads_are_payload(tmp_path: Path) -> None:
    """Also such whose record would end at a head: its time tells."""
    path = tmp_path / "a.bin"
    decoys = [
        b"\xa3\x95\x02".ljust(16, b"."),
        (b"." * 5) + b"\xa3\x95\x02" + bytes(8),
        b"\xa3\x95\x80".ljust(16, b"\0"),
    ]
    assert len(decoys[1]) == 16
    rows = [record(1, "QN", MINUTE_US + n, decoys[n % 3]) + record(2, "Q", MINUTE_US + n) for n in range(9)]
    path.write_bytes(
        ITSELF + described(1, b"X", "QN", "TimeUS,Name") + described(2, b"Y", "Q", "TimeUS") + b"".join(rows)
    )
    with DataFlashLog(path) as log:
        assert (len(log.tables["X"]), len(log.tables["Y"]), log.health.damaged) == (9, 9, 0)
        assert log.tables["Y"].values("TimeUS").tolist() == [MINUTE_US + n for n in range(9)]


def test_descriptions_of_units_that_make_no_sense_describe_nothing(tmp_path: Path) -> None:
    """Text where a type number belongs, numbers where text does, and a factor that is none."""
    path = tmp_path / "a.bin"
    path.write_bytes(
        ITSELF + described(4, b"FMTU", "NBn", "FmtType,UnitIds,MultIds") + described(5, b"UNIT", "NB", "Id,Label")
        + described(6, b"MULT", "bd", "Id,Mult") + described(7, b"FMTU", "BNN", "FmtType,UnitIds,MultIds")
        + described(1, b"X", "hh") + record(4, "NBn", b"", 1, b"-") + record(5, "NB", b"d", 3)
        + record(6, "bd", ord("A"), float("inf")) + record(6, "bd", ord("B"), float("nan"))
        + record(7, "BNN", 1, b"dd", b"AB") + record(1, "hh", 5, 6)
    )  # fmt: skip
    with DataFlashLog(path) as log:
        assert log.tables["X"].values("F0").tolist() == [5]
        assert log.tables["X"].values("F1").tolist() == [6]
        assert {column.unit for column in log.tables["X"].columns.values()} == {""}


def test_embedded_files_are_put_together(tmp_path: Path) -> None:
    def piece(name: bytes, offset: int, data: bytes, length: int | None = None) -> bytes:
        return record(3, "NIBZ", name, offset, len(data) if length is None else length, data)

    path = tmp_path / "a.bin"
    path.write_bytes(
        ITSELF + described(3, b"FILE", "NIBZ", "FileName,Offset,Length,Data") + piece(b"a.txt", 0, b"x" * 64)
        + piece(b"b.lua", 0, b"old") + piece(b"a.txt", 64, b"y\0z") + piece(b"c.bin", 128, b"tail")
        + piece(b"c.bin", 4_000_000_000, b"far") + piece(b"b.lua", 0, b"new", 200) + piece(b"b.lua", 0, b"new!")
    )  # fmt: skip
    with DataFlashLog(path) as log:
        assert embedded_contents(log) == {"a.txt": b"x" * 64 + b"y\0z", "b.lua": b"new!", "c.bin": bytes(128) + b"tail"}
        found = embedded_files(log)
        assert (found["a.txt"].gaps, found["b.lua"].refused) == (0, 1)
        assert (found["c.bin"].gaps, found["c.bin"].lost_bytes, found["c.bin"].refused) == (1, 128, 1)
        assert log.tables["FILE"].values("Data")[0] == b"x" * 64


@pytest.mark.parametrize("content", [b"", b"time,C1\n1,2\n", bytes(1000), b"\xa3\x95", b"\xa3\x95\x80" * 50])
def test_a_file_that_is_no_log_is_refused_in_one_sentence(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"a\.bin: (is no|describes none)"):
        DataFlashLog(path)
    with pytest.raises(LogError, match="cannot be read"):
        DataFlashLog(tmp_path)
    with pytest.raises(LogError, match="cannot be read"):
        DataFlashLog(tmp_path / "none.bin")


HOSTILE = st.one_of(
    st.binary(max_size=200),
    st.builds(lambda payload: b"\xa3\x95\x80" + payload, st.binary(min_size=86, max_size=86)),
    st.builds(
        lambda kind, length, name, code, columns: FMT.pack(b"\xa3\x95", 128, kind, length, name, code, columns),
        st.integers(0, 255), st.integers(0, 255), st.binary(max_size=4),
        st.text("QBhfZaLMx", max_size=16).map(str.encode), st.text("AB,", max_size=30).map(str.encode),
    ),
    st.builds(lambda kind, data: b"\xa3\x95" + bytes([kind]) + data, st.integers(0, 255), st.binary(max_size=80)),
    st.sampled_from([ITSELF, bytes(300), b"\xff" * 300, b"\xa3\x95\x80" * 40, b"\xa3" * 99]),
)  # fmt: skip


@pytest.mark.medium
@settings(max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(HOSTILE, max_size=30))
def test_no_bytes_raise_anything_but_a_sentence(tmp_path: Path, parts: list[bytes]) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"".join(parts))
    try:
        log = DataFlashLog(path)
    except LogError:
        return
    with log:
        rows = 0
        for table in log.tables.values():
            assert len(table) == len(table.file_offset) == len(table.stamp_ns) > 0
            at_once = table.read()
            for name, column in table.columns.items():
                values = table.values(name)
                assert values.shape == at_once[name].shape == (len(table), *column.shape)
            rows += len(table)
        health = log.health
        assert health.records == rows + sum(n for name, (n, _) in health.undecoded.items() if "." not in name)
        assert 0 <= health.lost_bytes + health.truncated_bytes <= health.size_bytes
        assert embedded_contents(log) is not None
        log.span_ns  # noqa: B018


def test_a_log_of_more_than_2_gb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows on both sides of a hole of zeros, which takes no room on the disk, and no time as no head is looked for."""
    path = tmp_path / "large.bin"
    rows = [record(1, "QI", 1_000_000 * n, n) for n in range(100)]
    hole = (2 << 30) + 12_345
    with path.open("wb") as file:
        file.write(ITSELF + described(1, b"X", "QI", "TimeUS,N") + b"".join(rows[:50]))
        begin = file.tell()
        file.seek(hole, 1)
        file.write(b"".join(rows[50:]))

    def beside_the_hole(data: Bytes, forget: Forget) -> Heads:
        before, behind = find_heads(data[:begin], forget), find_heads(data[begin + hole :], forget)
        assert before.place.dtype == np.int64
        places = np.concatenate((before.place, behind.place + begin + hole))
        return Heads(places, np.concatenate((before.type_id, behind.type_id)))

    monkeypatch.setattr(records, "find_heads", beside_the_hole)
    with DataFlashLog(path) as log:
        table = log.tables["X"]
        assert table.values("N").tolist() == list(range(100))
        assert table.stamp_ns.tolist() == [10**9 * n for n in range(100)]
        assert int(table.file_offset[-1]) == begin + hole + 49 * 15
        assert (log.health.damage[0].place, log.health.damage[0].lost) == (begin, hole)
        assert table.read()["N"].tolist() == list(range(100))
        assert log.read()["X"]["N"].tolist() == list(range(100))
