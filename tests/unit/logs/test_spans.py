"""Spans of time: runs, spells, holds and pauses by examples at each limit."""

from __future__ import annotations

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.signals.spans import (
    HeldRows,
    covered_share,
    dense_end_ns,
    find_holds,
    held_spans,
    inside,
    join_runs,
    length_s,
    log_pauses,
    runs,
    spans_where,
    spells,
)

SECOND = 1_000_000_000


def flags(text: str) -> np.ndarray:
    return np.array([letter == "x" for letter in text])


def test_runs_of_true_rows() -> None:
    assert runs(flags("")) == []
    assert runs(flags("...")) == []
    assert runs(flags("xx.x..xxx")) == [(0, 2), (3, 4), (6, 9)]
    assert join_runs([(0, 2), (3, 4), (6, 9)], 2) == [(0, 4), (6, 9)]
    assert join_runs([(0, 2), (3, 4), (6, 9)], 3) == [(0, 9)]
    assert join_runs([], 3) == []


def test_a_held_row_lasts_until_the_next() -> None:
    stamps = np.array([0, 10, 20, 30, 40])
    assert held_spans(stamps, flags("x.xx.")) == [(0, 10), (20, 40)]
    assert held_spans(stamps, flags("...xx")) == [(30, 40)]


def test_spans_are_from_the_first_to_the_last_row() -> None:
    stamps = np.array([0, 1, 2, 3, 5, 6]) * SECOND
    assert spans_where(stamps, flags("x.xx.x")) == [(0, 0), (2 * SECOND, 3 * SECOND), (6 * SECOND, 6 * SECOND)]
    assert spans_where(stamps, flags("x.xx.x"), 2.0) == [(0, 3 * SECOND), (6 * SECOND, 6 * SECOND)]
    assert spans_where(stamps, flags("x.xx.x"), 3.0) == [(0, 6 * SECOND)]
    back = np.array([0, 5, 3, 1, 2]) * SECOND
    assert spans_where(back, flags("xx.xx"), 9.0) == [(0, 5 * SECOND), (SECOND, 2 * SECOND)]
    assert spans_where(back, flags(".xxx.")) == []  # it ends before it begins


def test_spells_bridge_two_seconds_and_the_longest_are_named() -> None:
    stamps = np.array([8, 0, 1, 2, 4, 7, 9]) * SECOND
    flagged = flags("xx.x.x.")  # 0 s, 2 s, 7 s and 8 s
    assert spells(stamps, flagged) == [(0, 2 * SECOND), (7 * SECOND, 8 * SECOND)]
    assert spells(stamps, flagged, most=1) == [(0, 2 * SECOND)]
    assert spells(stamps, flagged, 1.9) == [(0, 0), (2 * SECOND, 2 * SECOND), (7 * SECOND, 8 * SECOND)]
    assert spells(stamps, flagged, 1.9, most=1) == [(7 * SECOND, 8 * SECOND)]
    assert spells(stamps, flagged, 5.0) == [(0, 8 * SECOND)]


def test_rows_inside_spans_have_their_ends() -> None:
    spans = [(20, 30), (0, 10), (22, 25)]
    stamps = np.array([-1, 0, 10, 11, 19, 20, 26, 30, 31])
    assert inside(stamps, spans).tolist() == [False, True, True, False, False, True, True, True, False]
    assert inside(stamps, []).tolist() == [False] * 9
    assert length_s(spans) == pytest.approx(23e-9)


def test_values_that_do_not_change_for_a_second_are_a_hold() -> None:
    values = np.arange(100.0)
    values[20:50] = 7.0
    values[60:69] = 8.0  # nine rows are few
    found = find_holds(values, 0.1)
    assert found.holds == (HeldRows(20, 49),)
    assert found.repeated == pytest.approx((29 + 8) / 99)
    assert found.usual == pytest.approx(70 / 62)  # without the hold
    assert find_holds(values, 1.0 / 30.0).holds == (HeldRows(20, 49),)
    assert find_holds(values, 0.033).holds == ()  # 30 rows are 0.99 s
    assert find_holds(values, 0.02, shortest_s=0.6).holds == (HeldRows(20, 49),)


def test_values_within_the_resolution_are_equal_unless_they_drift() -> None:
    values = np.arange(100.0)
    values[20:50] = 7.0
    values[21:50:3] = 7.01
    assert find_holds(values, 0.1).holds == ()
    assert find_holds(values, 0.1, resolution=0.011).holds == (HeldRows(20, 49),)
    assert find_holds(values, 0.1, resolution=0.009).holds == ()
    values[20:50] = 7.0 + 0.01 * np.arange(30)
    assert find_holds(values, 0.1, resolution=0.011).holds == ()


@pytest.mark.parametrize(("rows", "held"), [(19, False), (20, True)])
def test_a_hold_is_twenty_times_as_long_as_usual(rows: int, held: bool) -> None:
    values = np.concatenate((np.arange(50.0), np.full(rows, 99.0), np.arange(50.0)))
    assert bool(find_holds(values, 0.1).holds) is held
    nine = np.concatenate((np.arange(50.0), np.full(9, 99.0), np.arange(50.0)))
    assert find_holds(nine, 5.0).holds == ()


def test_a_sensor_that_repeats_usually_needs_a_longer_hold() -> None:
    rows = np.repeat(np.arange(50.0), 4)
    assert find_holds(rows, 0.1).usual == 4.0
    held = np.concatenate((rows, np.full(79, 99.0), rows))
    assert find_holds(held, 0.1).holds == ()
    held = np.concatenate((rows, np.full(80, 99.0), rows))
    assert find_holds(held, 0.1).holds == (HeldRows(200, 279),)


def test_rows_of_several_values_are_held_if_all_are() -> None:
    values = np.stack([np.zeros(40), np.repeat([0.0, 1.0], [15, 25])], axis=1)
    assert find_holds(values, 0.1).holds == ()  # every row is held, so nothing is unusual
    values[:16, 0] = np.arange(16)
    assert find_holds(values, 0.1).holds == (HeldRows(16, 39),)
    assert find_holds(np.zeros(1), 0.1).holds == ()
    assert find_holds(np.zeros(1), 0.1).usual == 1.0


def dense(name: str, *spans_s: tuple[float, float], rate_hz: float = 10.0) -> MadeTable:
    at_s = np.concatenate([np.arange(round(a * rate_hz), round(b * rate_hz)) / rate_hz for a, b in spans_s])
    return MadeTable(name, np.round(at_s * SECOND).astype(np.int64), {"A": np.zeros(len(at_s))})


def test_a_pause_is_one_of_every_dense_message() -> None:
    one, other = dense("A", (0.0, 10.0), (12.0, 20.0)), dense("B", (0.0, 11.0), (12.0, 15.0), (16.0, 20.0))
    sparse = dense("C", (0.0, 20.0), rate_hz=1.0)
    assert log_pauses(MadeLog(one, other, sparse)).tolist() == [[10_900_000_000, 12 * SECOND]]
    assert log_pauses(MadeLog(one, sparse)).tolist() == []  # one table alone may pause by itself


@pytest.mark.parametrize(("gap_s", "pause"), [(0.3, False), (0.4, True)])
def test_a_pause_is_three_usual_steps(gap_s: float, pause: bool) -> None:
    tables = [dense(name, (0.0, 10.0), (9.9 + gap_s, 20.0)) for name in "AB"]
    assert bool(len(log_pauses(MadeLog(*tables)))) is pause


def test_the_dense_messages_end_before_the_rest() -> None:
    tables = [
        dense("A", (0.0, 10.0)),
        dense("B", (0.0, 12.0)),
        dense("C", (0.0, 11.0)),
        dense("D", (0.0, 99.0), rate_hz=1.0),
    ]
    assert dense_end_ns(MadeLog(*tables)) == 10_900_000_000
    assert dense_end_ns(MadeLog(tables[3])) is None
    few = MadeTable("E", SECOND // 10 * np.arange(9), {"A": np.zeros(9)})
    assert dense_end_ns(MadeLog(few)) is None


def test_the_share_of_a_gap_that_a_span_covers() -> None:
    spans = np.array([[0, 10], [20, 50], [60, 65], [90, 200]])
    share = covered_share(np.array([0, 15, 20, 50, 64, 10, 100]), np.array([10, 65, 50, 60, 69, 20, 200]), spans)
    assert share.tolist() == pytest.approx([1.0, 0.6, 1.0, 0.0, 1.0, 0.0, 1.0])
    assert covered_share(np.array([5]), np.array([6]), np.empty((0, 2), dtype=np.int64)).tolist() == [0.0]
