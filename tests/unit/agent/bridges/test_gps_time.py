"""GPS time against dates that are known."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from agent.bridges.gps_time import SECOND_NS, WEEK_S, fixed, of_unix_time

START = datetime(2026, 1, 1, tzinfo=UTC)


def test_a_known_date() -> None:
    """The first second of 2026 UTC: GPS week 2399, Thursday, 18 s later."""
    gps_ns = of_unix_time(START.timestamp(), 5 * SECOND_NS).at(5 * SECOND_NS)
    week, rest_ns = divmod(gps_ns, WEEK_S * SECOND_NS)
    assert (week, rest_ns) == (2399, (4 * 86_400 + 18) * SECOND_NS)


def test_time_goes_on_with_the_stamps() -> None:
    time = of_unix_time(START.timestamp(), 0)
    assert time.at(1_234) - time.at(0) == 1_234


def test_the_year() -> None:
    assert of_unix_time(START.timestamp(), 0).year_at(0) == pytest.approx(2026.0, abs=0.003)  # a day


def test_runs_that_repeat_have_a_date_of_their_own() -> None:
    week, rest_ns = divmod(fixed().at(0), WEEK_S * SECOND_NS)
    assert (week, rest_ns) == (2371, 0)
    assert fixed().year_at(0) == pytest.approx(2025.452, abs=0.003)


def test_a_board_without_a_date() -> None:
    assert of_unix_time(0.0, 0) == fixed()
