"""What a table of many seeds says, from summaries made by hand."""

from __future__ import annotations

import pytest

from tests.bench.bench_seeds import seed_range, spreads


def summary(seed: int, cross_track_m: float, coverage: float | None) -> dict:
    mapping = None if coverage is None else {"coverage": coverage}
    return {"seed": seed, "mission": {"cross_track_rms_m": cross_track_m}, "mapping": mapping}


def test_the_bad_side_of_a_figure_is_told() -> None:
    found = {spread.figure.name: spread for spread in spreads([summary(n, 0.1 * n, 1.0 - 0.01 * n) for n in range(21)])}
    track, seen = found["cross-track, RMS"], found["floats seen of those passed"]
    assert (track.median, track.percentile_95, track.worst) == pytest.approx((1.0, 1.9, 2.0))
    assert (seen.median, seen.percentile_95, seen.worst) == pytest.approx((90.0, 81.0, 80.0))
    assert (track.seed, seen.seed, track.runs) == (20, 20, 21)


def test_what_no_run_tells_has_no_row_and_a_run_without_it_does_not_count() -> None:
    found = spreads([summary(3, 0.5, None), summary(4, 0.7, 0.9)])
    assert [(spread.figure.name, spread.runs) for spread in found] == [
        ("cross-track, RMS", 2),
        ("floats seen of those passed", 1),
    ]


def test_seeds_are_a_range_or_a_list() -> None:
    assert seed_range("501-503") == [501, 502, 503]
    assert seed_range("7,3") == [7, 3]
