from __future__ import annotations

import pytest

from xitl_cli.run.nodes.autopilot import ActuatorUse


def test_exchanges_without_a_new_command_and_the_most_in_a_row() -> None:
    use = ActuatorUse()
    for fresh in (1, 1, 0, 0, 0, 1, 0, 1, 0, 0):
        use.add(bool(fresh), 2_000_000)
    assert (use.report.stale, use.report.longest_stale, use.report.age.count) == (6, 3, 10)


def test_the_age_is_counted_only_when_it_is_known() -> None:
    use = ActuatorUse()
    use.add(True, None)
    assert use.record().age_p50_s is None
    for age_ms in range(1, 101):
        use.add(True, age_ms * 1_000_000)
    record = use.record()
    assert record.exchanges == 101
    assert record.age_p50_s == pytest.approx(0.05, rel=0.04)  # buckets 1/32 of their power of two wide
    assert record.age_max_s == pytest.approx(0.1)
