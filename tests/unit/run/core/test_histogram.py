from __future__ import annotations

import numpy as np
import pytest

from tests.memory_size import size_bytes
from xitl_cli.run.core.statistics import Histogram


@pytest.mark.parametrize("share", [0.01, 0.5, 0.9, 0.99, 0.999])
def test_quantiles_agree_with_numpy_to_the_width_of_a_bucket(share: float) -> None:
    values = np.random.default_rng(4).lognormal(12.0, 2.0, 20_000).astype(np.int64)
    histogram = Histogram()
    for value in values.tolist():
        histogram.add(value)
    # Half a bucket is at most 1/64 of the value; the two also differ in how they pick between neighbours.
    assert histogram.quantile_ns(share) == pytest.approx(np.quantile(values, share), rel=0.03)
    assert histogram.max_ns == values.max()


def test_small_values_are_exact_and_nothing_exceeds_the_maximum() -> None:
    histogram = Histogram()
    for value in (0, 1, 5, -3, 63):
        histogram.add(value)
    assert histogram.quantile_ns(0.5) == 1
    assert histogram.quantile_ns(1.0) == 63
    assert histogram.count == 5


def test_memory_stays_bounded_over_any_range() -> None:
    histogram = Histogram()
    for exponent in range(0, 62):
        for step in range(200):
            histogram.add((1 << exponent) + (step << exponent) // 200)
    assert size_bytes(histogram) < 16 * 62 * 33


def test_an_empty_one_has_no_quantiles() -> None:
    assert Histogram().quantile_ns(0.5) is None
