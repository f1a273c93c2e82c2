"""GPS time against dates that are known."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from agent.bridges.samples import SECOND_NS, WEEK_S, GpsTime

START = datetime(2026, 1, 1, tzinfo=UTC)


def test_a_known_date() -> None:
    """The first second of 2026 UTC: GPS week 2399, Thursday, 18 s later."""
    gps_ns = GpsTime.from_unix_time(START.timestamp(), 5 * SECOND_NS).gps_ns(5 * SECOND_NS)
    week, rest_ns = divmod(gps_ns, WEEK_S * SECOND_NS)
    assert (week, rest_ns) == (2399, (4 * 86_400 + 18) * SECOND_NS)


def test_time_goes_on_with_the_stamps() -> None:
    time = GpsTime.from_unix_time(START.timestamp(), 0)
    assert time.gps_ns(1_234) - time.gps_ns(0) == 1_234


def test_the_year() -> None:
    assert GpsTime.from_unix_time(START.timestamp(), 0).year_at(0) == pytest.approx(2026.0, abs=0.003)  # a day


def test_runs_that_repeat_have_a_date_of_their_own() -> None:
    week, rest_ns = divmod(GpsTime.fixed().gps_ns(0), WEEK_S * SECOND_NS)
    assert (week, rest_ns) == (2371, 0)
    assert GpsTime.fixed().year_at(0) == pytest.approx(2025.452, abs=0.003)


def test_a_board_without_a_date() -> None:
    assert GpsTime.from_unix_time(0.0, 0) == GpsTime.fixed()
