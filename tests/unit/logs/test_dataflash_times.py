"""Times that cannot be are replaced and counted; pauses, restarts and types that end early are not touched."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataflash_records import ITSELF, described, record

from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.formats.dataflash.table import implausible

SECOND_US = 1_000_000
HOUR_US = 3600 * SECOND_US
STEADY_US = [n * SECOND_US // 50 for n in range(1000)]


def log_of(path: Path, dense_us: list[int], rare_us: dict[int, list[int]], letter: str = "Q") -> DataFlashLog:
    """rare_us: after which row of the dense type, and when."""
    data = ITSELF + described(1, b"D", f"{letter}H", "TimeUS,N") + described(2, b"R", f"{letter}B", "TimeUS,N")
    for row, time_us in enumerate(dense_us):
        data += record(1, f"{letter}H", time_us, row)
        data += b"".join(record(2, f"{letter}B", one, 7) for one in rare_us.get(row, []))
    path.write_bytes(data + described(3, b"END", "B"))
    return DataFlashLog(path)


@pytest.mark.parametrize("wrong_us", [2**63 + 5, 2**62, 2**44, 15 * SECOND_US])
@pytest.mark.parametrize("row", [1, 500, 998])
def test_a_time_far_from_both_neighbours_is_that_of_the_row_before(tmp_path: Path, wrong_us: int, row: int) -> None:
    times = [STEADY_US[n] + wrong_us if n == row else STEADY_US[n] for n in range(1000)]
    with log_of(tmp_path / "x.bin", times, {100: [STEADY_US[100]]}) as log:
        table = log.tables["D"]
        expected = [STEADY_US[n - (n == row)] * 1000 for n in range(1000)]
        assert table.stamp_ns.tolist() == expected
        assert table.ends_ns == (expected[0], expected[-1])
        assert table.values("TimeUS").tolist() == times  # as stored
        assert log.span_ns == (0, STEADY_US[-1] * 1000)
        assert (log.health.replaced_stamps, log.health.back_in_time, log.health.degraded) == (1, 0, True)


@pytest.mark.parametrize(("row", "stamp_us"), [(0, STEADY_US[1]), (999, STEADY_US[998])])
def test_at_either_end_it_must_be_very_far(tmp_path: Path, row: int, stamp_us: int) -> None:
    for wrong_us, replaced in ((HOUR_US // 2, 0), (2 * HOUR_US, 1)):
        times = [STEADY_US[n] + wrong_us if n == row else STEADY_US[n] for n in range(1000)]
        with log_of(tmp_path / "x.bin", times, {}) as log:
            assert int(log.tables["D"].stamp_ns[row]) == (stamp_us if replaced else times[row]) * 1000
            assert log.health.replaced_stamps == replaced


def test_two_rows_that_are_far_apart_keep_their_times(tmp_path: Path) -> None:
    with log_of(tmp_path / "x.bin", [0, 5 * HOUR_US], {}) as log:
        assert log.tables["D"].stamp_ns.tolist() == [0, 5 * HOUR_US * 1000]
        assert log.health.replaced_stamps == 0


def test_a_rare_type_is_held_against_what_surrounds_it(tmp_path: Path) -> None:
    with log_of(tmp_path / "x.bin", STEADY_US, {100: [STEADY_US[100]], 200: [2**50], 300: [STEADY_US[300]]}) as log:
        assert log.tables["R"].stamp_ns.tolist() == [STEADY_US[row] * 1000 for row in (100, 200, 300)]
        assert log.health.replaced_stamps == 1


def test_a_row_that_tells_no_time_does_not_have_a_wrong_one(tmp_path: Path) -> None:
    times = [*STEADY_US[:-1], 2**60]
    with log_of(tmp_path / "x.bin", times, {}) as log:
        assert log.tables["FMT"].stamp_ns.tolist() == [0, 0, 0, STEADY_US[-2] * 1000]


def test_so_it_is_where_times_are_short(tmp_path: Path) -> None:
    """Not the layout of today, in which eight bytes of time begin a record."""
    times = [2**31 if n == 500 else STEADY_US[n] for n in range(1000)]
    with log_of(tmp_path / "x.bin", times, {100: [STEADY_US[100]]}, "I") as log:
        assert int(log.tables["D"].stamp_ns[500]) == STEADY_US[499] * 1000
        assert log.span_ns == (0, STEADY_US[-1] * 1000)
        assert (log.health.replaced_stamps, log.health.back_in_time) == (1, 0)


@pytest.mark.parametrize(
    ("dense_us", "rare_us", "back"),
    [
        (STEADY_US, {100: [STEADY_US[100]]}, 0),
        ([*STEADY_US, *(t + HOUR_US for t in STEADY_US)], {999: [HOUR_US // 2], 1500: [HOUR_US + 10**7]}, 0),  # a pause
        ([*(t + HOUR_US for t in STEADY_US), *STEADY_US], {1500: [10 * SECOND_US]}, 1),  # a restart
        (STEADY_US, {999: [500 * SECOND_US, 900 * SECOND_US]}, 0),  # the dense type is logged while armed only
    ],
)
def test_what_can_be_is_left_as_it_is(
    tmp_path: Path, dense_us: list[int], rare_us: dict[int, list[int]], back: int
) -> None:
    with log_of(tmp_path / "x.bin", dense_us, rare_us) as log:
        assert log.tables["D"].stamp_ns.tolist() == [one * 1000 for one in dense_us]
        assert log.tables["R"].stamp_ns.tolist() == [one * 1000 for some in rare_us.values() for one in some]
        assert (log.health.replaced_stamps, log.health.back_in_time, log.health.degraded) == (0, back, False)


def test_wild_times_alone_are_no_more_than_wild() -> None:
    """Whatever they are, a finite answer: no row is named twice, none that is not there."""
    random = np.random.default_rng(0)
    for count in (0, 1, 2, 3, 40, 5000):
        found = implausible(random.integers(0, 2**63 - 1, count))
        assert np.array_equal(found, np.unique(found))
        assert len(found) <= count
