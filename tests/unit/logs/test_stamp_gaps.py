"""Rates and gaps of stamps that were put there."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xitl_cli.logs.signals.gaps import regularity
from xitl_cli.logs.signals.spans import covered_share

MS = 1_000_000


def test_an_even_series_has_no_gap():
    found = regularity(np.arange(100) * 20 * MS)
    assert found is not None
    assert (found.rate_hz, found.jitter_s, found.gaps, found.repeated, found.backward) == (50.0, 0.0, 0, 0, 0)
    assert found.longest == ()
    assert found.longest_gap_s == 0.0


def test_gaps_are_counted_sized_and_placed():
    stamps = np.delete(np.arange(200) * 20 * MS, [*range(50, 60), 120])
    found = regularity(stamps)
    assert found is not None
    assert (found.gaps, found.long_gaps, found.missing) == (2, 1, 11)
    assert [(gap.from_ns, gap.until_ns, gap.missing) for gap in found.longest] == [
        (49 * 20 * MS, 60 * 20 * MS, 10),
        (119 * 20 * MS, 121 * 20 * MS, 1),
    ]


def test_repeated_and_backward_stamps_are_no_gaps():
    stamps = np.arange(100) * 20 * MS
    stamps[40] = stamps[39]
    stamps[70] = 5 * MS  # one wrong stamp: 69 to 71 is what is missing, not 5 ms to 71
    found = regularity(stamps)
    assert found is not None
    assert (found.repeated, found.backward) == (1, 1)
    assert found.back_s == pytest.approx((69 * 20 - 5) * 1e-3)
    assert [gap.missing for gap in found.longest] == [1, 1]


def test_rows_that_share_a_stamp_are_a_burst():
    """Two rows every 10 ms, sometimes four after 20 ms: their rate is 200 Hz, and nothing is missing."""
    stamps = np.repeat(np.arange(200) * 10 * MS, 2)
    stamps[np.flatnonzero(np.arange(400) // 2 % 10 == 5)] += 10 * MS
    found = regularity(np.sort(stamps))
    assert found is not None
    assert found.rate_hz == pytest.approx(200.0, rel=0.02)
    assert (found.bursts, found.gaps, found.missing) == (True, 0, 0)


def test_the_expected_period_may_be_given():
    found = regularity(np.arange(100) * 40 * MS, period_s=0.02)
    assert found is not None
    assert (found.gaps, found.missing) == (99, 99)


def bursts(groups: int, lost: range = range(0)) -> np.ndarray:
    """Four rows at once, a millisecond apart, each 80 ms."""
    return np.array([80 * group + row for group in range(groups) if group not in lost for row in range(4)]) * MS


def test_rows_in_bursts_have_their_mean_rate_and_no_gaps():
    found = regularity(bursts(9))
    assert found is not None
    assert (found.bursts, found.gaps, found.missing) == (True, 0, 0)
    assert found.period_s == pytest.approx(0.020)
    few = regularity(bursts(8))  # 32 rows do not tell that they are bursts
    assert few is not None
    assert (few.bursts, few.period_s, few.gaps, few.missing) == (False, 0.001, 7, 7 * 76)


def test_an_outage_among_bursts_counts_what_the_mean_rate_lacks():
    """Forty of 101 groups are lost. Within a group, rows are up to 2.85 of 20 ms early: so much may be made up for."""
    found = regularity(bursts(101, range(50, 90)))
    assert found is not None
    assert (found.bursts, found.long_gaps) == (True, 1)
    assert found.period_s == pytest.approx(0.020)
    assert [(gap.from_ns, gap.until_ns, gap.missing) for gap in found.longest] == [(3923 * MS, 7200 * MS, 157)]


EVERY = np.arange(1000)
LOST = np.random.default_rng(1).choice(900, 90, replace=False)


@pytest.mark.parametrize(
    ("stamps_ms", "in_bursts", "period_ms", "missing"),
    [
        (20 * np.delete(EVERY, LOST), False, 20.0, 90),  # a tenth is lost at random
        (20 * EVERY[EVERY % 10 != 9], True, 200 / 9, 0),  # each tenth: its rate is lower
        (np.cumsum(np.where(EVERY % 2, 30, 50)), True, 40.0, 0),
        (np.cumsum(np.where(EVERY % 20, 20, 33)), True, 20.65, 0),  # what is late by half a period is not lost
        (np.cumsum(np.where(EVERY % 4, 20, 33)), True, 23.25, 0),
        (np.cumsum(np.where(EVERY % 40 == 39, 40, 20)), False, 20.0, 25),
    ],
)
def test_even_rows_with_losses_are_told_from_uneven_rows(stamps_ms, in_bursts, period_ms, missing):
    found = regularity(stamps_ms * MS)
    assert found is not None
    assert (found.bursts, found.missing) == (in_bursts, missing)
    assert found.period_s == pytest.approx(period_ms * 1e-3, rel=1e-3)


def unsteady(*steps: tuple[int, int]) -> np.ndarray:
    """Rows of 20 ms; in their middle, so many steps of so many ms."""
    middle = [ms for number, ms in steps for _ in range(number)]
    return np.cumsum([0, *[20] * 500, *middle, *[20] * 500]) * MS


@pytest.mark.parametrize(
    ("stamps", "gaps", "missing"),
    [
        (unsteady((1, 1020)), 1, 50),
        (unsteady((1, 1020), (63, 4)), 0, 0),  # late by 50 periods, and each row makes up for 0.8 of one
        (unsteady((1, 1020), (25, 4)), 1, 30),
        (unsteady((31, 4), (1, 516)), 0, 0),  # early by 24.8 periods, then as late
        (unsteady((25, 4), (1, 820)), 1, 20),
        (unsteady((1, 1020), (15, 20), (63, 4)), 0, 0),
        (unsteady((1, 1020), (40, 20), (50, 4)), 1, 17),  # seen are 82 rows, 42 of them faster
    ],
)
def test_rows_that_come_late_or_early_are_not_missing(stamps, gaps, missing):
    found = regularity(stamps)
    assert found is not None
    assert (found.period_s, found.bursts) == (0.02, False)
    assert (found.gaps, found.missing) == (gaps, missing)


def test_a_given_period_is_not_taken_for_bursts():
    found = regularity(bursts(20), period_s=0.02)
    assert found is not None
    assert (found.bursts, found.rate_hz) == (False, 50.0)


@pytest.mark.parametrize("stamps", [[], [1], [1, 2], [5, 5, 5, 5], [9, 8, 7]])
def test_too_little_to_tell(stamps):
    assert regularity(np.array(stamps, dtype=np.int64)) is None


@pytest.mark.medium
@given(st.lists(st.integers(-(2**60), 2**60), min_size=3, max_size=60))
def test_any_stamps_are_counted(stamps):
    found = regularity(np.array(stamps, dtype=np.int64))
    if found is not None:
        steps = np.diff(stamps)
        assert found.repeated == np.count_nonzero(steps == 0)
        assert found.backward == np.count_nonzero(steps < 0)
        assert found.gaps >= found.long_gaps
        assert found.missing >= found.gaps


def test_a_gap_is_excused_by_one_pause_of_the_log_not_by_many_slow_steps() -> None:
    gap = np.array([0]), np.array([1_000_000_000])
    slow = np.array([[at, at + 21_000_000] for at in range(0, 1_000_000_000, 22_000_000)])
    assert covered_share(*gap, slow)[0] == pytest.approx(0.021)
    assert covered_share(*gap, np.array([[100_000_000, 900_000_000]]))[0] == pytest.approx(0.8)
    assert covered_share(*gap, np.array([[-500_000_000, 2_000_000_000]]))[0] == 1.0
    assert covered_share(*gap, np.array([[1_000_000_000, 2_000_000_000]]))[0] == 0.0
    assert covered_share(*gap, np.empty((0, 2), dtype=np.int64))[0] == 0.0
