"""Logs with damage: what was not touched is read, a damaged byte costs one record at most, and every loss is told."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from pymavlink import DFReader

from tests.recorded import CALM
from xitl_cli.logs.formats.dataflash.file import DataFlashLog

FMT = 128
FMT_NAMES_AT = 25
"""Where the names of the columns begin in an FMT record: damage there is not seen, and costs no row."""


@pytest.fixture(scope="module")
def records() -> list[bytes]:
    """A real log in short, one string a record as pymavlink finds them: descriptions, a few parameters, then motion."""
    path = CALM
    reader = DFReader.DFReader_binary(str(path), zero_time_base=True)
    starts = sorted(start for starts in reader.offsets for start in starts)
    lengths = {kind: fmt.len for kind, fmt in reader.formats.items()}
    names = {kind: fmt.name for kind, fmt in reader.formats.items()}
    reader.close()
    data = path.read_bytes()
    found = [data[start : start + lengths[data[start + 2]]] for start in starts]
    describing = ("FMT", "UNIT", "MULT", "FMTU")
    head = [one for one in found if names[one[2]] in describing]
    others = [one for one in found if names[one[2]] in ("PARM", "FILE", "MSG", "MODE", "VER")]
    motion = [one for one in found[40_000:] if names[one[2]] not in (*describing, "FILE")]
    return [*head, *others[:60], *motion[:1500]]


def starts_of(records: list[bytes]) -> list[int]:
    return [0, *np.cumsum([len(one) for one in records])[:-1].tolist()]


def places(log: DataFlashLog) -> set[int]:
    every = [place for table in log.tables.values() for place in table.file_offset.tolist()]
    assert len(every) == len(set(every))
    return set(every)


def held(path: Path, data: bytes, wanted: set[int]) -> int:
    """That rows are at the places where they are wanted, and every loss is counted; how many bytes were lost."""
    path.write_bytes(data)
    with DataFlashLog(path) as log:
        found, health = places(log), log.health
        assert sorted(wanted - found) == []
        undecoded = sum(count for name, (count, _) in health.undecoded.items() if "." not in name)
        assert health.records == len(found) + undecoded
        read = sum(length * len(place) for length, place in extents(log))
        assert health.size_bytes == len(data)
        if not undecoded:
            assert read + health.lost_bytes + health.truncated_bytes == len(data)
        assert health.lost_bytes == sum(one.lost for one in health.damage)
        assert bool(health.damage) == bool(health.damaged)
        return health.lost_bytes


def extents(log: DataFlashLog) -> list[tuple[int, np.ndarray]]:
    """Length and places of the records of each table, by the FMT rows that were read."""
    return [(job.length, job.place) for table in log.tables.values() for job in table.jobs()]


@pytest.mark.medium
@pytest.mark.parametrize("seed", range(4))
def test_a_damaged_byte_costs_its_record_and_no_other(records: list[bytes], tmp_path: Path, seed: int) -> None:
    """Head and type number of any record; of FMT records, on which others hang, all but the names of columns."""
    rng = random.Random(seed)
    log = records[:900]
    whole, starts = b"".join(log), starts_of(log)
    for _ in range(25):
        number = rng.randrange(len(log))
        data = bytearray(whole)
        at = rng.randrange(FMT_NAMES_AT if log[number][2] == FMT else 3)
        data[starts[number] + at] ^= rng.randrange(1, 256)
        lost = held(tmp_path / "damaged.bin", bytes(data), set(starts) - {starts[number]})
        assert lost <= len(log[number])


def edited(rng: random.Random, whole: bytes, first: int) -> tuple[bytes, list[tuple[int, int, int]]]:
    """With a few pieces damaged, gone, put in or overwritten; what is left as (from, to, now at)."""
    data, kept, at = bytearray(), [], 0
    for place in sorted(rng.randrange(first, len(whole)) for _ in range(rng.choice([1, 3, 9]))):
        if place < at:
            continue
        kept.append((at, place, len(data)))
        data += whole[at:place]
        size = min(rng.choice([1, 3, 20, 100, 400]), len(whole) - place)
        what = rng.choice(["flip", "delete", "insert", "zeros", "ones", "noise"])
        if what == "flip":
            data.append(whole[place] ^ rng.randrange(1, 256))
            size = 1
        elif what != "delete":
            data += {"zeros": bytes(size), "ones": b"\xff" * size}.get(what) or rng.randbytes(size)
        at = place if what == "insert" else place + size
    kept.append((at, len(whole), len(data)))
    data += whole[at:]
    return bytes(data), kept


@pytest.mark.parametrize("seed", range(5))
def test_what_is_whole_in_a_damaged_log_is_read(records: list[bytes], tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    whole, starts = b"".join(records), starts_of(records)
    first = next(start for start, one in zip(starts, records, strict=True) if start > 20_000 and one[2] != FMT)
    for _ in range(8):
        data, kept = edited(rng, whole, first)
        if rng.random() < 0.3:
            data = data[: rng.randrange(len(data) * 9 // 10, len(data))]
        wanted = set()
        for start, one in zip(starts, records, strict=True):
            for begin, end, now_at in kept:
                place = start - begin + now_at
                if begin <= start and start + len(one) <= end and place + len(one) <= len(data):
                    wanted.add(place)
        held(tmp_path / "damaged.bin", data, wanted)


@pytest.mark.medium
@pytest.mark.parametrize("seed", range(2))
def test_what_pymavlink_reads_of_a_damaged_log_is_read(
    records: list[bytes], tmp_path: Path, seed: int, capfd: pytest.CaptureFixture[str]
) -> None:
    """Its messages, held against ours by where they begin, as far as their bytes are as they were written."""
    rng = random.Random(seed)
    whole, starts = b"".join(records), starts_of(records)
    data = bytearray(whole)
    for _ in range(8):
        data[rng.randrange(starts[600], len(whole))] ^= rng.randrange(1, 256)
    path = tmp_path / "damaged.bin"
    path.write_bytes(data)
    lengths = dict(zip(starts, map(len, records), strict=True))
    reader = DFReader.DFReader_binary(str(path), zero_time_base=True)
    compared = 0
    with DataFlashLog(path) as log:
        row = {place: (t, at) for t in log.tables.values() for at, place in enumerate(t.file_offset.tolist())}
        while (message := reader.recv_msg()) is not None:
            start = reader.offset - message.fmt.len
            length = lengths.get(start)
            if length is None or data[start : start + length] != whole[start : start + length]:
                continue
            table, at = row[start]
            assert table.name == message.get_type()
            for column in message.get_fieldnames()[:3]:
                value = table.values(column, slice(at, at + 1), raw=True)[0]
                theirs = getattr(message, column)
                assert value == theirs or value != value, f"{table.name}.{column}"
            compared += 1
    reader.close()
    capfd.readouterr()  # what it says of the damage
    assert compared > 500


def test_a_cut_off_record_at_the_end_is_told_and_no_damage(records: list[bytes], tmp_path: Path) -> None:
    whole, starts = b"".join(records), starts_of(records)
    path = tmp_path / "cut.bin"
    for cut in (1, 2, 5, len(records[-1]) - 1):
        path.write_bytes(whole[:-cut])
        with DataFlashLog(path) as log:
            assert log.health.truncated_bytes + log.health.lost_bytes == len(records[-1]) - cut
            assert log.health.records == len(records) - 1
            assert log.health.degraded
            assert max(places(log)) == starts[-2]


def test_a_log_without_its_beginning_says_so(records: list[bytes], tmp_path: Path) -> None:
    """Its first record begins somewhere in the middle: what is before is lost, and told."""
    path = tmp_path / "rest.bin"
    path.write_bytes(b"".join(records)[40:])
    with DataFlashLog(path) as log:
        (damage,) = log.health.damage
        assert (damage.place, damage.lost) == (0, 89 - 40)
        assert log.health.records == len(records) - 1


def test_two_logs_in_one_file(records: list[bytes], tmp_path: Path) -> None:
    """The second describes the same types under other numbers: everything is read, and the times go back."""
    path = tmp_path / "both.bin"
    numbers = {one[2]: 255 - one[2] if one[2] != FMT and 255 - one[2] != FMT else one[2] for one in records}

    def renumbered(one: bytes) -> bytes:
        if one[2] == FMT:
            kind = one[3]
            return one[:3] + bytes([numbers.get(kind, 255 - kind if 255 - kind != FMT else kind)]) + one[4:]
        return one[:2] + bytes([numbers[one[2]]]) + one[3:]

    whole = b"".join(records)
    path.write_bytes(whole + b"".join(map(renumbered, records)))
    with DataFlashLog(path) as log:
        assert log.health.records == 2 * len(records)
        assert not log.health.degraded
        assert log.health.redefined > 50
        assert log.health.back_in_time > 10
        for name in ("IMU", "XKF1", "MSG"):
            table = log.tables[name]
            half = len(table) // 2
            for column in table.columns:
                once, again = (table.values(column, rows) for rows in (slice(half), slice(half, None)))
                np.testing.assert_array_equal(once, again)
            assert (np.diff(table.file_offset) > 0).all()


def test_a_log_twice_in_one_file_describes_nothing_anew(records: list[bytes], tmp_path: Path) -> None:
    path = tmp_path / "twice.bin"
    path.write_bytes(b"".join(records) * 2)
    with DataFlashLog(path) as log:
        assert log.health.redefined == 0
        assert log.health.records == 2 * len(records)
        assert len(log.tables["FMT"]) == 2 * sum(one[2] == FMT for one in records)
