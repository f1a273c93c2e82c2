"""Bins by the power of two, and what can be read off them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.timing.tasks import BINS, EMPTY, histogram_bin, quantile_us


def test_edges() -> None:
    edges_us = {0: 0, 1: 0, 2: 1, 3: 1, 4: 2, 7: 2, 8: 3, 32_767: 14, 32_768: 15, 10**9: 15}
    assert {us: histogram_bin(us * 1000) for us in edges_us} == edges_us
    assert (histogram_bin(1_999), histogram_bin(2_000), histogram_bin(3_999), histogram_bin(-5)) == (0, 1, 1, 0)


@pytest.mark.medium
@given(st.lists(st.integers(0, 200_000_000), min_size=1), st.floats(0.0, 1.0))
def test_a_quantile_is_not_exceeded_and_at_most_twice_too_long(times_ns: list[int], share: float) -> None:
    bins = [0] * BINS
    for time_ns in times_ns:
        bins[histogram_bin(time_ns)] += 1
    longest_us = max(times_ns) // 1000
    found_us = quantile_us(bins, share, longest_us)
    at_most = sum(time_ns // 1000 <= found_us for time_ns in times_ns)
    assert at_most >= share * len(times_ns)
    if longest_us < 32_768:
        exact_us = sorted(times_ns)[max(math.ceil(share * len(times_ns)), 1) - 1] // 1000
        assert found_us <= max(2 * exact_us, 2)


def test_of_nothing_nothing_is_known() -> None:
    assert quantile_us(EMPTY, 0.99, 0) == 0
