"""Records of a log, read back by pymavlink, and their descriptions held against ArduRover's own logs."""

from __future__ import annotations

import math
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from dataflash_reader import described, rows_of
from hypothesis import given
from hypothesis import strategies as st
from python39 import strict_zip

from agent.fcu.dataflash.format import FORMATS, FORMATS_IN_LOCKSTEP, RecordFormat, formats, header
from tests.recorded import CALM

# What a reader shows must be within half a step of what went in; a float32 has 24 bits.
STEPS = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}
WHOLE = {
    "b": 8,
    "B": 8,
    "M": 8,
    "h": 16,
    "H": 16,
    "i": 32,
    "I": 32,
    "q": 64,
    "Q": 64,
    "c": 16,
    "C": 16,
    "e": 32,
    "L": 32,
}
UNSIGNED = "BHIQCM"
TEXT = {"n": 4, "N": 16, "Z": 64}
OURS = {"TASK", "TSKQ", "MISS"}


def written(tmp_path: Path, *records: bytes) -> Path:
    path = tmp_path / "log.bin"
    path.write_bytes(header(FORMATS, 1) + b"".join(records))
    return path


def example(letter: str, place: int) -> object:
    if letter in TEXT:
        return f"t{place}"
    return 10 + place if letter not in "fd" else 0.5 + place


def test_every_message_round_trips_with_units_and_multipliers(tmp_path: Path) -> None:
    names = [name for name in FORMATS if name not in ("FMT", "FMTU", "UNIT", "MULT")]
    values = {
        name: [example(letter, place) for place, letter in enumerate(FORMATS[name].letters, start=1)] for name in names
    }
    rows = rows_of(written(tmp_path, *(FORMATS[name].pack(*values[name]) for name in names)))
    for name in names:
        (row,) = rows[name]
        for column, letter, value in strict_zip(FORMATS[name].columns.split(","), FORMATS[name].letters, values[name]):
            assert getattr(row, column) == (
                value if letter in TEXT else pytest.approx(value, abs=STEPS.get(letter, 0))
            ), (
                name,
                column,
            )
    columns = described(rows)
    assert set(columns) == set(FORMATS)
    assert columns["GPS"]["Lat"] == ("L", "deglatitude", pytest.approx(1e-7))
    assert columns["MAG"]["MagX"] == ("h", "Gauss", pytest.approx(1e-3))
    assert columns["IMU"]["GyrX"] == ("f", "rad/s", 1.0)
    assert columns["PM"]["Load"] == ("H", "%", pytest.approx(0.1))
    assert all(described_columns["TimeUS"] == ("Q", "s", pytest.approx(1e-6))
               for name, described_columns in columns.items() if name != "FMT")  # fmt: skip


@pytest.mark.medium
def test_columns_are_those_of_ardurover(tmp_path: Path) -> None:
    ours, theirs = described(rows_of(written(tmp_path))), described(rows_of(CALM))
    assert {name for name in ours if name not in theirs} == OURS
    for name, columns in ours.items():
        if name in OURS:
            continue
        both = [column for column in columns if column in theirs[name]]
        assert [column for column in columns if column not in theirs[name]] in ([], ["SampleUS"]), name
        assert both == [column for column in theirs[name] if column in columns], f"{name}: another order"
        for column in both:
            letter, unit, multiplier = theirs[name][column]
            # Theirs went through a float32.
            assert columns[column] == (letter, unit, pytest.approx(multiplier, rel=1e-6)), f"{name}.{column}"


def test_an_instance_column_is_told_as_one(tmp_path: Path) -> None:
    pack = FORMATS["IMU"].pack
    rows = rows_of(written(tmp_path, *(pack(5, instance, *range(7), 4) for instance in (0, 1))))
    assert [row.fmt.instance_field for row in rows["IMU"]] == ["I", "I"]
    assert [row.I for row in rows["IMU"]] == [0, 1]


def test_each_format_is_announced_before_it_is_used(tmp_path: Path) -> None:
    """Walked by the framing alone: type, length and nothing else is known beforehand than FMT's own."""
    for known in (FORMATS, FORMATS_IN_LOCKSTEP):
        data = header(known, 7)
        lengths = {128: 89}
        at = 0
        while at < len(data):
            assert data[at : at + 2] == b"\xa3\x95"
            kind = data[at + 2]
            assert kind in lengths, f"type {kind} at {at} was not announced"
            if kind == 128:
                lengths[data[at + 3]] = data[at + 4]
            at += lengths[kind]
        assert at == len(data)
        assert len(lengths) == len(known)


def test_in_lockstep_no_load_is_claimed() -> None:
    assert "Load" not in FORMATS_IN_LOCKSTEP["PM"].columns
    assert not OURS & FORMATS_IN_LOCKSTEP.keys()
    # The other records are packed by one table for both.
    for name, row in FORMATS_IN_LOCKSTEP.items():
        assert row.type_id == FORMATS[name].type_id
        assert name == "PM" or row.letters == FORMATS[name].letters


@pytest.mark.medium
def test_mavlogdump_prints_it(tmp_path: Path) -> None:
    path = written(tmp_path, FORMATS["MSG"].pack(2_000_000, "hello"), FORMATS["ATT"].pack(3_000_000, *range(6)))
    script = Path(sys.executable).parent / "mavlogdump.py"
    if not script.exists():
        pytest.skip(f"no {script}: install pymavlink with its scripts")
    for style in ("standard", "json"):
        ran = subprocess.run(
            [sys.executable, str(script), "--types", "ATT,MSG", "--format", style, str(path)],
            capture_output=True, text=True, check=False, timeout=60,
        )  # fmt: skip
        assert ran.returncode == 0, ran.stderr
        assert "hello" in ran.stdout
        assert "DesYaw" in ran.stdout


@pytest.mark.medium
@given(data=st.data(), name=st.sampled_from(sorted(set(FORMATS) - {"FMT", "FMTU", "UNIT", "MULT"})))
def test_any_value_makes_a_readable_record(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, name: str
) -> None:
    """NaN, infinities, numbers beyond the type, long and foreign text: the nearest that fits is read back."""
    row = FORMATS[name]
    numbers = st.one_of(st.integers(-(2**70), 2**70), st.floats())
    values = [data.draw(st.text(max_size=90)) if letter in TEXT else data.draw(numbers) for letter in row.letters]
    record = row.pack(*values)
    assert len(record) == row.length
    path = tmp_path_factory.getbasetemp() / "any.bin"
    path.write_bytes(header(FORMATS, 1) + record + FORMATS["EV"].pack(9, 25))
    rows = rows_of(path)
    assert rows["EV"][-1].Id == 25
    read = rows[name][0]
    for column, letter, value in strict_zip(row.columns.split(","), row.letters, values):
        if letter in TEXT:
            expected = value.encode("ascii", "replace")[: TEXT[letter]].split(b"\0")[0].decode()
            assert getattr(read, column) == expected
        elif letter == "f":
            assert getattr(read, column) == pytest.approx(float32(value), nan_ok=True, rel=1e-6)
        elif letter == "M":  # a byte that pymavlink takes for signed
            assert getattr(read, column) & 0xFF == pytest.approx(clamped(letter, value), abs=0.51)
        else:
            assert getattr(read, column) == pytest.approx(
                clamped(letter, value), abs=STEPS.get(letter, 0.51), rel=1e-12
            )


def float32(value: float) -> float:
    try:
        return struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)


def clamped(letter: str, value: float) -> float:
    if value != value:
        return 0.0
    step, bits = STEPS.get(letter, 1.0), WHOLE[letter]
    low, high = (0, 2**bits - 1) if letter in UNSIGNED else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return min(max(value, low * step), high * step)


def test_a_wrong_table_is_refused() -> None:
    with pytest.raises(ValueError, match=r"XYZ.*no such.*~"):
        RecordFormat(1, "XYZ", "Q~", "TimeUS,A", "s-", "F-")
    with pytest.raises(ValueError, match=r"XYZ.*each"):
        RecordFormat(1, "XYZ", "QB", "TimeUS,A", "s", "F-")
    with pytest.raises(ValueError, match="characters of name"):
        RecordFormat(1, "LONGER", "Q", "TimeUS", "s", "F")
    with pytest.raises(ValueError, match="twice"):
        formats((("EV", "Q", "TimeUS", "s", "F"), ("EV", "Q", "TimeUS", "s", "F")))


@pytest.mark.parametrize("values", [(1,), (1, 2, 3)])
def test_a_wrong_count_of_values_is_an_error(values: tuple[int, ...]) -> None:
    with pytest.raises(struct.error):
        FORMATS["EV"].pack(*values)
    with pytest.raises(struct.error):
        FORMATS["ORGN"].pack(*values)
